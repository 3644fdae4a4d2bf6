"""Exact moments estimated from weighted draws, beside the moments of the Gaussian answer.

A draw x from the mixture r = (q + d)/2 has the weights y = p/r and v = q/r (`mixture`); its offset
is x less the answer's mean.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import log, sqrt

import numpy as np

from pgm.factors import Gaussian
from pgm.inference.audit.mixture import Mixture
from pgm.kernels import roots, solving
from pgm.kernels.angles import difference
from pgm.kernels.arrays import (
    Array,
    Index,
    Integers,
    Mask,
    frozen,
    symmetric,
    transpose,
)
from pgm.variables import Variable


@dataclass(frozen=True, eq=False)
class Compared:
    """Exact moments of a belief, estimated, beside the Gaussian answer's.

    `mean` (steps, runs, n) and `cov` (steps, runs, n, n) are the exact ones, of the n components of
    `scope`.
    `divergence` (steps, runs) is KL(N(mean, cov) ‖ the Gaussian's) in nats, infinite where draws
    left no covariance. `steps` are the steps of a chain, None in a network without time, whose
    arrays have a single step. `judged` (steps,) marks beliefs that know all measurements, as q
    does.
    """

    scope: tuple[Variable, ...]
    steps: Integers | None
    mean: Array
    cov: Array
    divergence: Array
    judged: Mask

    def excess(self, draws: Array) -> Array:
        """The largest divergence of a judged belief, less what chance explains, (runs,), in nats.

        Moments estimated from N effective draws, `draws` (runs,), are about χ²_f / 2N nats off,
        with f = n (n + 3)/2 degrees of freedom, of n means and a covariance. The largest of m is
        bounded by

            (f/2 + √(f ln m) + ln m) / N

        (Laurent & Massart, 2000, lemma 1).
        """
        size = self.mean.shape[-1]
        freedom, spread = 0.5 * size * (size + 3), log(max(int(self.judged.sum()), 1))
        chance = (0.5 * freedom + sqrt(freedom * spread) + spread) / draws
        return np.asarray(self._known.max(axis=0, initial=0.0) - chance)

    @property
    def _known(self) -> Array:
        """Divergences (steps, runs) of judged beliefs with finite moments; zero elsewhere."""
        known = self.judged[:, None] & np.isfinite(self.divergence)
        return np.where(known, self.divergence, 0.0)

    def furthest(self, lead: tuple[int, ...]) -> tuple[float, str]:
        """The largest divergence of a judged belief, and this belief's variables and run in words.

        `lead` is the shape of the runs. The words list the variables, and end in " of run 2" if
        there is a `lead`. With no run, or no step, the divergence is zero and the words are empty.
        """
        found = self._known
        if not found.size:
            return 0.0, ""
        step, run = np.unravel_index(int(found.argmax()), found.shape)
        scope = self.scope
        if self.steps is not None:
            scope = tuple(each.at(int(self.steps[step])) for each in scope)
        where = ", ".join(str(k) for k in np.unravel_index(run, lead))
        of = f" of run {where}" if lead else ""
        return float(found[step, run]), f"{', '.join(map(repr, scope))}{of}"

    def gaussian(self, lead: tuple[int, ...]) -> Gaussian:
        """The exact moments over the runs' shape `lead`, and over steps if there are any."""
        mean, cov = self._stacked(self.mean, lead), self._stacked(self.cov, lead)
        return Gaussian._make(self.scope, mean, cov, self.steps)

    def divergences(self, lead: tuple[int, ...]) -> Array:
        """The divergence, (*lead, steps), or (*lead) in a network without time."""
        return frozen(self._stacked(self.divergence, lead))

    def _stacked(self, values: Array, lead: tuple[int, ...]) -> Array:
        """Reshape (steps, runs, ...) to (*lead, steps, ...); without time to (*lead, ...)."""
        tail = values.shape[2:]
        if self.steps is None:
            return np.asarray(values[0].reshape((*lead, *tail)))
        return np.asarray(values.swapaxes(0, 1).reshape((*lead, len(values), *tail)))


@dataclass(eq=False)
class Sums:
    """Sums of the offsets of draws, and of their squares, for the moments of some variables.

    scope : tuple of Variable
    places : slice or ndarray
        Where they stand in a step's vector of draws.
    first : int
        The first step at which they are.
    mean, cov : ndarray
        (steps, runs, n) and (steps, runs, n, n): the Gaussian answer's moments, of the n components
        of `scope`.
    judged : ndarray
        (steps,): see `Compared`.
    timed : bool
        Whether there are steps.
    """

    scope: tuple[Variable, ...]
    places: Index
    first: int
    mean: Array
    cov: Array
    judged: Mask
    timed: bool
    _offsets: Array = field(init=False)
    _squares: Array = field(init=False)

    def __post_init__(self) -> None:
        self._offsets = np.zeros((2, *self.mean.shape))
        self._squares = np.zeros((2, *self.cov.shape))

    def add(self, values: list[Array], pair: Array, fading: Array) -> None:
        """Take in S draws for each run, a list by step of `values`, weighed by y and v.

        The values, (runs, S, ...), are whole vectors, from which `places` takes the components of
        `scope`. `pair` (2, runs, S) are the weights y, over e^peak, and v; `fading` (runs,) is
        e^(peak before − peak now), by which the sums of the weights y before shrink. Offsets of
        angles are wrapped.
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

    def compared(self, mixture: Mixture) -> Compared:
        """The exact moments, from all draws, beside the Gaussian's.

        With offsets d, the Gaussian's covariance P, Ẑ and the slope β of the `mixture`'s evidence,
        and means over draws, they are

            E d = mean of (y − β v) d / Ẑ,   E d dᵀ = mean of (y − β v) d dᵀ / Ẑ + (β / Ẑ) P,

        v d and v d dᵀ, of means 0 and P, being control variates. Where that leaves no covariance β
        is zero. Components in which the Gaussian has no variance are not compared.
        """
        weights, evidence = mixture.weighed.weights, mixture.evidence
        lower, slope = roots.root(self.cov), evidence.slope
        total = weights.shape[-1] * evidence.value
        own = (slope / evidence.value)[:, None, None] * self.cov
        offset, cov = _moments(
            (self._offsets[0] - slope[:, None] * self._offsets[1]) / total[:, None],
            (self._squares[0] - slope[:, None, None] * self._squares[1]) / total[:, None, None]
            + own,
        )
        divergence = _from_gaussian(lower, offset, cov)
        lost = ~np.isfinite(divergence)
        if lost.any():
            total = weights.sum(axis=-1)
            plain = _moments(
                self._offsets[0] / total[:, None], self._squares[0] / total[:, None, None]
            )
            offset = np.where(lost[..., None], plain[0], offset)
            cov = np.where(lost[..., None, None], plain[1], cov)
            divergence = np.where(lost, _from_gaussian(lower, *plain), divergence)
        steps = np.arange(self.first, self.first + len(cov)) if self.timed else None
        mean = self.mean + offset
        return Compared(self.scope, steps, mean, cov, divergence, self.judged)


def _moments(offsets: Array, squares: Array) -> tuple[Array, Array]:
    """Mean E d and covariance E d dᵀ − E d E dᵀ of offsets d, from E d and E d dᵀ."""
    return offsets, symmetric(squares - offsets[..., :, None] * offsets[..., None, :])


def _from_gaussian(lower: Array, offset: Array, cov: Array) -> Array:
    """KL(N(m, C) ‖ N(0, L Lᵀ)) (...), of offsets m (..., d), and C (..., d, d).

    With A = L⁻¹ C L⁻ᵀ and its eigenvalues a it is ½ (Σ (a − 1 − ln a) + |L⁻¹ m|²), infinite where
    C is no covariance. Components that L leaves without variance are not compared.
    """
    fixed = roots.determined(lower)
    white = solving.whiten(lower, offset)
    inner = solving.solve_lower(lower, transpose(solving.solve_lower(lower, cov)))
    alone = fixed[..., :, None] | fixed[..., None, :]
    inner = np.where(alone, fixed[..., None] * np.eye(fixed.shape[-1]), symmetric(inner))
    values = np.linalg.eigvalsh(inner)
    proper = (values > 0.0).all(axis=-1)
    logs = np.log(np.where(values > 0.0, values, 1.0))
    total = (values - 1.0 - logs).sum(axis=-1) + (white * white).sum(axis=-1)
    return np.where(proper, 0.5 * total, np.inf)
