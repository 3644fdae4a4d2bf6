"""The cost of a trajectory, −2 ln p less constants, by which a step control judges its steps.

It sums rᵀ Q⁺ r over the residuals r of all CPDs, Q being their noise covariances as they were
linearised; of robust measurements twice their losses, 2 ρ. A residual is the child's mean less the
mean that its CPD expects at the parents' belief.

Linear CPDs with singular noise are obeyed exactly by all trajectories of finite cost, onto which
others are projected (`exact_relations`).

A *family* is a CPD at all its *rows*: the steps of a transition, or the measurements of a sensor; a
prior has one row. A *link* is a family of the prior or the transition, with the places of parents
and child in the vector of their components. A child has d components.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.beliefs.moments.steps.readings import Moments
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.errors import ModelError
from pgm.kernels import roots
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, block
from pgm.linearisation import costs
from pgm.linearisation.family import Family
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.iteration import Point
from pgm.schedules.schedule import Filtering, Smoothing


def trajectory(plan: ChainPlan, at: Point) -> Array:
    """The cost of the trajectory of means `at.mean` (T+1, runs, n), (runs,).

    Linearisers that take expectations over a belief take them with the covariances of `at`. Where a
    belief `plan.begin` takes the prior's place, the first slice has its cost under that belief. A
    noise that is indefinite is refused with a NumericalError.
    """
    total = prior(plan, at)
    for link, parents, spread, child in transitions(plan, at):
        expected = costs.expected(link.family, slice(None), parents, spread)
        total += _square(link.family, child, expected)
    for sensor in plan.sensors:
        steps = sensor.family.step - plan.first
        if sensor.robust:
            total += _robust(sensor, at.mean[steps], at.known_cov[steps])
        else:
            total += readings(sensor, slice(None), at.mean[steps], at.cov[steps])
    return total


def prior(plan: ChainPlan, at: Point) -> Array:
    """The cost of the first slice's mean under the prior, or the belief in its place, (runs,)."""
    total = np.zeros(plan.runs)
    if plan.begin is not None:
        mean, cov = Moments(*plan.begin).by_run
        beginning = costs.squares((at.mean[0] - mean)[None], cov[None])
        assert beginning is not None
        total += beginning
    for link, parents, spread, child in starting(plan, at):
        expected = costs.expected(link.family, slice(None), parents, spread)
        total += _square(link.family, child, expected)
    return total


# A CPD of the prior or of a transition, the means and covariances of its parents, and its child's.
Linked = tuple[Link, Array, Array, Array]


def linked(plan: ChainPlan, at: Point) -> Iterator[Linked]:
    """The links of prior and transition, each with the moments of its parents and its child's mean.

    `at` has the moments of all slices. Yields the link, its parents' means (rows, runs, k) and
    covariances (rows, runs, k, k), k being the parents' number of components, and the child's means
    (rows, runs, d), all as `at` has them. There is one row for the prior, T for a transition.
    """
    yield from starting(plan, at)
    yield from transitions(plan, at)


def starting(plan: ChainPlan, at: Point) -> Iterator[Linked]:
    """The links of the prior, as of `linked`."""
    mean, cov = at.start(plan.layout.state_places)
    for link in plan.prior:
        places = link.parents
        yield link, mean[..., places], block(cov, places, places), mean[..., link.child]


def transitions(plan: ChainPlan, at: Point) -> Iterator[Linked]:
    """The links of the transition, as of `linked`."""
    states = plan.layout.state_places
    front = plan.layout.state_size
    if plan.steps:
        for link in plan.transition:
            child = slice(link.child.start - front, link.child.stop - front)
            yield link, *at.pairs(states, link.parents), at.mean[1:][..., child]


def _robust(sensor: Sensor, mean: Array, cov: Array) -> Array:
    """Twice the losses of a robust sensor's measurements, 2 Σ ρ(s), (runs,).

    s is the square of the residual in standard deviations of the noise, at the means (M, runs, n)
    of the slices of the M measurements; with a lineariser that takes expectations it is the
    expected square under beliefs of these means and covariances `cov` (M, runs, n, n).
    """
    family, parents, everything = sensor.family, sensor.parents, slice(None)
    if not mean.shape[0]:
        return np.zeros(mean.shape[1])
    spread = block(cov, parents, parents)
    expected = costs.expected(family, everything, mean[..., parents], spread)
    left = difference(sensor.values, expected, family.cpd.child.angle_mask)
    weights = sensor.weights
    seen = (family.matrix, spread) if family.expects else ()
    total: Array = weights.loss(weights.squares(left, *seen)).sum(axis=0)
    return total


def readings(sensor: Sensor, rows: slice, mean: Array, cov: Array) -> Array:
    """The cost Σ rᵀ R⁺ r of a sensor's measurements `rows`, (runs,), at beliefs over their slices.

    `mean` (k, runs, n) and `cov` (k, runs, n, n) are those of the slices of the k `rows`. Missing
    components do not count.
    """
    family, parents = sensor.family, sensor.parents
    if not mean.shape[0]:
        return np.zeros(mean.shape[1])
    expected = costs.expected(family, rows, mean[..., parents], block(cov, parents, parents))
    left = difference(sensor.values[rows], expected, family.cpd.child.angle_mask)
    if sensor.taken is not None:
        left = np.where(sensor.taken[rows], left, 0.0)
    if sensor.cross:
        return _grouped(sensor, rows, left)
    return costs.weighted(family, left, sensor.noise(rows))


def _grouped(sensor: Sensor, rows: slice, left: Array) -> Array:
    """The cost of a sensor's measurements whose noise is correlated within a step, (runs,).

    `left` has the residuals (k, runs, d) of the k measurements `rows`. Those of a step make one
    vector, with one covariance; a step counts only if all its measurements are among the rows.
    """
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
        total += costs.weighted(sensor.family, stacked[None], noise[None])
    return total


def require_cost(
    schedule: Filtering | Smoothing, families: Iterable[Family], *, first: bool = True
) -> None:
    """Refuse nonlinear CPDs of singular noise, with a ModelError, if a cost controls the steps.

    Their cost would be infinite nearly everywhere. Schedules without Levenberg–Marquardt damping
    pass, and so do linear CPDs. `first` is true if the first iteration linearises at a filter's
    beliefs, and so takes no step that a cost would judge; a schedule of one such iteration passes.
    """
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
    """The cost of a CPD, (runs,), from means of its child and expected ones, (rows, runs, d)."""
    left = difference(mean, expected, family.turned)
    return costs.weighted(family, left, family.noise)
