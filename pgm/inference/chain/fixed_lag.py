"""Fixed-lag smoothing: each belief knows the readings of some further steps.

With one linearisation the filter's forward pass is reversed, and beliefs go back by a lag, all
steps at once. With more, a window slides along the chain: its CPDs are linearised at its smoothed
beliefs, and it is smoothed again from where it begins, until that settles. A window begins with the
belief at its first step given the readings up to there, as the window before has left it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.inference.chain import backward, careful, cost, forward
from pgm.inference.chain.adjoint import CarefulSmoothed
from pgm.inference.chain.backward import Beliefs, Reverse
from pgm.inference.chain.careful import Careful
from pgm.inference.chain.forward import Forward
from pgm.inference.chain.moments import largest
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.window import Beginning, Window, newest, settled
from pgm.inference.schedule import ONCE, FixedLag
from pgm.inference.status import Status
from pgm.kernels.arrays import Array, stacked


@dataclass(frozen=True, eq=False)
class Windows:
    """The results of the windows of a chain, each at its newest step.

    Attributes
    ----------
    newest : Beliefs
        Given the readings up to the step: (T+1, runs, n) and (T+1, runs, n, n).
    log_evidence : ndarray
        (T+1, runs): of the readings up to the step.
    plain : bool
        Whether float64 had digits enough for all of them.
    """

    newest: Beliefs
    log_evidence: Array
    plain: bool


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
        The forward pass in twice the digits, if everything was linearised once.
    error : ndarray or None
        (runs,): of the means, where anything was solved in twice the digits; see `Belief.error`.
    """

    forward: Forward
    beliefs: Beliefs
    reverse: Reverse | None = None
    windows: Windows | None = None
    careful: Careful | None = None
    error: Array | None = None


def slides(plan: ChainPlan, schedule: FixedLag) -> bool:
    """Whether there is anything to iterate."""
    return schedule.iterations > 1 and not plan.exact


def smooth(plan: ChainPlan, schedule: FixedLag) -> tuple[Lagged, Status]:
    """Linearise once, in float64."""
    ahead, _ = forward.run(plan, ONCE)
    reverse = Reverse.make(plan, ahead)
    found = Lagged(ahead, backward.lagged(ahead, reverse, schedule.lag), reverse)
    return found, Status.of([], np.full(plan.runs, plan.exact), plan.lead)


def carefully(plan: ChainPlan, schedule: FixedLag) -> tuple[Lagged, Status]:
    """Linearise once, in twice the digits."""
    swept, _ = careful.sweep(plan, ONCE)
    made = CarefulSmoothed.of(plan, swept, schedule.lag)
    found = Lagged(swept.forward, made.beliefs, careful=swept, error=made.error)
    return found, Status.of([], np.full(plan.runs, plan.exact), plan.lead)


def slid(plan: ChainPlan, schedule: FixedLag) -> tuple[Lagged, Status]:
    """Slide a window along the chain."""
    cost.require_cost(schedule.smoothing, plan.families)
    record = _Record(plan)
    begin: Beginning | None = None
    window: Window | None = None
    for step in range(plan.steps + 1):
        before = None if window is None else window.at(-1)
        plan.put(max(step - 1, 0), newest(plan, step, before).plan)
        first = max(step - schedule.lag, 0)
        if first and window is not None:
            begin = window.at(1)
            record.leave(window)
        window = settled(plan, first, step, begin, schedule)
        plan.put(first, window.plan)
        record.keep(first, window)
    for family in plan.families:
        family.settle()
    return record.found


class _Record:
    """A record of what windows leave as they slide along a chain."""

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
        self.error: Array | None = None

    def leave(self, window: Window) -> None:
        """Leave the first step of a window behind, and the readings of the next with it."""
        self.left = self.left + window.ahead.log_density[:2].sum(axis=0)

    def keep(self, first: int, window: Window) -> None:
        """Keep the beliefs of a window that begins at a step."""
        out, ahead, beliefs = self.forward, window.ahead, window.beliefs
        begun, step = int(window.plan.begin is not None), first + window.plan.steps
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
        if window.careful is not None:
            error = window.careful.error
            self.error = error if self.error is None else np.maximum(self.error, error)

    @property
    def found(self) -> tuple[Lagged, Status]:
        """All of it."""
        windows = Windows(self.newest, self.log_evidence, self.error is None)
        found = Lagged(self.forward, self.beliefs, windows=windows, error=self.error)
        return found, Status.of(self.residuals, self.converged, self.lead)
