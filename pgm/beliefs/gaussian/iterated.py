"""A tree that is solved, linearised and weighed at its beliefs, and solved again, until it stays.

The steps from one linearisation to the next are controlled as those of chains are
(`pgm.schedules.iteration`): by a share, or by their cost.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from pgm.beliefs.gaussian.beliefs import Calibrated, TreePoint, relinearise
from pgm.beliefs.gaussian.cost import cost
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.relations import Relations
from pgm.beliefs.gaussian.reweighting import reweigh, settled
from pgm.kernels import moments
from pgm.kernels.arrays import Array, Mask
from pgm.kernels.settling import TOLERANCE
from pgm.posteriors.status import Status
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.iteration import Anchor, Iterated, iterate
from pgm.schedules.schedule import Calibration, Schedule, Smoothing

# The weight of an anchor that moves no further than relations without noise ask for.
_HEAVY = 1e12
# Deviations below which means are those of a solution, but for rounding.
_EQUAL = 1e-6


def is_controlled(schedule: Schedule | None) -> bool:
    """Whether the steps of a schedule are controlled by their cost, by anchors."""
    return isinstance(schedule, Calibration) and isinstance(schedule.damping, LevenbergMarquardt)


class Solver(Protocol):
    """A way to solve a tree as its CPDs are linearised now."""

    def solve(self, anchor: Anchor | None = None, *, to_move: bool = False) -> Calibrated:
        """The beliefs, with an anchor's measurement, if any; maybe of fewer digits, `to_move`."""


def iterated(
    model: Model, solver: Solver, schedule: Schedule | None, *, started: bool
) -> tuple[Calibrated, Status]:
    """Solve, linearise at the beliefs, and solve again, until the means stay.

    They stay when no mean moves by more than the schedule's tolerance, in standard deviations. A
    schedule of k iterations solves at most k times, the first included. Any schedule but a
    `Calibration`, and None, counts as `Calibration()`. `started` says that the model is linearised
    at a user's start: robust readings are weighed there, and else have weights of one until the
    first solution is known, since the prior may be far from it. The first step is controlled from a
    start, and by Taylor's rule from the prior's means; other rules are of the prior's covariances,
    which are not kept. Returns the last solution, with the means to report, and the status of
    convergence.
    """
    asked = schedule if isinstance(schedule, Calibration) else Calibration()
    nothing, begin = np.full(model.runs, model.settled), None
    if not model.settled and (started or model.taylor):
        std = np.broadcast_to(model.frame.scale, model.frame.mean.shape)
        begin = TreePoint(model.frame.mean[None], std[None], None)
    if started and begin is not None:
        reweigh(model, begin, ~nothing)
    if model.settled or (asked.iterations == 1 and (begin is None or not is_controlled(asked))):
        return solver.solve(), Status.of([], nothing, model.lead)
    kind = _Controlled if is_controlled(asked) else _Tree
    tree = kind(model, solver, asked.tolerance, at=begin)
    found = iterate(tree, tree.solve(), asked, nothing, begin)
    tree.to_move = False
    done = found.solution if found.solution is tree.given else tree.solve()
    residuals, converged = found.residuals, found.converged
    mean = _reported(found, done)
    # The means of a solution that was one to move by may be wrong where it lost digits.
    off = moments.moved(done.means, found.solution.means, done.point.std)
    left = asked.iterations - 1 - len(residuals)
    if (off > max(asked.tolerance, TOLERANCE)).any() and left > 0:
        limits = Smoothing(left + 1, asked.tolerance, asked.damping)
        again = iterate(tree, done, limits, nothing, tree.at)
        done, mean, converged = again.solution, again.mean, again.converged
        residuals = [*residuals, *again.residuals]
    if not np.array_equal(mean[0], done.beliefs.components()[0]):
        done = replace(done, beliefs=done.beliefs.with_means(mean[0]), moved=None)
    return done, Status.of(residuals, converged, model.lead)


def _reported(found: Iterated[Calibrated], done: Calibrated) -> Array:
    """The means to report, (1, runs, size): those of the last solution, made `done` to all digits.

    Where the control of steps kept others, they are these.
    """
    kept = moments.moved(found.mean, found.solution.means, done.point.std) > _EQUAL
    return np.where(kept[:, None], found.mean, done.means)


@dataclass(eq=False)
class _Tree:
    """A tree as a `Problem` of `pgm.schedules.iteration`: linearised at any point, and solved.

    `solver` solves it with the CPDs of `model` as they are linearised now; it is told that a
    solution is one `to_move` by, not to be given, unless the last two steps let expect that the
    next is within the `tolerance`. `at` is the point where it was linearised last, `given` the
    last solution that may be given.
    """

    model: Model
    solver: Solver
    tolerance: float
    at: TreePoint | None
    to_move: bool = True
    given: Calibrated | None = None
    _steps: list[float] = field(default_factory=list)

    def linearise(self, at: TreePoint, active: Mask) -> None:
        """Linearise each nonlinear CPD, and weigh robust readings, at a point, in active runs.

        `active` (runs,) marks these runs.
        """
        assert at.beliefs is not None
        relinearise(at.beliefs, self.model, active, at.mean[0])
        reweigh(self.model, at, active)
        if self.at is not None:
            at = at._replace(mean=np.where(active[:, None], at.mean, self.at.mean))
            self._steps.append(float(moments.moved(at.mean, self.at.mean, at.std).max()))
        self.at = at

    def settled(self) -> Mask | bool:
        """Whether graduated robust losses have reached the losses of the model, (runs,)."""
        return settled(self.model)

    def solve(self, anchor: Anchor | None = None) -> Calibrated:
        """The tree with the CPDs as they are linearised now, and an anchor's measurement."""
        to_move = self.to_move and (anchor is not None or not self._arrives)
        solved = self.solver.solve(anchor, to_move=to_move)
        done = self._feasible(solved)
        if not to_move:
            self.given = done
        return done

    @property
    def _arrives(self) -> bool:
        """Whether the next step is within the tolerance, if steps go on to shrink as they do."""
        if len(self._steps) < 2:
            return False
        before, last = self._steps[-2:]
        return last**2 <= self.tolerance * before

    def _feasible(self, done: Calibrated) -> Calibrated:
        return done


class _Controlled(_Tree):
    """A tree whose steps are controlled by their cost: its solutions obey nonlinear relations."""

    @cached_property
    def relations(self) -> Relations:
        """The relations of CPDs of singular noise."""
        return Relations.of(self.model)

    def solve(self, anchor: Anchor | None = None) -> Calibrated:
        """The solution, with means that obey nonlinear relations themselves, not their lines."""
        _ = self.relations  # which are refused before the work
        return _Tree.solve(self, anchor)

    def _feasible(self, done: Calibrated) -> Calibrated:
        if not self.relations.nonlinear:
            return done
        return replace(done, moved=self.relations.retracted(done.means[0]))

    def cost(self, at: TreePoint) -> Array:
        """The cost of a point's means, (runs,); infinite where no retraction was found for them."""
        found = cost(self.model, at)
        return np.where(self.relations.kept(at.mean[0]), found, np.inf)

    def feasible(self, mean: Array, found: TreePoint) -> Array:
        """The means (1, runs, size) nearest to `mean` that obey all exact relations.

        Distances are counted in standard deviations of `found`, the solution of the tree linearised
        at `mean`.
        """
        kept = self.relations.retracted(mean[0])[None]
        obeyed = self.relations.obeyed(kept[0])
        if obeyed.all():
            return kept
        weight = np.where(obeyed, 0.0, _HEAVY)
        nearest = self.solve(Anchor(kept, found.std, weight)).means
        return np.where(obeyed[:, None], kept, nearest)
