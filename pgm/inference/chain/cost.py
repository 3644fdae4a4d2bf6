"""The cost of a trajectory: what every CPD leaves unexplained, in its own deviations.

Linear CPDs with singular noise are obeyed exactly by all trajectories of finite cost, onto which
others are projected. Their relations are C x + B x⁻ = c, a row for each component of the child;
those that the noise leaves open are zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from pgm.errors import ModelError, NumericalError
from pgm.inference.chain.plan import ChainPlan, Link
from pgm.inference.chain.readings import Moments
from pgm.inference.chain.sensor import Sensor
from pgm.inference.damping import LevenbergMarquardt
from pgm.inference.family import Family
from pgm.inference.iteration import Point
from pgm.inference.schedule import Filtering, Smoothing
from pgm.kernels import roots, solving, tridiagonal
from pgm.kernels.angles import difference
from pgm.kernels.arrays import (
    Array,
    Integers,
    Mask,
    apply,
    block,
    components_last,
    inner,
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


def trajectory(plan: ChainPlan, at: Point) -> Array:
    """The cost of the means of all slices, (runs,); of a window with that of where it begins."""
    total = np.zeros(plan.runs)
    if plan.begin is not None:
        mean, cov = Moments(*plan.begin).by_run
        beginning = _squares((at.mean[0] - mean)[None], cov[None])
        assert beginning is not None
        total += beginning
    for link, parents, spread, child in linked(plan, at):
        expected = _expected(link.family, slice(None), parents, spread)
        total += _square(link.family, child, expected)
    for sensor in plan.sensors:
        steps = sensor.family.step - plan.first
        if sensor.robust:
            total += _robust(sensor, at.mean[steps], at.known_cov[steps])
        else:
            total += readings(sensor, slice(None), at.mean[steps], at.cov[steps])
    return total


def linked(plan: ChainPlan, at: Point) -> Iterator[tuple[Link, Array, Array, Array]]:
    """Each family of prior and transition at all its steps: its parents' moments, its own mean."""
    states = plan.layout.state_places
    mean, cov = at.start(states)
    for link in plan.prior:
        places = link.parents
        yield link, mean[..., places], block(cov, places, places), mean[..., link.child]
    front = plan.layout.state_size
    if plan.steps:
        for link in plan.transition:
            child = slice(link.child.start - front, link.child.stop - front)
            yield link, *at.pairs(states, link.parents), at.mean[1:][..., child]


def _robust(sensor: Sensor, mean: Array, cov: Array) -> Array:
    family, parents, everything = sensor.family, sensor.parents, slice(None)
    if not mean.shape[0]:
        return np.zeros(mean.shape[1])
    spread = block(cov, parents, parents)
    expected = _expected(family, everything, mean[..., parents], spread)
    left = difference(sensor.values, expected, family.cpd.child.angle_mask)
    weights = sensor.weights
    seen = (family.matrix, spread) if family.expects else ()
    total: Array = weights.loss(weights.squares(left, *seen)).sum(axis=0)
    return total


def readings(sensor: Sensor, rows: slice, mean: Array, cov: Array) -> Array:
    """The cost of some steps' measurements at beliefs over their slices, (k, runs, n): (runs,)."""
    family, parents = sensor.family, sensor.parents
    if not mean.shape[0]:
        return np.zeros(mean.shape[1])
    expected = _expected(family, rows, mean[..., parents], block(cov, parents, parents))
    left = difference(sensor.values[rows], expected, family.cpd.child.angle_mask)
    if sensor.taken is not None:
        left = np.where(sensor.taken[rows], left, 0.0)
    if sensor.cross:
        return _grouped(sensor, rows, left)
    return weighted(family, left, sensor.noise(rows))


def _grouped(sensor: Sensor, rows: slice, left: Array) -> Array:
    runs, height = left.shape[1:]
    first, last, _ = rows.indices(len(sensor.values))
    total = np.zeros(runs)
    for step in range(len(sensor.bounds) - 1):
        own = sensor.rows(step)
        if not first <= own.start < own.stop <= last:
            continue
        stacked = left[own.start - first : own.stop - first].swapaxes(0, 1).reshape(runs, -1)
        size = stacked.shape[1]
        noise, between = np.zeros((runs, size, size)), sensor.between(step)
        if between is not None:
            noise += between
        for k, each in enumerate(sensor.noise(own)):
            place = slice(k * height, (k + 1) * height)
            noise[:, place, place] = each
        total += weighted(sensor.family, stacked[None], noise[None])
    return total


def weighted(family: Family, residual: Array, cov: Array) -> Array:
    """Σ rᵀ Σ⁺ r over the first axis; determined components and infinite variances do not count."""
    total = _squares(residual, cov)
    if total is None:
        raise NumericalError(
            f"{family.cpd!r}: with {family.lineariser!r} its noise is indefinite, so that a step "
            "has no cost; use a rule with positive weights, or damping=0.5",
            variable=family.cpd.child,
            cpd=family.cpd,
        )
    return total


def _squares(residual: Array, cov: Array) -> Array | None:
    flat = np.isinf(np.einsum("...ii->...i", cov))
    if flat.any():
        residual = np.where(flat, 0.0, residual)
        cov = np.where(flat[..., None] | flat[..., None, :], np.eye(flat.shape[-1]), cov)
    lower = roots.root(cov)
    if not roots.is_proper(lower):
        return None
    white = solving.whiten(lower, residual)
    total: Array = inner(white, white).sum(axis=0)
    return total


def require_cost(
    schedule: Filtering | Smoothing, families: Iterable[Family], *, first: bool = True
) -> None:
    """Refuse nonlinear CPDs of singular noise, so of infinite cost, where this controls steps."""
    once = first and schedule.iterations == 1
    if once or not isinstance(schedule.damping, LevenbergMarquardt):
        return
    for family in families:
        if not family.exact and roots.determined(roots.root(family.own_noise)).any():
            raise ModelError(
                f"{family.cpd!r} is nonlinear and its noise is singular, so that nearly all "
                "points have an infinite cost: pgm.LevenbergMarquardt() cannot control the steps; "
                "use damping=0.5, or give it noise in all components",
                variable=family.cpd.child,
                cpd=family.cpd,
            )


def _square(family: Family, mean: Array, expected: Array) -> Array:
    left = difference(mean, expected, family.cpd.child.angle_mask)
    return weighted(family, left, family.noise)


def _expected(family: Family, rows: slice, mean: Array, cov: Array) -> Array:
    """E[f(X)] for X ~ N(mean, cov), as the lineariser sees it; NaN where f is not defined."""
    if family.exact:
        return family.value(rows, mean)
    function = family.bound(rows, mean.ndim - 1, mean.shape[:-1])
    return components_last(family.checked(function, mean, cov, finite=False).value, 1)


class Relation(NamedTuple):
    """Relations C x[t] + B x[t − 1] = c of a CPD at steps (k,), (k, runs, d, n)."""

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
    fits = np.ones(mean.shape[1], dtype=bool)
    for relation in relations:
        left, size = relation.missed(mean)
        fits &= (np.abs(left) <= OBEYED * size).all(axis=(0, -1))
    return fits


def _equations(relations: list[Relation], mean: Array, unit: Array, weight: float) -> Tridiagonal:
    """Of the moves ξ, in units, that minimise |ξ|² + w |relations missed|²."""
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
    family = link.family
    row = np.zeros((*family.shape[:3], width))
    row[..., link.child] = np.eye(family.shape[2])
    row[..., link.parents] -= family.matrix
    return multiply(free, row), apply(free, family.offset)
