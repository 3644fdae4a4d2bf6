"""The steps behind the belief of an online filter with a lag.

With one linearisation there is a *trail*: the transitions of the last steps, over which a lagged
belief is smoothed backwards when it is asked for. With more there is a sliding *window*: its steps
are linearised and smoothed at each update until they settle, as along a recorded chain. A *plan*
(`ChainPlan`) lays out CPDs and their evidence for some steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, NoReturn

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.digits.certificate import MODERATE
from pgm.beliefs.moments.digits.reversal_rounding import TOLD, accumulated, injected
from pgm.beliefs.moments.passes.backward import Reverse, between_slices
from pgm.beliefs.moments.smoothers.fixed_lag import (
    Beginning,
    SingleStep,
    Window,
    filter_step,
    iterate_window,
)
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.errors import NumericalError
from pgm.evidence import BoundEvidence, Reading
from pgm.evidence.dynamic import Inputs
from pgm.kernels import moments
from pgm.kernels.arrays import Array, Kind, sandwich
from pgm.kernels.moments import Conditional
from pgm.linearisation.rows import At
from pgm.networks import DynamicBayesianNetwork
from pgm.schedules.late import NOTHING, Log
from pgm.schedules.schedule import ONCE, FixedLag

# Makes the plan of the evidence of steps, whose first has the number given, with the prior or not.
Make = Callable[[BoundEvidence, int, bool], ChainPlan]


class Entry(NamedTuple):
    """The evidence of a step of a window.

    `motion` has, for each CPD of the transition to the step, its inputs, (1, runs or 1, d) by
    variable. Step 0 has no transition: its inputs are arrays without rows, (0, 1, d). `readings`
    has an element for each update of the step and each sensor measured in it.
    """

    motion: tuple[Inputs, ...]
    readings: tuple[Reading, ...] = ()


@dataclass(frozen=True, eq=False)
class Sliding:
    """The sliding window that ends at a belief's step, and all that it is computed from.

    `entries` are the evidence of the steps whose CPDs are in it. `window` is the settled window,
    None while nothing has been read at its newest step; `before` is that of the step before, None
    at step 0. `left` (runs,) is the log-evidence of the steps that have left the window, in nats.
    `lead` is the shape of the user's axes of runs. `log` has what late readings ask for. Methods
    take the filter's `make`, which makes the plan of some steps from their evidence.
    """

    schedule: FixedLag
    lead: tuple[int, ...]
    entries: tuple[Entry, ...]
    before: Window | None
    window: Window | None
    left: Array
    log: Log = NOTHING

    @property
    def lag(self) -> int:
        """How many steps it spans."""
        return self.schedule.lag

    def logged(self, log: Log) -> Sliding:
        """The same window with another log."""
        return replace(self, log=log)

    @classmethod
    def first(cls, schedule: FixedLag, model: DynamicBayesianNetwork) -> Sliding:
        """The window at step 0, with the prior and no measurements."""
        motion = tuple(
            {v: np.zeros((0, 1, v.dimension)) for v in cpd.parents if v in model.inputs}
            for cpd in model.transition
        )
        return cls(schedule, model.lead, (Entry(motion),), None, None, np.zeros(1))

    def on(self, make: Make, motion: tuple[Inputs, ...], lead: tuple[int, ...]) -> Sliding:
        """The window one step later, at whose newest step nothing has been read yet.

        `motion` has the inputs of the transition to that step (see `Entry`), `lead` the shape of
        the axes of runs from then on. The present window is settled first. If it spans the lag, its
        oldest step is left behind with the linearisations that it has.
        """
        window, kept, left = self.settled(make), self.entries, self.left
        if window.plan.steps == self.schedule.lag:
            # The step after the beginning is left behind, as it was linearised last.
            kept = kept[len(kept) + 1 - self.schedule.lag :]
            left = left + window.ahead.log_density[:2].sum(axis=0)
        return Sliding(self.schedule, lead, (*kept, Entry(motion)), window, None, left, self.log)

    def read(self, make: Make, readings: tuple[Reading, ...], lead: tuple[int, ...]) -> Sliding:
        """The window settled again with further measurements of its newest step.

        `readings` has the measurements of an update, one element for each sensor; `lead` is the
        shape of the axes of runs from then on.
        """
        *others, last = self.entries
        last = last._replace(readings=(*last.readings, *readings))
        found = replace(self, lead=lead, entries=(*others, last), window=None)
        return replace(found, window=found.settled(make))

    def settled(self, make: Make) -> Window:
        """The settled window; if it is not yet settled, it is linearised and smoothed first.

        What is computed here is returned, not kept.
        """
        if self.window is not None:
            return self.window
        plan, begin = self._laid(make)
        return iterate_window(plan, 0, plan.steps, begin, self.schedule)

    def ahead(self, make: Make, step: int) -> SingleStep:
        """The newest step, number `step`, with its belief predicted from the step before.

        It is called while nothing has been read at the newest step. The other steps of the window
        are neither linearised nor smoothed.
        """
        begun = self.before is not None
        plan = make(_joined(self.entries[-1:], self.lead, begun=begun), step - begun, not begun)
        return filter_step(plan, plan.steps, self._newest)

    @property
    def _newest(self) -> Beginning | None:
        """The belief at the step before the newest one, given all measurements up to that step.

        It is the newest of the window that ended there; None at step 0.
        """
        return None if self.before is None else self.before.at(-1)

    @property
    def log_evidence(self) -> Array:
        """The log-evidence so far, (runs,), in nats; the window has to be settled."""
        assert self.window is not None
        total: Array = self.left + self.window.ahead.log_density.sum(axis=0)
        return total

    def lagged(self, step: int, mean: Array, cov: Array) -> tuple[int, Array, Array]:
        """The step a lag before `step`, 0 at the least, and the smoothed mean and covariance there.

        Before anything has been read at `step`, they are those of the window of the step before;
        with no window at all, the given `step`, `mean` and `cov`. Arrays are (*lead, ...).
        """
        window = self.window or self.before
        if window is None:
            return step, mean, cov
        first = max(step - self.schedule.lag, 0)
        row = first - window.plan.first
        parts = window.beliefs.mean[row], window.beliefs.cov[row]
        runs = math.prod(self.lead)
        mean, cov = (
            np.broadcast_to(part, (runs, *part.shape[1:])).reshape(*self.lead, *part.shape[1:])
            for part in parts
        )
        return first, mean, cov

    def _laid(self, make: Make) -> tuple[ChainPlan, Beginning | None]:
        """The plan of the window with a first linearisation, and the belief that it begins with.

        CPDs are linearised as the window before left them, and those of the newest step as a filter
        does. The belief is None where the window begins with the prior.
        """
        before, begin, first = self.before, None, 0
        part = None if before is None else before.plan
        if before is not None and before.plan.steps == self.schedule.lag:
            begin, first = before.at(1), before.plan.first + 1
            part = begin.cut(before.plan, 1, before.plan.steps)
        evidence = _joined(self.entries, self.lead, begun=begin is not None)
        plan = make(evidence, first, begin is None)
        if part is not None:
            plan.put(0, part)
        alone = filter_step(plan, plan.steps, self._newest, self.schedule.first)
        plan.put(max(plan.steps - 1, 0), alone.plan)
        return plan, begin


def _joined(entries: Sequence[Entry], lead: tuple[int, ...], *, begun: bool) -> BoundEvidence:
    """The evidence of several online steps as that of one chain, whose steps count from 0.

    If the window has `begun`, step 0 is that of the belief that it begins with, without evidence.
    """
    motions = [entry.motion for entry in entries]
    transition = tuple(
        {variable: _rows([motion[k][variable] for motion in motions]) for variable in inputs}
        for k, inputs in enumerate(motions[0])
    )
    read = [
        (step, reading)
        for step, entry in enumerate(entries, int(begun))
        for reading in entry.readings
    ]
    sensors = {id(reading.cpd): reading.cpd for _, reading in read}
    readings = []
    for key, cpd in sensors.items():
        own = [(step, reading) for step, reading in read if id(reading.cpd) == key]
        step = np.concatenate([np.full(len(reading.values), step) for step, reading in own])
        parts = [reading for _, reading in own]
        inputs = {v: _rows([part.inputs[v] for part in parts]) for v in parts[0].inputs}
        values, taken = _rows([p.values for p in parts]), _rows([p.taken for p in parts])
        readings.append(Reading(cpd, step, np.arange(step.size), values, taken, inputs))
    return BoundEvidence(len(entries) - 1 + begun, lead, transition, tuple(readings))


def _rows(parts: Sequence[npt.NDArray[Kind]]) -> npt.NDArray[Kind]:
    """Arrays (rows, runs or 1, d) stacked along rows, read-only, since users' functions see them.

    The axis of runs has length 1 if it has in all of them.
    """
    runs = max(part.shape[1] for part in parts)
    whole = np.concatenate([np.broadcast_to(p, (len(p), runs, p.shape[2])) for p in parts])
    whole.flags.writeable = False
    return whole


class _Ends(NamedTuple):
    """The beliefs at both ends of a transition, (2, runs, ...), as `Reverse.make` takes them.

    Row 0 is the belief before the transition, row 1 its prediction. For the reverse of a single
    transition only row 0 of `mean` and `cov` counts, and row 1 of the predicted moments: hence the
    same arrays serve as both.
    """

    mean: Array
    cov: Array
    predicted_mean: Array
    predicted_cov: Array


class Passed:
    """A past transition, made in float64, with its reverse, by which lagged beliefs are smoothed.

    The *reverse* is the distribution of the slice before the transition given the slice after it.
    It is found when it is asked for, since most beliefs are never lagged. The object is made from
    the `plan` of this one step, the moments `before` it, and the predicted moments `after` it.
    Arrays are (*lead, ...), *lead being the user's axes of runs; a slice has n components.
    """

    _made: tuple[ChainPlan, Moments, Moments]

    def __init__(self, plan: ChainPlan, before: Moments, after: Moments) -> None:
        self._made = plan, before, after

    @cached_property
    def back(self) -> Conditional:
        """The slice before given the slice after and earlier measurements, as an affine Gaussian.

        Its arrays are (*lead, ...).
        """
        plan, *ends = self._made
        (mean, cov), (later, spread) = (each.by_run for each in ends)
        both = np.stack([mean, later]), np.stack([cov, spread])
        parts = Reverse.make(plan, _Ends(*both, *both)).whole
        return Conditional(*(part[0].reshape(*plan.lead, *part.shape[2:]) for part in parts))

    @cached_property
    def variances(self) -> Array:
        """Variances of the slice before, given the measurements up to its step, (*lead, n)."""
        plan, before, _ = self._made
        cov = before.by_run[1]
        found: Array = np.einsum("...ii->...i", cov).reshape(*plan.lead, cov.shape[-1])
        return found

    @cached_property
    def moments(self) -> tuple[Array, Array, Array, Array]:
        """The matrices A, Q, P_y and P of the transition, (*lead, n, n).

        The transition from slice x to slice y is y = A x + c + e, e ~ N(0, Q). P is the covariance
        of x before it, P_y that of y predicted. They serve to bound the rounding of smoothed
        covariances.
        """
        plan, *ends = self._made
        known, predicted = (each.by_run[1] for each in ends)
        moves = between_slices(plan)
        parts = moves.matrix[0], moves.cov[0], predicted, known
        matrix, noise, after, before = (
            np.broadcast_to(part, known.shape).reshape(*plan.lead, *known.shape[1:])
            for part in parts
        )
        return matrix, noise, after, before

    @cached_property
    def added(self) -> Array:
        """A bound of the rounding that smoothing over this transition causes, (*lead,).

        It bounds the error of a smoothed covariance of the slice before the transition, as a share
        of that slice's covariance P given only the measurements up to its step.
        """
        plan, _, after = self._made
        predicted = after.by_run[1]
        found: Array = accumulated(np.stack([predicted, predicted]))
        return found.reshape(plan.lead)

    def __getstate__(self) -> dict[str, Any]:
        # What they are found from need not travel.
        names = "back", "variances", "moments", "added"
        return {name: getattr(self, name) for name in names}


def trailing(plan: ChainPlan, ats: Sequence[At]) -> MomentChain:
    """A forward pass over the one transition of a plan, for a step of a trail.

    It works on a copy of the plan, in which the linearisations of this step are stored, so that the
    plan can be filled with the next step's inputs. `ats` are the transition's CPDs bound to the
    step and its inputs: a noise that depends on these, and numbers by step, are taken from them.
    """
    own = plan.window(0, 1)
    if plan.batch:
        return MomentChain(own, ONCE)
    for family, at in zip((link.family for link in own.transition), ats, strict=True):
        if family.noisy:  # laid out for other rows, maybe
            family.noise = family.own_noise = at.noise[None, None]
        if family.cpd.steps is not None:
            assert at.matrix is not None
            assert at.offset is not None
            family.affine = at.matrix[None, None], at.offset[None, None]
            family.matrix, family.offset = family.affine
    return MomentChain(own, ONCE)


class Trail(NamedTuple):
    """The latest transitions behind a belief, at most `lag` of them; the last is to its step.

    Some steps are made with moments in pairs of float64, *twice the digits*. In `passed` a
    transition is None if it, or the update before it, was made so; `imprecise` says whether the
    measurements of the belief's own step were taken in so. `log` has what late readings ask for.
    """

    lag: int
    passed: tuple[Passed | None, ...] = ()
    imprecise: bool = False
    log: Log = NOTHING

    def logged(self, log: Log) -> Trail:
        """The same trail with another log."""
        return Trail(self.lag, self.passed, self.imprecise, log)

    def on(self, passed: Passed | None) -> Trail:
        """The trail one step later, over the transition `passed`.

        `passed` is None if the transition was made in twice the digits.
        """
        kept = (*self.passed, None if self.imprecise else passed)
        return Trail(self.lag, kept[-self.lag :] if self.lag else (), log=self.log)

    def lagged(self, step: int, mean: Array, cov: Array) -> tuple[int, Array, Array]:
        """The number of the trail's first step, and the smoothed mean and covariance there.

        `mean` and `cov` (*lead, ...) are those of the belief at the trail's end, `step`. A
        `NumericalError` is raised where a step was made in twice the digits, smoothing divides a
        variance by more than 2·10⁷, or rounding may be more than 10⁻⁷ of a smoothed variance.
        """
        first, before = step - len(self.passed), step
        later, added = [cov], np.zeros(cov.shape[:-2])
        for passed in reversed(self.passed):
            before -= 1
            if passed is None or (self.imprecise and before == step - 1):
                self._refuse(first, before, step, in_digits=True)
            mean, cov = moments.push(mean, cov, passed.back)
            later.append(cov)
            left, added = np.einsum("...ii->...i", cov), added + passed.added
            if ((MODERATE * left < passed.variances) & (left != 0.0)).any():
                self._refuse(first, before, step)
            doubtful = (added[..., None] * passed.variances > TOLD * left) & (left != 0.0)
            if doubtful.any() and self._share(later) > TOLD:
                self._refuse(first, before, step)
        return first, mean, cov

    def _share(self, later: list[Array]) -> float:
        """The largest bound of the rounding of a smoothed variance, as a share of the variance.

        `later` are the smoothed covariances (*lead, n, n) from the trail's last step back to the
        step whose variances are judged. The result is infinite if a covariance is singular in
        float64.
        """
        error = np.zeros(later[0].shape)
        for passed, cov in zip(reversed(self.passed), later[:-1], strict=False):
            assert passed is not None
            try:
                gain, more = injected(*passed.moments, cov)
            except np.linalg.LinAlgError:  # of a covariance that is singular in float64
                return np.inf
            error = sandwich(gain, error)
            np.einsum("...ii->...i", error)[...] += more
        left = np.einsum("...ii->...i", later[-1])
        part = np.einsum("...ii->...i", error) / np.where(left > 0.0, left, np.inf)
        return float(part.max(initial=0.0))

    def _refuse(self, first: int, before: int, step: int, *, in_digits: bool = False) -> NoReturn:
        """Raise the `NumericalError` that float64 loses too many digits of a lagged belief.

        The belief would be at step `first`, given the measurements up to `step`; its digits are
        lost at step `before` or the next, which may have been made `in_digits`, twice as many.
        """
        why = "deviations lie too far apart"
        if in_digits:
            why += ", or a flat prior has left directions unknown until then"
        raise NumericalError(
            f"float64 loses the belief at step {first} given the measurements up to step {step}: "
            f"at step {before} or the next, {why}. That at step {step} is right; the other is "
            "found on recorded measurements, pgm.smooth(..., lag=...), and by an online filter "
            f"with iterations=2, schedule=pgm.FixedLag({self.lag}, iterations=2), which solves its "
            "windows in twice the digits",
            step=first,
        )


def is_like(behind: Trail | Sliding | None, own: Trail | Sliding | None) -> bool:
    """Whether a belief keeps the steps behind it as a filter does, with the same lag.

    `behind` are the steps behind the belief, `own` those behind the filter's prior; None without a
    lag. A `Sliding` window is like another of an equal schedule.
    """
    if isinstance(behind, Trail) and isinstance(own, Trail):
        return behind.lag == own.lag
    if isinstance(behind, Sliding) and isinstance(own, Sliding):
        return behind.schedule == own.schedule
    return behind is None and own is None


def look_again(plan: ChainPlan, ats: Sequence[At], step: int, known: Moments) -> None:
    """Predict again with a check of each CPD's numbers, so that an error names the CPD at fault.

    It is called after a prediction that failed or was not finite. `known` are the moments at the
    step before, `ats` the CPDs of the transition to `step`. The error is a `LinearisationError` or
    a `NumericalError`.
    """
    MomentChain(plan, ONCE, keep=False, check=True).predict(step, known, ats)
