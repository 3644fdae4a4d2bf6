"""Relinearising chains and trees: linearise, solve, choose the next point, until it moves no more.

A *point* is where CPDs are linearised: means, and covariances for rules that use them. A run is
*active* until it has converged. The *control* of a step chooses the next point, given the present
one and the solution of the model linearised there: it takes the solution, or a mixture of both, or,
by Levenberg and Marquardt, means of a lower cost. The *cost* of means sums, over all CPDs, the
squared residual of the child, weighted with the inverse of the CPD's noise covariance
(`LevenbergMarquardt` defines it in full). Means of a lower cost are found with an *anchor*, an
added measurement of every component, whose value is that of the present point.

Arrays over a chain are (steps, runs, n, ...), n being the number of hidden components of a step's
slice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, cast, runtime_checkable

import numpy as np

from pgm.kernels import moments
from pgm.kernels.arrays import Array, Index, Integers, Mask, block
from pgm.progress import counted
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.schedule import Calibration, Filtering

# A relative rise of the cost that is rounding, and counts as none.
_NO_WORSE = 1e-13
# The largest weight λ: with more the step is rounding.
_HEAVIEST = 1e12
# Runs that a narrowed problem has at the least: packs of machine code are of so many.
_FEWEST = 8


class Point(NamedTuple):
    """A point of linearisation: mean (steps, runs, n) and cov (steps, runs, n, n).

    n is the number of hidden components of a step's slice. A *pair* is the states of one step, then
    the slice of the next, m components; `joint` (steps − 1, runs, m, m) are the covariances of all
    pairs, None where no CPD needs them. Where a flat prior leaves variances in `cov` infinite,
    `proper` is a finite covariance (steps, runs, n, n), along the directions that measurements
    determine; None where it is not needed.
    """

    mean: Array
    cov: Array
    joint: Array | None = None
    proper: Array | None = None

    @property
    def known_cov(self) -> Array:
        """The covariance that is finite: `proper` if there is one, else `cov`."""
        return self.cov if self.proper is None else self.proper

    @property
    def std(self) -> Array:
        """Standard deviations of all components, from `known_cov`, (steps, runs, n)."""
        return np.sqrt(np.maximum(np.diagonal(self.known_cov, axis1=-2, axis2=-1), 0.0))

    def start(self, states: Index) -> tuple[Array, Array]:
        """Mean (1, runs, k) and covariance (1, runs, k, k) of the states' k components at step 0.

        `states` are the places of these components in the slice.
        """
        return self.mean[:1][..., states], block(self.cov[:1], states, states)

    def pairs(self, states: Index, places: Index) -> tuple[Array, Array]:
        """Means (steps − 1, runs, k) and covariances (steps − 1, runs, k, k) of parts of all pairs.

        A part is k components, at the same `places` in each pair. `states` are the places of the
        states' components in a slice. `joint` must not be None if one of the `places` is in the
        later slice.
        """
        before, cov = self.mean[:-1][..., states], self.cov[:-1]
        front = before.shape[-1]
        if (places.stop if isinstance(places, slice) else places.max(initial=-1) + 1) <= front:
            return before[..., places], block(block(cov, states, states), places, places)
        assert self.joint is not None
        pair = np.concatenate([before, self.mean[1:]], axis=-1)
        return pair[..., places], block(self.joint, places, places)

    def of(self, runs: Integers) -> Point:
        """The point of some runs."""
        return Point._make(None if part is None else part[:, runs] for part in self)

    def mixed(self, other: Point, share: float) -> Point:
        """The point with `share` times this point's arrays plus 1 − `share` times another's."""
        pairs = zip(self, other, strict=True)
        return Point._make(
            None if mine is None or its is None else share * mine + (1.0 - share) * its
            for mine, its in pairs
        )


class Anchor(NamedTuple):
    """A measurement of all components, (steps, runs, n), that holds a solution near a point.

    It says that `mean` is x + e, where x are the hidden components and e ~ N(0, std²/λ) in each of
    them, with λ = `weight` (runs,). Components of zero `std` and runs of zero weight are not
    measured.
    """

    mean: Array
    std: Array
    weight: Array

    def at(self, step: int) -> Anchor:
        """The anchor of one step, its first axis of length one."""
        one = slice(step, step + 1)
        return Anchor(self.mean[one], self.std[one], self.weight)

    def hold(self, step: int, mean: Array, cov: Array) -> tuple[Array, Array]:
        """The mean (runs, n) and covariance (runs, n, n) of beliefs at a step, given the anchor.

        `mean` and `cov` are those of the beliefs before they are conditioned on its measurement.
        """
        held = (self.std[step] > 0.0) & (self.weight > 0.0)[:, None]
        eye = np.eye(mean.shape[-1])
        variance = self.std[step] ** 2 / np.where(self.weight > 0.0, self.weight, 1.0)[:, None]
        result = moments.update(
            mean,
            cov,
            held[..., None] * eye,
            np.where(held, self.mean[step] - mean, 0.0),
            np.where(held, variance, 1.0)[..., None] * eye,
            exact=False,
        )
        return result.mean, result.cov


class Solution(Protocol):
    """The solution of a linearised model, as far as iterations look at it."""

    @property
    def means(self) -> Array:
        """The solution's means, (steps, runs, n)."""

    @property
    def point(self) -> Any:
        """The solution's moments as a `Point`, at which the model can be linearised next.

        Trees have a point of another class. Covariances need only have the right diagonals if
        neither the linearisations nor the control of steps uses their other entries.
        """


S = TypeVar("S", bound=Solution)
Found = TypeVar("Found", bound=Solution, covariant=True)


class Problem(Protocol[Found]):
    """A model, with its evidence, that can be linearised at any point and then solved."""

    def linearise(self, at: Any, active: Mask) -> None:
        """Linearise all CPDs at a point, in the runs of the mask `active`, (runs,).

        It is a `Point`; trees have points of another class.
        """

    def solve(self, anchor: Anchor | None = None) -> Found:
        """The solution of the linearised model, with an anchor's measurement added, if any."""

    def settled(self) -> Mask | bool:
        """Whether robust noise lets a run converge, (runs,); True where all runs may.

        It lets a run converge once the graduated loss, which begins wide, has been sharpened to
        that of the user's model, and the weights of measurements, where they are iterated, no
        longer move.
        """


class Controlled(Problem[Found], Protocol[Found]):
    """A model whose steps can be controlled by their cost, as `LevenbergMarquardt` defines it."""

    def cost(self, at: Point) -> Array:
        """The cost of a point's means, (runs,); its covariances and the noises are held fixed."""

    def feasible(self, mean: Array, found: Point) -> Array:
        """The means `mean` (steps, runs, n), moved to where the cost is finite.

        The cost is finite where the linear CPDs of singular noise hold exactly. `found` is the
        solution of the model linearised at `mean`; its standard deviations may serve as units of
        the distance by which means are moved.
        """


@runtime_checkable
class Divisible(Problem[Found], Protocol[Found]):
    """A problem of many runs that can be narrowed to some of them."""

    @property
    def divides(self) -> bool:
        """Whether each run's linearisations depend on its own point alone."""

    def of_runs(self, runs: Integers) -> Divisible[Found]:
        """The problem of some runs, (k,), which may be named several times; to be linearised."""

    def put_runs(self, runs: Integers, part: Any) -> None:
        """Take over how `part`, the problem of these runs, was linearised last."""


@dataclass(frozen=True, eq=False)
class Iterated(Generic[S]):
    """The result of linearising and solving until the runs converged, or iterations were used up.

    `solution` is that of the last linearisation. `mean` (steps, runs, n) are the means to report:
    the solution's, or those that the control of steps kept in their place. `residuals` has, for
    each relinearisation, (runs,): the largest distance of a mean from the point where it was
    linearised, in standard deviations. `converged` (runs,) marks the runs that have converged.
    """

    solution: S
    mean: Array
    residuals: list[Array]
    converged: Mask


def iterate(
    problem: Problem[S],
    solution: S,
    schedule: Filtering | Calibration,
    converged: Mask,
    first: Any = None,
) -> Iterated[S]:
    """Linearise and solve again until each run converges, or the schedule's iterations are used up.

    A run has converged when its residual (see `Iterated`) is within the tolerance and its robust
    noise settled (`Problem.settled`); it then stays as it is. `solution` is that of the first
    linearisation, which counts as an iteration. `first` is the point where this was made, and the
    step from it to the solution is controlled; it is None, and the step is not controlled, if CPDs
    were linearised one after another, as by a filter. `converged` (runs,) marks the runs in which
    nothing is to iterate. A problem that is `Divisible` is narrowed to the runs that have not
    converged, whenever these are at most half of those that it has.
    """
    control = _Control(problem, schedule.damping, converged.size)
    residuals: list[Array] = []
    mean = solution.means
    if not converged.all():
        point = solution.point
        if first is not None:
            point = control.step(control.feasible(first, point), point, ~converged)
            mean = control.shown(mean, point, ~converged)
    whole: Any = problem
    runs = np.arange(converged.size)  # those of the problem, of the whole
    for _ in counted(range(schedule.iterations - 1), "linearisations"):
        if converged.all():
            break
        active = ~converged[runs]
        few = _few(active)
        if few is not None and isinstance(whole, Divisible) and whole.divides:
            if problem is not whole:
                whole.put_runs(runs, problem)
            runs, active = runs[few], active[few]
            problem = whole.of_runs(runs)
            point = control.narrowed(problem, few, point)
        problem.linearise(point, active)
        solution = problem.solve()
        found = solution.point
        residual = moments.moved(found.mean, point.mean, found.std)
        last = residuals[-1] if residuals else np.zeros(converged.size)
        residuals.append(_put(last, runs, active, residual))
        done = (residual <= schedule.tolerance) & problem.settled()
        converged = _put(converged, runs, active, done)
        point = control.step(point, found, active)
        mean = _put(mean, runs, active, control.shown(found.mean, point, active))
    if problem is not whole:
        whole.put_runs(runs, problem)
        solution = whole.solve()
    return Iterated(solution, mean, residuals, converged)


def _few(active: Mask) -> Integers | None:
    """The places of runs that are active, if it pays to narrow a problem to them; else None.

    They are no fewer than machine code sweeps together: if need be they are repeated.
    """
    found = np.flatnonzero(active)
    if active.size < 2 * _FEWEST or 2 * found.size > active.size:
        return None
    return found if found.size >= _FEWEST else np.resize(found, _FEWEST)


def _put(whole: Any, runs: Integers, active: Mask, part: Any) -> Any:
    """An array of all runs, (runs,) or (steps, runs, n), with the part's entries of active `runs`.

    The part is returned itself if it has all runs, and all are active.
    """
    every = active.all()
    if every and part.shape == whole.shape:
        return part
    found, axis = whole.copy(), part.ndim > 1
    own, theirs = runs[active], part[:, active] if axis else part[active]
    found[(slice(None), own) if axis else own] = theirs
    return found


class _Control:
    """The control of steps: it chooses the next point of linearisation.

    Without damping that is the solution, with a number as damping a mixture of the solution and the
    present point. With `LevenbergMarquardt` steps are controlled *by cost*: the next means have no
    higher cost than the present ones. Points that are returned are used in active runs alone.
    `weight` (runs,) is λ, the anchor's weight, of the next try.
    """

    def __init__(self, problem: Problem[S], damping: float | LevenbergMarquardt, runs: int) -> None:
        self.problem = cast(Controlled[S], problem)
        self.damping = damping
        first = damping.start if isinstance(damping, LevenbergMarquardt) else 0.0
        self.weight = np.full(runs, first)

    def narrowed(self, problem: Any, runs: Integers, point: Point) -> Point:
        """Go on with the problem of some runs alone; returns their part of a point."""
        self.problem, self.weight = problem, self.weight[runs]
        return point.of(runs)

    def feasible(self, first: Point, found: Point) -> Point:
        """The point from which the first step is made: `first`, if need be with other means.

        If steps are controlled by cost, its means are moved to where linear CPDs of singular noise
        hold exactly, so that the cost is finite. `found` is the solution of the model linearised at
        `first`.
        """
        if not isinstance(self.damping, LevenbergMarquardt):
            return first
        return first._replace(mean=self.problem.feasible(first.mean, found))

    def step(self, point: Point, found: Point, active: Mask) -> Point:
        """The next point, from the present `point` and `found`, the solution linearised there.

        `active` (runs,) marks the runs in which it is needed.
        """
        if isinstance(self.damping, LevenbergMarquardt):
            return found._replace(mean=self._accepted(self.damping, point, found, active))
        return point.mixed(found, self.damping) if self.damping else found

    def shown(self, solved: Array, point: Point, active: Mask) -> Array:
        """The means (steps, runs, n) to report as the result if this step is the last.

        They are `solved`, those of the solution. If steps are controlled by cost, they are those of
        the next point, `point`, in the runs that are active, (runs,).
        """
        if not isinstance(self.damping, LevenbergMarquardt):
            return solved
        return np.where(active[:, None], point.mean, solved)

    def _accepted(
        self, rule: LevenbergMarquardt, point: Point, found: Point, active: Mask
    ) -> Array:
        """Means (steps, runs, n) whose cost is no higher than that of the present `point`.

        In runs that are not `active` they are the point's own. In the others the means of `found`,
        the solution of the model linearised at the point, are tried first. In runs whose cost they
        raise, the model is solved again with an anchor at the point, whose weight λ is multiplied
        by `rule.factor` at each failure (Levenberg, 1944; Marquardt, 1963). Where none of
        `rule.tries` tries succeeds, the point's own means stay. A success divides the λ of the next
        step by the factor. λ is kept between `rule.start` and 10¹².
        """
        cost = self.problem.cost(point)
        # A point outside a function's domain, where it has no cost, is worse than any other.
        limit = np.where(np.isnan(cost), np.inf, cost + _NO_WORSE * np.abs(cost))
        mean = found.mean
        settled = ~active | (self.problem.cost(point._replace(mean=mean)) <= limit)
        self.weight = np.where(active & settled, self.weight / rule.factor, self.weight)
        for _ in range(rule.tries):
            if settled.all():
                break
            weight = np.where(settled, 0.0, self.weight)
            tried = self.problem.solve(Anchor(point.mean, found.std, weight)).means
            lower = self.problem.cost(point._replace(mean=tried)) <= limit
            good = ~settled & lower
            mean = np.where(good[:, None], tried, mean)
            change = np.where(good, 1.0 / rule.factor, rule.factor)
            self.weight = np.where(settled, self.weight, self.weight * change)
            settled = settled | good
        self.weight = np.clip(self.weight, rule.start, max(rule.start, _HEAVIEST))
        return np.where((settled & active)[:, None], mean, point.mean)
