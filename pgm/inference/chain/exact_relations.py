"""Project trajectories onto the noise-free relations of a model, the nearest that satisfy all."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pgm.inference.chain.plan import ChainPlan, Link
from pgm.inference.family import Family
from pgm.kernels import roots, solving, tridiagonal
from pgm.kernels.arrays import (
    Array,
    Integers,
    Mask,
    apply,
    multiply,
    transpose,
)
from pgm.kernels.tridiagonal import Tridiagonal

# A relation that is missed by no more than this part of the numbers in it is obeyed.
OBEYED = 1e-10
# The weights of relations of unit length against moves in units, pass after pass.
_WEIGHTS = (1e8, 1e8, 1e10, 1e10, 1e12, 1e12, *(1e14,) * 6)
# A deviation below this part of the numbers' size may be rounding.
_ROUNDING = 1e-7


class Relation(NamedTuple):
    """Noise-free relations C x[t] + B x[t − 1] = c of one CPD at k steps.

    C and B are (k, runs, d, n), for n components of a slice.
    """

    step: Integers
    own: Array
    before: Array
    value: Array

    def missed(self, mean: Array) -> tuple[Array, Array]:
        """The residual of each row at a trajectory (T+1, runs, n), and the size of its numbers."""
        here, earlier = mean[self.step], mean[self.step - 1]
        left = self.value - apply(self.own, here) - apply(self.before, earlier)
        size = np.abs(self.value) + apply(np.abs(self.own), np.abs(here))
        return left, size + apply(np.abs(self.before), np.abs(earlier))


def projected(plan: ChainPlan, mean: Array, std: Array) -> tuple[Array, Mask]:
    """The trajectories nearest to means (T+1, runs, n) that obey all exact relations.

    Means that obey stay. Distances are in each component's largest deviation `std`, or, where that
    is rounding, in the size of its numbers. The mask (runs,) is false where rounding has left them
    astray.
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
    """The equations of the moves ξ, in units, that minimise |ξ|² + w |relations missed|²."""
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
    """Relations from the noise-free rows of all linear CPDs and measurements.

    With noise L Lᵀ, (I − L L⁺) (y − F p − b) = 0.
    """
    layout = plan.layout
    states, front, size = layout.state_places, layout.state_size, layout.slice_size
    for link in plan.prior:
        if (free := _left_open(link.family, link.family.own_noise)) is not None:
            own, value = _row(link, free, front)
            whole = np.zeros((*own.shape[:-1], size))
            whole[..., states] = own
            yield Relation(np.zeros(1, dtype=np.intp), whole, np.zeros_like(whole), value)
    for link in plan.transition:
        if plan.steps and (free := _left_open(link.family, link.family.own_noise)) is not None:
            pair, value = _row(link, free, front + size)
            before = np.zeros((*pair.shape[:-1], size))
            before[..., states] = pair[..., :front]
            yield Relation(np.arange(1, plan.steps + 1), pair[..., front:], before, value)
    for sensor in plan.sensors:
        family = sensor.family
        if not (family.exact and family.step.size):
            continue
        seen = sensor.reading(slice(None))  # where a component is missing, its noise is regular
        if (free := _left_open(family, seen.noise)) is not None:
            own = np.zeros((*family.shape[:3], size))
            own[..., sensor.parents] = multiply(free, seen.matrix)
            value = apply(free, seen.value - seen.offset)
            yield Relation(family.step, own, np.zeros_like(own), value)


def _left_open(family: Family, noise: Array) -> Array | None:
    """I − L L⁺ for the noise L Lᵀ of a linear CPD, zero in rows of pivots; None where regular."""
    lower = roots.root(noise)
    fixed = roots.determined(lower)
    if not family.exact or not fixed.any():
        return None
    eye = np.eye(lower.shape[-1])
    explained = np.where(fixed[..., None], 0.0, solving.solve_lower(lower, eye + 0.0 * lower))
    return np.where(fixed[..., None], eye - multiply(lower, explained), 0.0)


def _row(link: Link, free: Array, width: int) -> tuple[Array, Array]:
    """The relation of a link over the vector of its parents and child, and its right side."""
    family = link.family
    row = np.zeros((*family.shape[:3], width))
    row[..., link.child] = np.eye(family.shape[2])
    row[..., link.parents] -= family.matrix
    return multiply(free, row), apply(free, family.offset)
