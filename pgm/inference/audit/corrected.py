"""Exact moments estimated from weighted draws, beside the moments of the Gaussian answer.

Draws x of all hidden variables are from the mixture r = (q + d)/2 of the Gaussian answer q and a
defensive density d, which has wider tails. With p = p(x, z), the density of the model with the
measurements z, a draw has the weights y = p/r and v = q/r. The *offset* of a draw is x less the
answer's mean. A *scope* is the variables of one belief; n is the number of their components.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pgm.factors import Gaussian
from pgm.inference.audit.compared import Compared
from pgm.inference.audit.mixture import Mixture
from pgm.kernels import roots
from pgm.kernels.angles import difference
from pgm.kernels.arrays import (
    Array,
    Index,
    Mask,
    symmetric,
    transpose,
)
from pgm.kernels.divergence import from_gaussian
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, kw_only=True)
class ComparedMoments(Compared):
    """Exact moments of a belief, estimated, beside the Gaussian answer's.

    mean, cov: The estimated exact moments, (steps, runs, n) and (steps, runs, n, n).

    The divergence is KL(N(mean, cov) ‖ the Gaussian answer's belief of the scope), infinite where
    `cov` is not positive definite.
    """

    mean: Array
    cov: Array

    @property
    def freedom(self) -> float:
        """The f = n (n + 3)/2 numbers in n means and a covariance."""
        size = int(self.mean.shape[-1])
        return 0.5 * size * (size + 3)

    def belief(self, lead: tuple[int, ...]) -> Gaussian:
        """The exact moments as a Gaussian, its leading axes the runs, `lead`, then steps if any."""
        mean, cov = self._stacked(self.mean, lead), self._stacked(self.cov, lead)
        return Gaussian._make(self.scope, mean, cov, self.steps)


@dataclass(eq=False)
class Sums:
    """Weighted sums of draws' offsets δ, and of their squares δ δᵀ, for the moments of a scope.

    scope : tuple of Variable
        The variables whose joint moments are estimated.
    places : slice or ndarray
        The places of the scope's components in a step's vector of draws.
    first : int
        The first step that has all of the variables: 1 with hidden controls, or with states of the
        step before, otherwise 0.
    mean, cov : ndarray
        (steps, runs, n) and (steps, runs, n, n): the Gaussian answer's moments of the scope.
    judged : ndarray
        (steps,): whether the posterior's belief at a step is given all measurements, as q is.
    timed : bool
        Whether the network has steps.
    plain : bool
        Whether q, whose draws these are, need not have the answer's moments, so that they are of no
        use as control variates.
    _offsets, _squares : ndarray
        (2, steps, runs, n) and (2, steps, runs, n, n): the sums of δ and of δ δᵀ, weighed by y and
        by v.
    """

    scope: tuple[Variable, ...]
    places: Index
    first: int
    mean: Array
    cov: Array
    judged: Mask
    timed: bool
    plain: bool = False
    _offsets: Array = field(init=False)
    _squares: Array = field(init=False)

    def __post_init__(self) -> None:
        self._offsets = np.zeros((2, *self.mean.shape))
        self._squares = np.zeros((2, *self.cov.shape))

    def add(self, values: list[Array], pair: Array, fading: Array) -> None:
        """Add the offsets of S draws for each run to the sums, weighed by y and by v.

        values: By step, the draws' whole vectors, (runs, S, ...), from which `places` takes the
            components of `scope`. Offsets of angles are wrapped.
        pair: The weights y / e^peak and v, (2, runs, S), peak being the largest ln y of the run so
            far.
        fading: e^(peak before − peak now), (runs,), by which the sums of earlier draws with weights
            y are multiplied.
        """
        self._offsets[0] *= fading[:, None]
        self._squares[0] *= fading[:, None, None]
        angles = np.concatenate([each.angle_mask for each in self.scope])
        for row, drawn in enumerate(values[self.first :]):
            off = difference(drawn[..., self.places], self.mean[row][:, None], angles)
            for kind, weights in enumerate(pair):
                weighted = transpose(off * weights[..., None])
                self._offsets[kind, row] += weighted.sum(axis=-1)
                self._squares[kind, row] += weighted @ off

    def compared(self, mixture: Mixture) -> ComparedMoments:
        """The exact moments, from all draws, beside the Gaussian's.

        `mixture` has the weights of all draws, and from them the estimate Ẑ of p(z), and the slope
        β of the regression of the weights y on v. With offsets δ and the Gaussian's covariance P,
        the moments of δ are estimated by means over all draws:

            E δ = mean of (y − β v) δ / Ẑ,   E δ δᵀ = mean of (y − β v) δ δᵀ / Ẑ + (β / Ẑ) P.

        Here v δ and v δ δᵀ, whose expected values 0 and P are known, are control variates. Where
        the result is no proper covariance, or the sums are `plain`, the moments weighed by y alone
        are taken. Components in which the Gaussian has no variance are not compared.
        """
        weights, evidence = mixture.weighed.weights, mixture.evidence
        lower, slope = roots.root(self.cov), evidence.slope * (not self.plain)
        total = weights.sum(-1) if self.plain else weights.shape[-1] * evidence.value
        own = (slope / evidence.value)[:, None, None] * self.cov
        offset, cov = _moments(
            (self._offsets[0] - slope[:, None] * self._offsets[1]) / total[:, None],
            (self._squares[0] - slope[:, None, None] * self._squares[1]) / total[:, None, None]
            + own,
        )
        divergence = from_gaussian(lower, offset, cov)
        lost = ~np.isfinite(divergence)
        if lost.any():
            total = weights.sum(axis=-1)
            plain = _moments(
                self._offsets[0] / total[:, None], self._squares[0] / total[:, None, None]
            )
            offset = np.where(lost[..., None], plain[0], offset)
            cov = np.where(lost[..., None, None], plain[1], cov)
            divergence = np.where(lost, from_gaussian(lower, *plain), divergence)
        steps = np.arange(self.first, self.first + len(cov)) if self.timed else None
        return ComparedMoments(
            scope=self.scope,
            steps=steps,
            divergence=divergence,
            judged=self.judged,
            mean=self.mean + offset,
            cov=cov,
        )


def _moments(offsets: Array, squares: Array) -> tuple[Array, Array]:
    """The mean E δ (..., n) and covariance E δ δᵀ − E δ E δᵀ (..., n, n) of offsets δ.

    `offsets` is E δ, `squares` (..., n, n) is E δ δᵀ.
    """
    return offsets, symmetric(squares - offsets[..., :, None] * offsets[..., None, :])
