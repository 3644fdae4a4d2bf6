"""Exact moments estimated from weighted draws, beside the moments of the Gaussian answer.

Draws x of all hidden variables are from the mixture r = (q + d)/2 of the Gaussian answer q and a
defensive density d, which has wider tails. With p = p(x, z), the density of the model with the
measurements z, a draw has the weights y = p/r and v = q/r. The *offset* of a draw is x less the
answer's mean. A *scope* is the variables of one belief; n is the number of their components.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from pgm.factors import Gaussian
from pgm.inference.audit.compared import Compared
from pgm.inference.audit.mixture import Mixture
from pgm.kernels import roots, sampled
from pgm.kernels.angles import difference
from pgm.kernels.arrays import (
    Array,
    Index,
    Mask,
    symmetric,
)
from pgm.kernels.divergence import from_gaussian
from pgm.kernels.sampled import Spread
from pgm.variables import Variable

# The groups of draws by which the errors of estimated moments are told; and the floats of their
# sums at the most, above which there is a single group, and errors are not told.
GROUPS, ROOM = 16, 2**23
# Numbers of draws that are summed up together: they stay in cache.
BLOCK = 2**18


@dataclass(frozen=True, eq=False, kw_only=True)
class ComparedMoments(Compared):
    """Exact moments of a belief, estimated, beside the Gaussian answer's.

    mean, cov: The estimated exact moments, (steps, runs, n) and (steps, runs, n, n).
    spread: The parts of groups of draws in their errors, (G, steps, runs, ...); None where they
        are not asked for.

    The divergence is KL(N(mean, cov) ‖ the Gaussian answer's belief of the scope), infinite where
    `cov` is not positive definite.
    """

    mean: Array
    cov: Array
    spread: Spread | None = None

    @property
    def freedom(self) -> float:
        """The f = n (n + 3)/2 numbers in n means and a covariance."""
        size = int(self.mean.shape[-1])
        return 0.5 * size * (size + 3)

    def belief(self, lead: tuple[int, ...]) -> Gaussian:
        """The exact moments as a Gaussian, its leading axes the runs, `lead`, then steps if any."""
        mean, cov = self._stacked(self.mean, lead), self._stacked(self.cov, lead)
        return Gaussian._make(self.scope, mean, cov, self.steps)

    def errors(self, spread: Spread, lead: tuple[int, ...]) -> Spread:
        """The parts of groups in the errors of the moments, (G, *lead, steps, ...)."""
        return Spread(*(np.stack([self._stacked(p, lead) for p in parts]) for parts in spread))


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
    _mass, _offsets, _squares : ndarray
        (2, G, runs), (2, G, steps, runs, n) and (2, G, steps, runs, n, n): the sums of weights y
        and v, and of δ and δ δᵀ weighed by them. There are G groups of draws, from which the error
        of a variable's moments is told; other scopes have a single one, and so have variables of so
        many runs and steps that the sums would take too much memory.
    _draws : ndarray
        (G,): the number of draws in each group.
    """

    scope: tuple[Variable, ...]
    places: Index
    first: int
    mean: Array
    cov: Array
    judged: Mask
    timed: bool
    plain: bool = False
    _mass: Array = field(init=False)
    _offsets: Array = field(init=False)
    _squares: Array = field(init=False)
    _draws: Array = field(init=False)

    def __post_init__(self) -> None:
        told = len(self.scope) == 1 and GROUPS * self.cov.size <= ROOM
        groups = GROUPS if told else 1
        self._mass = np.zeros((2, groups, self.mean.shape[1]))
        self._offsets = np.zeros((2, groups, *self.mean.shape))
        self._squares = np.zeros((2, groups, *self.cov.shape))
        self._draws = np.zeros(groups)

    def add(self, values: Array, pair: Array, fading: Array) -> None:
        """Add the offsets of S draws for each run to the sums, weighed by y and by v.

        values: By step, the draws' whole vectors, (T+1, runs, S, ...), from which `places` takes
            the components of `scope`. Offsets of angles are wrapped.
        pair: The weights y / e^peak and v, (2, runs, S), peak being the largest ln y of the run so
            far.
        fading: e^(peak before − peak now), (runs,), by which the sums of earlier draws with weights
            y are multiplied.
        """
        self._mass[0] *= fading
        self._offsets[0] *= fading[:, None]
        self._squares[0] *= fading[:, None, None]
        angles = np.concatenate([each.angle_mask for each in self.scope])
        grouped = self._grouped(pair)
        self._mass += grouped.sum(axis=-1).swapaxes(1, 2)
        self._draws += self._grouped(np.ones(pair.shape[-1])).sum(axis=-1)
        many = max(1, BLOCK // max(1, math.prod(pair.shape[1:]) * self.mean.shape[-1]))
        for first in range(0, len(self.mean), many):
            rows = slice(first, first + many)
            drawn = values[self.first :][rows][..., self.places]
            off = difference(drawn, self.mean[rows][..., None, :], angles)
            parts = self._grouped(off.swapaxes(-1, -2))  # (k, runs, n, G, draws)
            draws = parts.transpose(3, 0, 1, 4, 2)
            for kind, weights in enumerate(grouped):
                weighted = (parts * weights[:, None]).transpose(3, 0, 1, 2, 4)
                self._offsets[kind, :, rows] += weighted.sum(axis=-1)
                self._squares[kind, :, rows] += weighted @ draws

    def _grouped(self, values: Array) -> Array:
        """Values (..., S) of draws in turn of each group, (..., G, S/G), with zeros at the end."""
        groups = self._draws.size
        missing = -values.shape[-1] % groups
        if missing:
            values = np.concatenate([values, np.zeros((*values.shape[:-1], missing))], axis=-1)
        return values.reshape(*values.shape[:-1], -1, groups).swapaxes(-1, -2)

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
        evidence = mixture.evidence
        lower = roots.root(self.cov)
        slope = np.broadcast_to(evidence.slope * (not self.plain), lower.shape[:2])
        offset, cov = _moments(*self._weighed(slope))
        divergence = from_gaussian(lower, offset, cov)
        lost = ~np.isfinite(divergence)
        if lost.any():
            slope = np.where(lost, 0.0, slope)
            offset, cov = _moments(*self._weighed(slope))
            divergence = from_gaussian(lower, offset, cov)
        steps = np.arange(self.first, self.first + len(cov)) if self.timed else None
        spread = None
        if len(self._draws) > 1:
            spread = sampled.spread(*self._weighed(slope), offset, cov)
        return ComparedMoments(
            scope=self.scope,
            steps=steps,
            divergence=divergence,
            judged=self.judged,
            mean=self.mean + offset,
            cov=cov,
            spread=spread,
        )

    def _weighed(self, slope: Array) -> tuple[Array, Array, Array]:
        """The sums of weights y − β v + β, of offsets and of squares, by group.

        slope: β, (steps, runs). Returns (G, steps, runs), (G, steps, runs, n) and
        (G, steps, runs, n, n); β is added to the first for each draw, and β P to the last, the
        expected values of β v and of β v δ δᵀ.
        """
        own = self._draws[:, None, None] * slope
        mass = self._mass[0][:, None] - slope * self._mass[1][:, None] + own
        offsets = self._offsets[0] - slope[..., None] * self._offsets[1]
        squares = self._squares[0] - slope[..., None, None] * self._squares[1]
        return mass, offsets, squares + own[..., None, None] * self.cov


def _moments(mass: Array, offsets: Array, squares: Array) -> tuple[Array, Array]:
    """The mean (..., n) and covariance (..., n, n) of offsets δ, from sums by group, (G, ...).

    The sums are those of weights, of δ and of δ δᵀ.
    """
    total = mass.sum(axis=0)[..., None]
    mean = offsets.sum(axis=0) / total
    square = squares.sum(axis=0) / total[..., None]
    return mean, symmetric(square - mean[..., :, None] * mean[..., None, :])
