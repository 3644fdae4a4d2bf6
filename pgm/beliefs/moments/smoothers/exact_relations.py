"""Projection of trajectories to the nearest ones that satisfy all noise-free relations of a model.

Where the noise of a linear CPD or measurement is singular, the slices x[t] of a chain obey
relations C x[t] + B x[t − 1] = c exactly. The shortest move of the means, in given units, after
which they obey all relations solves block tridiagonal normal equations, in which a relation that is
missed has a very large weight (a quadratic penalty).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.kernels import tridiagonal
from pgm.kernels.arrays import Array, Integers, Mask, apply, multiply, transpose
from pgm.kernels.solving import left_open
from pgm.kernels.tridiagonal import Tridiagonal
from pgm.linearisation.family import Family

# A relation that is missed by no more than this part of the numbers in it is obeyed.
OBEYED = 1e-10
# The weights of relations of unit length, against squared moves in units, pass after pass.
_WEIGHTS = (1e8, 1e8, 1e10, 1e10, 1e12, 1e12, *(1e14,) * 6)
# A standard deviation below this part of the numbers' size may be rounding.
_ROUNDING = 1e-7


class Relation(NamedTuple):
    """Noise-free relations C x[t] + B x[t − 1] = c of one CPD at k steps.

    `step` t is (k,), `own` C and `before` B (k, runs, d, n) over the n components of a slice,
    `value` c (k, runs, d). There is a row for each of the d components of the child; it is zero if
    the component has noise that the components before it do not determine.
    """

    step: Integers
    own: Array
    before: Array
    value: Array

    def missed(self, mean: Array) -> tuple[Array, Array]:
        """The residuals c − C x[t] − B x[t − 1], (k, runs, d), at a trajectory (T+1, runs, n).

        The second result, of the same shape, has the sums of the absolute values of the residuals'
        summands.
        """
        here, earlier = mean[self.step], mean[self.step - 1]
        left = self.value - apply(self.own, here) - apply(self.before, earlier)
        size = np.abs(self.value) + apply(np.abs(self.own), np.abs(here))
        return left, size + apply(np.abs(self.before), np.abs(earlier))


def projected(plan: ChainPlan, mean: Array, std: Array) -> tuple[Array, Mask]:
    """The trajectories (T+1, runs, n) nearest to `mean` that obey all relations of the plan.

    `mean` (T+1, runs, n) stays in runs that obey already. A component's moves are measured in its
    largest standard deviation of all steps, from `std` (T+1, runs, n), or, where that may be
    rounding, in its largest absolute mean or in 1, whichever is larger. The second result, a mask
    (runs,), is false in runs in which rounding has left a relation missed.
    """
    relations = list(_relations(plan))
    obeyed = _obeyed(relations, mean)
    size = np.maximum(np.abs(mean).max(axis=0), 1.0)
    largest = std.max(axis=0)
    unit = np.where(largest > _ROUNDING * size, largest, size)
    for weight in _WEIGHTS:
        if obeyed.all():
            break
        # Each pass moves along the relations alone, and leaves less to the next: what is hard to
        # see in these units needs the great weights, which would cost digits where all is seen.
        nearer = mean + unit * tridiagonal.solve_tridiagonal(
            _equations(relations, mean, unit, weight)
        )
        mean = np.where(obeyed[:, None], mean, nearer)
        obeyed = obeyed | _obeyed(relations, mean)
    return mean, obeyed


def _obeyed(relations: list[Relation], mean: Array) -> Mask:
    """Whether trajectories (T+1, runs, n) satisfy all relations up to rounding, (runs,)."""
    fits = np.ones(mean.shape[1], dtype=bool)
    for relation in relations:
        left, size = relation.missed(mean)
        fits &= (np.abs(left) <= OBEYED * size).all(axis=(0, -1))
    return fits


def _equations(relations: list[Relation], mean: Array, unit: Array, weight: float) -> Tridiagonal:
    """The normal equations of the moves ξ (T+1, runs, n) that minimise |ξ|² + w Σ |residual|².

    ξ is in units of `unit` (runs, n), w is `weight`; each row of a relation is scaled to unit
    length in these units. `mean` (T+1, runs, n) is the trajectory that moves by ξ.
    """
    steps, runs, size = mean.shape
    diagonal = np.zeros((steps, runs, size, size)) + np.eye(size)
    above, right = np.zeros((steps - 1, runs, size, size)), np.zeros((steps, runs, size))
    for relation in relations:
        step = relation.step
        own = relation.own * unit[:, None, :]
        before = relation.before * unit[:, None, :]
        square = (own**2).sum(axis=-1) + (before**2).sum(axis=-1)
        length = np.sqrt(np.where(square > 0.0, square, 1.0))
        own, before = own / length[..., None], before / length[..., None]
        left = relation.missed(mean)[0] / length
        np.add.at(diagonal, step, weight * multiply(transpose(own), own))
        np.add.at(right, step, weight * apply(transpose(own), left))
        later = np.flatnonzero(step)
        back, earlier = transpose(before[later]), step[later] - 1
        np.add.at(diagonal, earlier, weight * multiply(back, before[later]))
        np.add.at(above, earlier, weight * multiply(back, own[later]))
        np.add.at(right, earlier, weight * apply(back, left[later]))
    return Tridiagonal(diagonal, above, right)


def _relations(plan: ChainPlan) -> Iterator[Relation]:
    """The relations of all linear CPDs and measurements with singular noise.

    With noise covariance L Lᵀ, L lower triangular, a child y = F p + b + noise of parents p obeys
    (I − L L⁺) (y − F p − b) = 0.
    """
    layout = plan.layout
    states, front, size = layout.state_places, layout.state_size, layout.slice_size
    for link in plan.prior:
        if (free := _of_linear(link.family, link.family.own_noise)) is not None:
            own, value = _row(link, free, front)
            whole = np.zeros((*own.shape[:-1], size))
            whole[..., states] = own
            yield Relation(np.zeros(1, dtype=np.intp), whole, np.zeros_like(whole), value)
    for link in plan.transition:
        if plan.steps and (free := _of_linear(link.family, link.family.own_noise)) is not None:
            pair, value = _row(link, free, front + size)
            before = np.zeros((*pair.shape[:-1], size))
            before[..., states] = pair[..., :front]
            yield Relation(np.arange(1, plan.steps + 1), pair[..., front:], before, value)
    for sensor in plan.sensors:
        family = sensor.family
        if not (family.exact and family.step.size):
            continue
        seen = sensor.reading(slice(None))  # where a component is missing, its noise is regular
        if (free := _of_linear(family, seen.noise)) is not None:
            own = np.zeros((*family.shape[:3], size))
            own[..., sensor.parents] = multiply(free, seen.matrix)
            value = apply(free, seen.value - seen.offset)
            yield Relation(family.step, own, np.zeros_like(own), value)


def _of_linear(family: Family, noise: Array) -> Array | None:
    """The projection on directions without noise; None of a regular one, or a nonlinear CPD."""
    return left_open(noise) if family.exact else None


def _row(link: Link, free: Array, width: int) -> tuple[Array, Array]:
    """The relation (I − L L⁺) (y − F p) = (I − L L⁺) b of a CPD y = F p + b + noise at its rows.

    Rows are steps. `free` is I − L L⁺, L Lᵀ being the noise covariance; `link` has F and b, and the
    places of parents p and child y in a vector of length `width`. Returns the coefficients of that
    vector, (rows, runs, d, width), and the right side, (rows, runs, d).
    """
    family = link.family
    row = np.zeros((*family.shape[:3], width))
    row[..., link.child] = np.eye(family.shape[2])
    row[..., link.parents] -= family.matrix
    return multiply(free, row), apply(free, family.offset)
