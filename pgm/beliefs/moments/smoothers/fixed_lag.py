"""Fixed-lag smoothing: each belief knows the measurements of some further steps.

With one linearisation the filter's forward pass is reversed, and beliefs go back by the lag, all
steps at once. With more, a window slides along the chain. That of step s has the steps s − lag to
s; it begins with the belief at s − lag given the measurements up to there, as the window before has
left it, so that no measurement counts twice. It is linearised and smoothed until that settles, in
twice the digits (pairs of float64) where float64 has too few.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.compiled import windows
from pgm.beliefs.moments.digits import careful, certificate
from pgm.beliefs.moments.digits.adjoint import CarefulSmoothed
from pgm.beliefs.moments.digits.careful_belief import Belief, over
from pgm.beliefs.moments.digits.careful_pass import Begin, Careful
from pgm.beliefs.moments.passes import backward, forward
from pgm.beliefs.moments.passes.backward import Beliefs, Reverse
from pgm.beliefs.moments.passes.forward import Forward, joined
from pgm.beliefs.moments.smoothers.smoother import Chain, Either, swept
from pgm.beliefs.moments.steps import cost
from pgm.beliefs.moments.steps.account import Account
from pgm.beliefs.moments.steps.chain import largest
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.errors import NumericalError
from pgm.kernels.arrays import Array, Mask, stacked
from pgm.kernels.extended import Twofold
from pgm.posteriors.status import Status
from pgm.progress import counted
from pgm.schedules.iteration import Anchor, Iterated, iterate
from pgm.schedules.schedule import ONCE, Filtering, FixedLag


@dataclass(frozen=True, eq=False)
class Windows:
    """The results of each window of a chain at its newest step, (T+1, runs, ...).

    `newest` are the beliefs over each step given the measurements up to that step, and
    `log_evidence` (T+1, runs) is ln p of those measurements; `plain` says whether float64 had
    digits enough for all windows.
    """

    newest: Beliefs
    log_evidence: Array
    plain: bool


@dataclass(frozen=True, eq=False)
class Lagged:
    """Beliefs given the measurements up to a lag after each step.

    `forward` is the forward pass with the last linearisations. With one linearisation, `reverse` is
    the chain reversed in float64, or else `careful` the pass in twice the digits; with more, both
    are None, and `windows` has what the windows found. `error` (runs,) is the largest rounding
    error of a mean, in standard deviations, if anything was solved in twice the digits; else None.
    """

    forward: Forward
    beliefs: Beliefs
    reverse: Reverse | None = None
    windows: Windows | None = None
    careful: Careful | None = None
    error: Array | None = None


def slides(plan: ChainPlan, schedule: FixedLag) -> bool:
    """Whether windows slide: the schedule iterates, and a CPD is nonlinear or of robust noise."""
    return schedule.iterations > 1 and not plan.exact


def smooth(plan: ChainPlan, schedule: FixedLag) -> tuple[Lagged, Status]:
    """The beliefs with one linearisation, that of the filter, in float64; and their status.

    `plan` is over all steps, and keeps the linearisation. The status is converged only if every CPD
    is affine and no measurement has robust noise.
    """
    ahead, _ = forward.run(plan, schedule.first)
    reverse = Reverse.make(plan, ahead)
    found = Lagged(ahead, backward.lagged(ahead, reverse, schedule.lag), reverse)
    return found, Status.of([], np.full(plan.runs, plan.exact), plan.lead)


def carefully(plan: ChainPlan, schedule: FixedLag) -> tuple[Lagged, Status]:
    """The beliefs with one linearisation, the filter's, in twice the digits; and their status.

    The plan keeps the linearisation. The status is converged only if every CPD is affine and no
    measurement has robust noise.
    """
    swept, _ = careful.sweep(plan, schedule.first)
    made = CarefulSmoothed.of(plan, swept, schedule.lag)
    found = Lagged(swept.forward, made.beliefs, careful=swept, error=made.error)
    return found, Status.of([], np.full(plan.runs, plan.exact), plan.lead)


def slide(plan: ChainPlan, schedule: FixedLag) -> tuple[Lagged, Status]:
    """The beliefs by a window that slides along the chain, iterated at each step; and their status.

    The plan keeps the last linearisation of each CPD. Step control by a cost that would be infinite
    is refused with a ModelError (`require_cost`).
    """
    cost.require_cost(schedule.smoothing, plan.families)
    record = _Record(plan)
    slid = windows.slide(plan, schedule, record.room)
    if slid is None:
        _slide(plan, schedule, record)
    else:
        record.residuals, record.converged = slid.residuals, slid.converged
        for runs in slid.left:
            part = plan if runs == slice(0, plan.runs) else plan.of(runs)
            own = _Record(part)
            _slide(part, schedule, own)
            record.take(runs, own)
            if part is not plan:
                plan.put_runs(runs, part)
    for family in plan.families:
        family.settle()
    return record.found


def _slide(plan: ChainPlan, schedule: FixedLag, record: _Record) -> None:
    """Slide a window along a plan by the general kernels.

    The plan keeps the last linearisation of each CPD.
    """
    plan = replace(plan, layout=replace(plan.layout, compiled=False), account=Account())
    begin: Beginning | None = None
    window: Window | None = None
    for step in counted(range(plan.steps + 1), "windows"):
        before = None if window is None else window.at(-1)
        plan.put(max(step - 1, 0), filter_step(plan, step, before, schedule.first).plan)
        first = max(step - schedule.lag, 0)
        if first and window is not None:
            begin = window.at(1)
            record.leave(window)
        window = iterate_window(plan, first, step, begin, schedule)
        plan.put(first, window.plan)
        record.keep(first, window)


class _Record:
    """The results that windows produce as they slide along a chain, collected by step.

    `left` (runs,) is the log-evidence of the measurements that the belief at the beginning of the
    present window knows, zero as long as windows begin with the prior.
    """

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
        self.diffuse: Diffuse | None = None

    @property
    def room(self) -> windows.Room:
        """The arrays that windows fill."""
        ahead, beliefs, newest = self.forward, self.beliefs, self.newest
        return windows.Room(
            ahead.predicted,
            (ahead.mean, ahead.cov),
            ahead.log_density,
            (beliefs.mean, beliefs.cov),
            (newest.mean, newest.cov),
            self.log_evidence,
        )

    def take(self, runs: slice, part: _Record) -> None:
        """Take some runs from the record of these alone."""
        for mine, its in (
            (self.forward, part.forward),
            (self.beliefs, part.beliefs),
            (self.newest, part.newest),
        ):
            for name in ("predicted_mean", "predicted_cov", "mean", "cov", "log_density"):
                if hasattr(mine, name):
                    getattr(mine, name)[:, runs] = getattr(its, name)
        self.log_evidence[:, runs] = part.log_evidence
        count = len(self.converged)
        self.residuals = joined(self.residuals, part.residuals, runs, count)
        self.converged[runs] = part.converged
        if part.error is not None:
            error = np.zeros(count) if self.error is None else self.error
            error[runs] = part.error
            self.error = error

    def leave(self, window: Window) -> None:
        """Add to `left` the log-evidence of measurements that the next window does not have.

        The next window begins at the second step of `window`, with a belief that knows the
        measurements of the first two steps of `window`. If `window` itself began with a belief that
        knew the measurements of its first step, their share is in `left` already.
        """
        self.left = self.left + window.ahead.log_density[:2].sum(axis=0)

    def keep(self, first: int, window: Window) -> None:
        """Copy a window's beliefs to the record, from step `first`; overlapping steps are replaced.

        The log-evidence up to the window's last step is `left` plus that of the window.
        """
        out, ahead, beliefs = self.forward, window.ahead, window.beliefs
        begun, step = int(window.plan.begin is not None), first + window.plan.steps
        known, new = slice(first, step + 1), slice(first + begun, step + 1)
        out.mean[known], out.cov[known] = ahead.mean, ahead.cov
        out.predicted_mean[new] = ahead.predicted_mean[begun:]
        out.predicted_cov[new] = ahead.predicted_cov[begun:]
        out.log_density[new] = ahead.log_density[begun:]
        self._keep_open(new, ahead, begun)
        self.beliefs.mean[known], self.beliefs.cov[known] = beliefs.mean, beliefs.cov
        self.newest.mean[step], self.newest.cov[step] = beliefs.mean[-1], beliefs.cov[-1]
        self.log_evidence[step] = self.left + ahead.log_density.sum(axis=0)
        self.residuals = largest(self.residuals, window.residuals)
        self.converged &= window.converged
        if window.careful is not None:
            error = window.careful.error
            self.error = error if self.error is None else np.maximum(self.error, error)

    def _keep_open(self, new: slice, ahead: Forward, begun: int) -> None:
        """Keep which directions a flat prior has left unknown in the predictions at steps `new`.

        `ahead` is the forward pass of a window, whose rows from `begun` on are these steps. Nothing
        is kept until some window has an unknown direction; from then on the covariances of all
        windows are kept as `Diffuse` ones, with or without unknown directions.
        """
        if ahead.diffuse is not None and self.diffuse is None:
            shape, size = self.forward.mean.shape, ahead.diffuse.open.shape[-1]
            cov = stacked(shape[:2], shape[2:] * 2)
            cov[...] = self.forward.predicted_cov
            self.diffuse = Diffuse(cov, np.zeros((*shape, size)), np.zeros((*shape, size)))
        if self.diffuse is not None:
            cov, open_, size_ = self.diffuse
            if ahead.diffuse is None:
                cov[new], open_[new] = ahead.predicted_cov[begun:], 0.0
            else:
                cov[new], open_[new], size_[new] = ahead.diffuse.at(slice(begun, None))

    @property
    def found(self) -> tuple[Lagged, Status]:
        """The recorded beliefs with their status."""
        slid = Windows(self.newest, self.log_evidence, self.error is None)
        ahead = replace(self.forward, diffuse=self.diffuse)
        found = Lagged(ahead, self.beliefs, windows=slid, error=self.error)
        return found, Status.of(self.residuals, self.converged, self.lead)


class Beginning(NamedTuple):
    """The belief (runs, n) at a window's first step, given the measurements up to there.

    `mean` is (runs, n), `cov` (runs, n, n). `careful` is the same belief in twice the digits, if it
    was found so, else None: in float64 a belief may do for a window, and yet have too few digits
    for a later window that is solved in twice the digits.
    """

    mean: Array
    cov: Array
    careful: Begin | None = None

    @property
    def plain(self) -> bool:
        """Whether float64 has digits enough for the belief."""
        return self.careful is None or certificate.is_ordinary(self.mean, self.cov)

    def over(self, runs: int) -> Beginning:
        """The belief for a number of `runs`; that of one run is copied for each."""
        found: Beginning = self if len(self.mean) == runs else over(self, (), (runs,))
        return found

    def cut(self, plan: ChainPlan, first: int, last: int) -> ChainPlan:
        """The plan of the steps first..last, which begins with this belief in place of a prior.

        `plan` is that of the whole chain.
        """
        begin = self.over(plan.runs)
        mean, cov = Moments.of(plan, begin.mean, begin.cov)
        return plan.window(first, last, (mean, cov))

    @property
    def in_digits(self) -> Begin:
        """The belief in twice the digits: `careful`, or else made from the moments in float64."""
        if self.careful is not None:
            return self.careful
        return Begin(Belief.of(self.mean, self.cov), Twofold.zeros((len(self.mean), 1, 1)))


@dataclass(frozen=True, eq=False)
class Window:
    """A window after its last iteration: its forward pass `ahead`, and its smoothed `beliefs`.

    `moved` (steps, runs, n) is `beliefs.mean` less the means of the last solution, zero unless a
    step control kept other means than the solution's. `residuals` has for each relinearisation the
    largest distance of a mean from where it was linearised, in standard deviations, (runs,);
    `converged` (runs,) marks the runs that settled. `careful` is the solution in twice the digits,
    where float64 had too few.
    """

    plan: ChainPlan
    ahead: Forward
    beliefs: Beliefs
    moved: Array
    residuals: list[Array]
    converged: Mask
    careful: CarefulSmoothed | None

    def at(self, row: int) -> Beginning:
        """The filtered belief at a row, one step of the window, for another window to begin with.

        Its mean is the forward pass's plus that row of `moved`.
        """
        mean, cov = self.ahead.mean[row] + self.moved[row], self.ahead.cov[row]
        if self.careful is None:
            return Beginning(mean, cov)
        taken = self.careful.careful.steps[row].taken
        begin = Begin(taken.belief.shifted(self.moved[row]), taken.information)
        return Beginning(mean, cov, begin)


class SingleStep(NamedTuple):
    """One step of a filter, the newest of a window: its plan, linearised, and its forward pass.

    `error` (runs,) is the largest rounding error of a mean, in standard deviations, if the step
    took twice the digits; else None.
    """

    plan: ChainPlan
    ahead: Forward
    error: Array | None


def filter_step(
    plan: ChainPlan, step: int, begin: Beginning | None, schedule: Filtering = ONCE
) -> SingleStep:
    """Filter one step of a plan, its transition and its measurements, from `begin`.

    `begin` is the belief at the step before, given its measurements; None for step 0, which has the
    prior in place of a transition. Unless a schedule is given, each CPD is linearised once. The
    step is filtered in twice the digits where float64 has too few.
    """
    first = max(step - 1, 0)
    alone, begin = _cut(plan, first, step, begin)
    if _is_plain(alone, begin):
        try:
            ahead, _ = forward.run(alone, schedule)
            if certificate.suffices(alone, ahead):
                return SingleStep(alone, ahead, None)
        except NumericalError:
            pass  # with twice the digits there may be an answer; if not, the same is refused
        alone, begin = _cut(plan, first, step, begin)
    start = None if begin is None else begin.in_digits
    swept, _ = careful.sweep(alone, schedule, begin=start)
    return SingleStep(alone, swept.forward, swept.error)


def iterate_window(
    plan: ChainPlan, first: int, last: int, begin: Beginning | None, schedule: FixedLag
) -> Window:
    """Smooth the window of the steps first..last, linearised again and again until it settles.

    `begin` is the belief at step `first`, given its measurements; None for the prior. `plan` is
    over all steps, and must have each CPD of the window linearised already. The window is solved in
    twice the digits where float64 has too few.
    """
    part, begin = _cut(plan, first, last, begin)
    if _is_plain(part, begin):
        try:
            found = _settled(Chain(part, swept), schedule)
            ahead = found.solution.forward
            assert isinstance(ahead, Forward)
            if certificate.suffices(part, ahead, found.solution.beliefs.cov):
                return _window(part, ahead, found, None)
        except NumericalError:
            pass
        part, begin = _cut(plan, first, last, begin)
    start = None if begin is None else begin.in_digits

    def solve(plan: ChainPlan, reference: Array, anchor: Anchor | None) -> CarefulSmoothed:
        return CarefulSmoothed.of(plan, careful.sweep(plan, None, anchor, start)[0])

    precise = _settled(Chain(part, solve), schedule)
    return _window(part, precise.solution.careful.forward, precise, precise.solution)


def _cut(
    plan: ChainPlan, first: int, last: int, begin: Beginning | None
) -> tuple[ChainPlan, Beginning | None]:
    """The plan of the steps first..last, and the belief that it begins with.

    `begin` is the belief at step `first`, given its measurements, and is returned with a copy for
    each run of the plan if it has one run only. If it is None, the plan begins with the prior, and
    None is returned in its place.
    """
    if begin is None:
        return plan.window(first, last), None
    return begin.cut(plan, first, last), begin.over(plan.runs)


def _is_plain(plan: ChainPlan, begin: Beginning | None) -> bool:
    """Whether float64 may solve a window: its prior is finite, its beginning, if any, `plain`."""
    return not certificate.is_flat(plan) and (begin is None or begin.plain)


def _settled(chain: Chain[Either], schedule: FixedLag) -> Iterated[Either]:
    """Smooth a window again and again, as the schedule says, until its means settle.

    `chain` has the window's plan, linearised already, and the solver. Returns the last solution,
    its means as step control left them, and which runs converged. A linear window is settled by its
    first solution.
    """
    plan = chain.plan
    linear = all(family.settled for family in plan.families if family.step.size)
    nothing = np.full(plan.runs, linear)
    return iterate(chain, chain.solve(), schedule.smoothing, nothing)


def _window(
    plan: ChainPlan, ahead: Forward, found: Iterated[Either], careful: CarefulSmoothed | None
) -> Window:
    """The window that `found` has solved, with the forward pass `ahead` of its last solution.

    Step control may have moved its means off the solution's. `careful` is that solution in twice
    the digits, None for one in float64.
    """
    solved = found.solution
    beliefs, moved = Beliefs(found.mean, solved.beliefs.cov), found.mean - solved.means
    return Window(plan, ahead, beliefs, moved, found.residuals, found.converged, careful)
