"""Fixed-lag smoothing: each belief knows the readings of some further steps.

With one linearisation the filter's forward pass is reversed, and beliefs go back by a lag, all
steps at once. With more, a window slides along the chain: its CPDs are linearised at its smoothed
beliefs, and it is smoothed again from where it begins, until that settles. A window begins with the
belief at its first step given the readings up to there, as the window before has left it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from pgm.inference.chain import backward, careful, cost, forward
from pgm.inference.chain.adjoint import CarefulSmoothed
from pgm.inference.chain.backward import Beliefs, Reverse
from pgm.inference.chain.careful import Begin, Careful
from pgm.inference.chain.forward import Forward
from pgm.inference.chain.iteration import Anchor, iterate
from pgm.inference.chain.moments import largest
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.readings import Moments
from pgm.inference.chain.smoother import Chain, Either, Smoothed
from pgm.inference.schedule import ONCE, FixedLag
from pgm.inference.status import Status
from pgm.kernels.arrays import Array, Mask, stacked

Solved = TypeVar("Solved", Smoothed, CarefulSmoothed, covariant=True)


@dataclass(frozen=True, eq=False)
class Windows:
    """What the windows of a chain have left, each at its newest step.

    Attributes
    ----------
    newest : Beliefs
        Given the readings up to the step: (T+1, runs, n) and (T+1, runs, n, n).
    log_evidence : ndarray
        (T+1, runs): of the readings up to the step.
    """

    newest: Beliefs
    log_evidence: Array


@dataclass(frozen=True, eq=False)
class Lagged:
    """Beliefs given the readings up to a lag after each step.

    Attributes
    ----------
    forward : Forward
        The forward pass of the last linearisations.
    beliefs : Beliefs
    reverse : Reverse or None
        What reverses it, if it was needed.
    windows : Windows or None
        None where everything was linearised once.
    careful : Careful or None
        The forward pass in twice the digits.
    error : ndarray or None
        (runs,): of the means then; see `Belief.error`.
    """

    forward: Forward
    beliefs: Beliefs
    reverse: Reverse | None = None
    windows: Windows | None = None
    careful: Careful | None = None
    error: Array | None = None


def smooth(plan: ChainPlan, schedule: FixedLag) -> tuple[Lagged, Status]:
    """Run a fixed-lag schedule."""
    if _slides(plan, schedule):
        return _slid(plan, schedule, Floats())
    ahead, _ = forward.run(plan, ONCE)
    reverse = Reverse.make(plan, ahead)
    found = Lagged(ahead, backward.lagged(ahead, reverse, schedule.lag), reverse)
    return found, Status.of([], np.full(plan.runs, plan.exact), plan.lead)


def carefully(plan: ChainPlan, schedule: FixedLag) -> tuple[Lagged, Status]:
    """Run a fixed-lag schedule in twice the digits."""
    if _slides(plan, schedule):
        return _slid(plan, schedule, Digits())
    swept, _ = careful.sweep(plan, ONCE)
    made = CarefulSmoothed.of(plan, swept, schedule.lag)
    found = Lagged(swept.forward, made.beliefs, careful=swept, error=made.error)
    return found, Status.of([], np.full(plan.runs, plan.exact), plan.lead)


def _slides(plan: ChainPlan, schedule: FixedLag) -> bool:
    """Whether there is anything to iterate; also whether its steps can be controlled."""
    cost.require_cost(schedule.smoothing, plan.families)
    return schedule.iterations > 1 and not plan.exact


class Beginning(NamedTuple):
    """Where a window begins: a belief given the readings up to its step.

    Attributes
    ----------
    moments : (ndarray, ndarray)
        (n, *batch) and (n, n, *batch).
    careful : Begin or None
        The same in twice the digits.
    """

    moments: tuple[Array, Array]
    careful: Begin | None = None


@dataclass(frozen=True, eq=False)
class Window(Generic[Either]):
    """A window after its last iteration.

    Attributes
    ----------
    plan : ChainPlan
        With its last linearisations.
    solution : Smoothed or CarefulSmoothed
    mean : ndarray
        (steps, runs, n): its means, or those that the step control kept.
    residuals : list of ndarray
        (runs,) for each relinearisation.
    converged : ndarray of bool
        (runs,).
    """

    plan: ChainPlan
    solution: Either
    mean: Array
    residuals: list[Array]
    converged: Mask

    @property
    def beliefs(self) -> Beliefs:
        """Smoothed."""
        return Beliefs(self.mean, self.solution.beliefs.cov)

    @property
    def ahead(self) -> Forward:
        """The forward pass."""
        found = self.solution
        swept = found.careful.forward if isinstance(found, CarefulSmoothed) else found.forward
        assert isinstance(swept, Forward)
        return swept

    def at(self, row: int) -> Beginning:
        """The belief at a row given the readings there, for another window to begin with.

        A mean that the step control held back is held back here as much.
        """
        moved = self.mean[row] - self.solution.means[row]
        mean, cov, _ = Moments.of(self.plan, self.ahead.mean[row] + moved, self.ahead.cov[row])
        if not isinstance(self.solution, CarefulSmoothed):
            return Beginning((mean, cov))
        step = self.solution.careful.steps[row]
        return Beginning((mean, cov), Begin(step.known.shifted(moved), step.information))


class Way(Protocol[Solved]):
    """How windows are solved: in float64 or in twice the digits."""

    def once(self, plan: ChainPlan, begin: Beginning | None) -> None:
        """Linearise the CPDs of a plan at the beliefs of a filter."""
        ...

    def solve(self, plan: ChainPlan, begin: Beginning | None, anchor: Anchor | None) -> Solved:
        """Smooth as the CPDs are linearised."""
        ...


class Floats:
    """In float64."""

    def once(self, plan: ChainPlan, begin: Beginning | None) -> None:
        """Linearise the CPDs of a plan at the beliefs of a filter."""
        forward.run(plan, ONCE)

    def solve(self, plan: ChainPlan, begin: Beginning | None, anchor: Anchor | None) -> Smoothed:
        """Smooth as the CPDs are linearised."""
        return Smoothed.of(plan, forward.stored(plan, anchor))


class Digits:
    """In twice the digits."""

    def once(self, plan: ChainPlan, begin: Beginning | None) -> None:
        """Linearise the CPDs of a plan at the beliefs of a filter."""
        careful.sweep(plan, ONCE, begin=None if begin is None else begin.careful)

    def solve(
        self, plan: ChainPlan, begin: Beginning | None, anchor: Anchor | None
    ) -> CarefulSmoothed:
        """Smooth as the CPDs are linearised."""
        start = None if begin is None else begin.careful
        return CarefulSmoothed.of(plan, careful.sweep(plan, None, anchor, start)[0])


def settled(
    plan: ChainPlan, way: Way[Either], begin: Beginning | None, schedule: FixedLag
) -> Window[Either]:
    """Iterate on a window whose CPDs have been linearised."""
    linear = all(family.exact for family in plan.families if family.step.size)
    nothing = np.full(plan.runs, linear)
    solution = way.solve(plan, begin, None)
    if linear:
        return Window(plan, solution, solution.means, [], nothing)

    def solve(plan: ChainPlan, reference: Array, anchor: Anchor | None) -> Either:
        return way.solve(plan, begin, anchor)

    found = iterate(Chain(plan, solve), solution, schedule.smoothing, nothing)
    return Window(plan, found.solution, found.mean, found.residuals, found.converged)


class _Record:
    """What a window leaves as it slides along a chain."""

    def __init__(self, plan: ChainPlan) -> None:
        size, shape = plan.layout.slice_size, (plan.steps + 1, plan.runs)
        self.lead = plan.lead
        self.forward = Forward.empty(plan)
        self.beliefs, self.newest = (
            Beliefs(stacked(shape, (size,)), stacked(shape, (size, size))) for _ in range(2)
        )
        self.log_evidence, self.left = np.zeros(shape), np.zeros(plan.runs)
        self.residuals: list[Array] = []
        self.converged = np.ones(plan.runs, dtype=bool)
        self.steps: list[careful.Step] = []
        self.error = np.zeros(plan.runs)

    def leave(self, window: Window[Either]) -> None:
        """Leave the first step of a window behind, and the readings of the next with it."""
        self.left = self.left + window.ahead.log_density[:2].sum(axis=0)

    def keep(self, first: int, window: Window[Either]) -> None:
        """Keep the beliefs of a window that begins at a step."""
        out, ahead, beliefs = self.forward, window.ahead, window.beliefs
        begun = int(window.plan.begin is not None)
        step = first + window.plan.steps
        known, new = slice(first, step + 1), slice(first + begun, step + 1)
        out.mean[known], out.cov[known] = ahead.mean, ahead.cov
        out.predicted_mean[new] = ahead.predicted_mean[begun:]
        out.predicted_cov[new] = ahead.predicted_cov[begun:]
        out.log_density[new] = ahead.log_density[begun:]
        self.beliefs.mean[known], self.beliefs.cov[known] = beliefs.mean, beliefs.cov
        self.newest.mean[step], self.newest.cov[step] = beliefs.mean[-1], beliefs.cov[-1]
        self.log_evidence[step] = self.left + ahead.log_density.sum(axis=0)
        self.residuals = largest(self.residuals, window.residuals)
        self.converged &= window.converged
        if isinstance(window.solution, CarefulSmoothed):
            self.steps[new] = window.solution.careful.steps[begun:]
            self.error = np.maximum(self.error, window.solution.error)

    def found(self, last: Window[Either]) -> tuple[Lagged, Status]:
        """All of it, with the last window."""
        windows, digits, error = Windows(self.newest, self.log_evidence), None, None
        if isinstance(last.solution, CarefulSmoothed):
            digits = Careful(self.forward, self.steps, last.solution.careful.unknown)
            error = self.error
        found = Lagged(self.forward, self.beliefs, None, windows, digits, error)
        return found, Status.of(self.residuals, self.converged, self.lead)


def _slid(plan: ChainPlan, schedule: FixedLag, way: Way[Either]) -> tuple[Lagged, Status]:
    """Slide a window along the chain."""
    record = _Record(plan)
    begin: Beginning | None = None
    window: Window[Either] | None = None
    for step in range(plan.steps + 1):
        newest = None if window is None else window.at(-1)
        before = max(step - 1, 0)
        alone = _window(plan, before, step, newest)
        way.once(alone, newest)
        plan.put(before, alone)
        first = max(step - schedule.lag, 0)
        if first and window is not None:
            begin = window.at(1)
            record.leave(window)
        window = settled(_window(plan, first, step, begin), way, begin, schedule)
        plan.put(first, window.plan)
        record.keep(first, window)
    for family in plan.families:
        family.settle()
    assert window is not None
    return record.found(window)


def _window(plan: ChainPlan, first: int, last: int, begin: Beginning | None) -> ChainPlan:
    return plan.window(first, last, None if begin is None else begin.moments)
