"""Relinearising chains and trees: linearise, solve, choose the next point, until it stays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, cast

import numpy as np

from pgm.inference.damping import LevenbergMarquardt
from pgm.inference.schedule import Filtering, Smoothing
from pgm.kernels import moments
from pgm.kernels.arrays import Array, Index, Mask, block
from pgm.progress import counted

# A cost that rises by no more than this part is no worse: it is rounding.
_NO_WORSE = 1e-13
# A weight beyond which a held step is rounding.
_HEAVIEST = 1e12


class Point(NamedTuple):
    """A point of linearisation: mean (steps, runs, n) and cov (steps, runs, n, n).

    `joint` (steps − 1, runs, m, m) are covariances of pairs, where a CPD needs more than states.
    `proper` is `cov` along all directions that are known, where variances of components are
    infinite.
    """

    mean: Array
    cov: Array
    joint: Array | None = None
    proper: Array | None = None

    @property
    def known_cov(self) -> Array:
        """The covariance, finite, of all that measurements have read."""
        return self.cov if self.proper is None else self.proper

    @property
    def std(self) -> Array:
        """Standard deviations of all that is known, (steps, runs, n)."""
        return np.sqrt(np.maximum(np.diagonal(self.known_cov, axis1=-2, axis2=-1), 0.0))

    def start(self, states: Index) -> tuple[Array, Array]:
        """Moments of the states at step 0, (1, runs, ...)."""
        return self.mean[:1][..., states], block(self.cov[:1], states, states)

    def pairs(self, states: Index, places: Index) -> tuple[Array, Array]:
        """Moments of some components of the pairs: the states before each step, and its slice."""
        before, cov = self.mean[:-1][..., states], self.cov[:-1]
        front = before.shape[-1]
        if (places.stop if isinstance(places, slice) else places.max(initial=-1) + 1) <= front:
            return before[..., places], block(block(cov, states, states), places, places)
        assert self.joint is not None
        pair = np.concatenate([before, self.mean[1:]], axis=-1)
        return pair[..., places], block(self.joint, places, places)

    def mixed(self, other: Point, share: float) -> Point:
        """A share of this point, and the rest of another."""
        pairs = zip(self, other, strict=True)
        return Point._make(
            None if mine is None or its is None else share * mine + (1.0 - share) * its
            for mine, its in pairs
        )


class Anchor(NamedTuple):
    """A measurement (steps, runs, n) of all components that holds a solution near a point.

    `weight` (runs,) is λ, `std` that of λ = 1; nothing is held where one of them is zero.
    """

    mean: Array
    std: Array
    weight: Array

    def at(self, step: int) -> Anchor:
        """The anchor of one step."""
        one = slice(step, step + 1)
        return Anchor(self.mean[one], self.std[one], self.weight)

    def hold(self, step: int, mean: Array, cov: Array) -> tuple[Array, Array]:
        """Take the measurement of a step into a belief, (runs, n) and (runs, n, n)."""
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
    """The solution of a linearised model."""

    @property
    def means(self) -> Array:
        """Its means, (steps, runs, n)."""

    @property
    def point(self) -> Any:
        """Its moments: a `Point`, or, of steps that are not controlled, all with means and std."""


S = TypeVar("S", bound=Solution)
Found = TypeVar("Found", bound=Solution, covariant=True)


class Problem(Protocol[Found]):
    """A model that can be linearised and solved."""

    def linearise(self, at: Any, active: Mask) -> None:
        """Linearise at the point of a solution, for the runs that are active."""

    def solve(self, anchor: Anchor | None = None) -> Found:
        """The solution of the model as it is linearised."""

    def settled(self) -> Mask | bool:
        """Whether a model that changes from iteration to iteration is the one asked for."""


class Controlled(Problem[Found], Protocol[Found]):
    """A model whose steps can be controlled by their cost."""

    def cost(self, at: Point) -> Array:
        """The cost of means with the covariances given, the noise as linearised, (runs,)."""

    def feasible(self, mean: Array, found: Point) -> Array:
        """Means projected onto exact linear CPDs, off whose solutions no cost is finite."""


@dataclass(frozen=True, eq=False)
class Iterated(Generic[S]):
    """The result of an iteration, of the last linearisation.

    The means are the solution's, or those that the step control kept; residuals (runs,) of each
    relinearisation tell how far the solution is from where it was linearised.
    """

    solution: S
    mean: Array
    residuals: list[Array]
    converged: Mask


def iterate(
    problem: Problem[S],
    solution: S,
    schedule: Filtering | Smoothing,
    converged: Mask,
    first: Point | None = None,
) -> Iterated[S]:
    """Relinearise from the first solution on, made at `first` if at one point, as scheduled.

    Runs that have `converged` stay.
    """
    control = _Control(problem, schedule.damping, converged.size)
    residuals: list[Array] = []
    mean = solution.means
    if not converged.all():
        point = solution.point
        if first is not None:
            point = control.step(control.feasible(first, point), point, ~converged)
            mean = control.shown(mean, point, ~converged)
    for _ in counted(range(schedule.iterations - 1), "linearisations"):
        if converged.all():
            break
        active = ~converged
        problem.linearise(point, active)
        solution = problem.solve()
        found = solution.point
        residual = moments.moved(found.mean, point.mean, found.std)
        residuals.append(np.where(active, residual, residuals[-1]) if residuals else residual)
        converged = converged | ((residual <= schedule.tolerance) & problem.settled())
        point = control.step(point, found, active)
        shown = control.shown(found.mean, point, active)
        mean = shown if active.all() else np.where(active[:, None], shown, mean)
    return Iterated(solution, mean, residuals, converged)


class _Control:
    """The choice of the next point of linearisation; of runs not active it is of no account."""

    def __init__(self, problem: Problem[S], damping: float | LevenbergMarquardt, runs: int) -> None:
        self.problem = cast(Controlled[S], problem)
        self.damping = damping
        first = damping.start if isinstance(damping, LevenbergMarquardt) else 0.0
        self.weight = np.full(runs, first)

    def feasible(self, first: Point, found: Point) -> Point:
        """The first point, with means that have a cost where steps are controlled by theirs."""
        if not isinstance(self.damping, LevenbergMarquardt):
            return first
        return first._replace(mean=self.problem.feasible(first.mean, found))

    def step(self, point: Point, found: Point, active: Mask) -> Point:
        """The point after this one, from which its linearisation has led to what was found."""
        if isinstance(self.damping, LevenbergMarquardt):
            return found._replace(mean=self._accepted(self.damping, point, found, active))
        return point.mixed(found, self.damping) if self.damping else found

    def shown(self, solved: Array, point: Point, active: Mask) -> Array:
        """The means to report: the solution's, or the point's where a control holds back."""
        if not isinstance(self.damping, LevenbergMarquardt):
            return solved
        return np.where(active[:, None], point.mean, solved)

    def _accepted(
        self, rule: LevenbergMarquardt, point: Point, found: Point, active: Mask
    ) -> Array:
        """Means whose cost is no higher than the point's; those of the point where none is found.

        A Gauss–Newton step that raises the cost is tried again with the weight of an anchor at the
        point, of which each try takes `factor` times as much (Levenberg, 1944; Marquardt, 1963). A
        run whose step was good begins its next one with a weight less by that factor.
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
