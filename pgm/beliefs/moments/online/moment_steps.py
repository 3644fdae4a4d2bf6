"""Filtering in a robot's loop: a forward pass, one step at a time.

Steps are made in float64, in machine code where that was asked for, and in pairs of float64, *twice
the digits*, where float64 would lose too many (`beliefs`). With a lag the steps *behind* a belief
are kept, too (`window`). A *plan* (`ChainPlan`) lays out CPDs and their evidence for some steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property, partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from pgm.beliefs.moments.digits import careful, careful_chain
from pgm.beliefs.moments.digits.careful_belief import over
from pgm.beliefs.moments.digits.careful_chain import proper
from pgm.beliefs.moments.digits.careful_pass import Begin
from pgm.beliefs.moments.digits.certificate import is_flat
from pgm.beliefs.moments.online.associating import associated, leaves_open
from pgm.beliefs.moments.online.beliefs import (
    MomentBelief,
    belief_of,
    careful_belief,
    in_digits,
    is_moderate,
    is_plain,
    moments_of,
    nothing_to_iterate,
    refuse,
    require_own,
    told,
)
from pgm.beliefs.moments.online.compiled import CompiledSteps
from pgm.beliefs.moments.online.judged import at_last, at_moments, of_update, of_window
from pgm.beliefs.moments.online.kind import Questions
from pgm.beliefs.moments.online.origin import Origin, Pair
from pgm.beliefs.moments.online.settings import require_settings, require_watch
from pgm.beliefs.moments.online.slid import slid
from pgm.beliefs.moments.online.step_layouts import Layouts
from pgm.beliefs.moments.online.watch import Watch
from pgm.beliefs.moments.online.window import Passed, Sliding, Trail, look_again, trailing
from pgm.beliefs.moments.outcomes.measurements import Expected, unweighed
from pgm.beliefs.moments.outcomes.step_innovations import at_last_step
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.cost import require_cost
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.gate import prepare as prepare_gates
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.compile import SliceGraph
from pgm.compile.machine import COMPILED, Choice, as_choice
from pgm.cpds import AffineCPD, NonlinearGaussianCPD
from pgm.display import InCode, titled
from pgm.errors import EvidenceError, ModelError, NumericalError
from pgm.evidence import BoundEvidence, Sightings
from pgm.factors import Gaussian
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, deviation
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.belief_kind import FILTERED, PREDICTED
from pgm.posteriors.status import Status
from pgm.posteriors.step_innovations import StepInnovations
from pgm.schedules import step_evidence
from pgm.schedules.convergence import tell_online
from pgm.schedules.gates import Gate
from pgm.schedules.late import Copied, Log
from pgm.schedules.schedule import ONCE, Filtering, FixedLag
from pgm.variables import Variable

# Steps of a kind that NumPy makes before machine code, unasked, for each four components of a
# slice: they take as long as its making.
_LONG = 1000
# Updates are the same to so many standard deviations.
_SAME = 1e-6
# The statuses of one robot's steps in which nothing was to iterate, or CPDs were linearised once.
_DONE, _LINEARISED = (Status(1, np.empty(0), np.array(converged)) for converged in (True, False))
# Numbers too large for float64 are refused where they end up, so that NumPy need not warn. A
# decorator takes half as long as a block.
_quiet = np.errstate(over="ignore", invalid="ignore", divide="ignore")


class MomentSteps(InCode, Immutable):
    """The steps of an online filter whose beliefs are moments; see `OnlineFilter`."""

    model: DynamicBayesianNetwork
    lineariser: Lineariser
    schedule: Filtering | FixedLag
    watch: bool
    compiled: bool | None
    _steps: CompiledSteps | None = None

    def __init__(
        self,
        model: Any,
        lineariser: Lineariser = TAYLOR,
        schedule: Any = None,
        lag: int | None = None,
        *,
        gate: Gate = None,
        watch: bool = False,
        compiled: Choice = None,
    ) -> None:
        schedule = require_settings(model, lineariser, schedule, lag, gate)
        self._set(model=model, lineariser=lineariser, schedule=schedule, watch=require_watch(watch))
        choice = as_choice(compiled, "OnlineFilter(...)")
        self._set(compiled=None if choice is None else bool(choice))
        for cpd in (*model.transition, *model.observation):
            if isinstance(cpd, NonlinearGaussianCPD):
                cpd._renew()
        if self.compiled or (self.compiled is None and self._is_safe):
            self._compile()

    @cached_property
    def _graph(self) -> Any:
        """The cluster graph of one transition, from which plans are made."""
        return SliceGraph(self.model, 1)

    @cached_property
    def _filtering(self) -> Filtering:
        """The schedule by which an update linearises sensors.

        It is the filter's own schedule if that is a `Filtering`. With a `FixedLag` it has the
        gate of that and one linearisation or, if the lag is zero, as many as the `FixedLag`.
        """
        schedule = self.schedule
        if isinstance(schedule, FixedLag):
            return schedule.first if schedule.lag else schedule.filtering
        return schedule

    @cached_property
    def _behind(self) -> Trail | Sliding | None:
        """The steps behind the prior: an empty `Trail` or `Sliding` window, None without a lag."""
        schedule = self.schedule
        if not isinstance(schedule, FixedLag):
            return None
        if not schedule.lag or schedule.iterations == 1:
            return Trail(schedule.lag)
        return Sliding.first(schedule, self.model)

    @cached_property
    def _motions(self) -> Layouts:
        """Plans of predictions, kept by the shapes of the inputs, to be filled with new inputs."""
        return Layouts(self._ahead, ONCE)

    @cached_property
    def _sensors(self) -> Layouts:
        """Plans of updates, kept by the shapes of the readings, to be filled with new readings."""
        return Layouts(self._seen, self._filtering)

    @property
    def options(self) -> dict[str, Any]:
        """The options of `OnlineFilter` by which the same steps are made."""
        return {
            "lineariser": self.lineariser,
            "schedule": self.schedule,
            "watch": self.watch,
            "compiled": self.compiled,
        }

    def __reduce__(self) -> tuple[Any, ...]:
        # What was prepared is not part of the value.
        return _made, (self.model, self.options)

    def __repr__(self) -> str:
        states = [cpd.child for cpd in self.model.prior]
        return f"OnlineFilter(over {states}, {self.lineariser!r}, {self.schedule!r})"

    def _compile(self) -> None:
        """Replace `predict` and `update` by compiled ones, where the settings allow it.

        They allow it unless windows of steps are linearised at each update.
        """
        layout = self._graph.layout
        wait = 0 if self.compiled else _LONG * -(-layout.slice_size // 4)
        if not isinstance(self._behind, Sliding):
            ways = self._ahead, self._seen, self.predict, self.update, self
            statuses = _DONE, _LINEARISED
            reverses = self._behind is not None and self._behind.lag > 0
            asked = Questions(self._filtering, watched=self.watch, reverses=reverses)
            steps = CompiledSteps(layout, *ways, *statuses, asked, wait=wait)
            quick, own = steps.quick, {"predict": steps.predict, "update": steps.update}
            self._set(_steps=steps, quick=quick, **own)

    @property
    def _is_safe(self) -> bool:
        """Whether machine code may be used unasked: no function can change behind its back."""
        linear = all(
            isinstance(cpd, AffineCPD) for cpd in (*self.model.transition, *self.model.observation)
        )
        return linear and find_spec("llvmlite") is not None

    def log(self, belief: MomentBelief) -> Log | None:
        """The steps behind a belief of this filter; None without a lag."""
        require_own(belief, self.model, self.schedule, self._behind)
        return None if belief.behind is None else belief.behind.log

    @property
    def compilation(self) -> str:
        """Whether steps are made in machine code, or why not, in words.

        For a compiled filter it tells how many of the steps so far NumPy made, and why.
        """
        if self.compiled is False:
            return "by NumPy: compiled=False"
        if self.compiled is None and not self._is_safe:
            return "by NumPy: compiled=True would record the model's functions as they are"
        if self._steps is None:
            return "not compiled: the last steps are linearised again at each update"
        left = [f"{count} × {why}" for why, count in self._steps.left.items()]
        return f"compiled, but for: {'; '.join(left)}" if left else COMPILED

    def initial(self) -> MomentBelief:
        """The prior belief, at step 0, with the model's leading axes of runs."""
        return self._initial() if self._steps is None else self._first

    @cached_property
    def _first(self) -> MomentBelief:
        """The prior belief, with its numbers packed as compiled steps take them."""
        assert self._steps is not None
        return self._steps.adopted(self._initial())

    @_quiet
    def _initial(self) -> MomentBelief:
        """The prior belief; if the filter watches, it has a new test whether a belief is lost."""
        found = self._prior().of(self._own)
        return found if not self.watch else found.judged((), Watch.start(found.lead))

    def _prior(self) -> MomentBelief:
        """The prior at step 0, in twice the digits where float64 has too few."""
        lead = self.model.lead
        if isinstance(self._behind, Sliding):
            return slid(self._windows, 0, self._behind, np.zeros(lead))
        plan = self._plan(BoundEvidence(0, lead, (), ()), 0, prior=True)
        log_evidence, status = np.zeros(lead), nothing_to_iterate(lead)
        carried = Begin.known(careful_chain.start(plan, linearise=True))
        found = None if is_flat(plan) else MomentChain(plan, ONCE, keep=False).start()
        if found is not None and is_moderate(found, found):
            return belief_of(plan, 0, found, log_evidence, status, PREDICTED, self._behind, carried)
        return careful_belief(plan, 0, carried, log_evidence, status, PREDICTED, self._behind)

    @_quiet
    def predict(
        self, belief: MomentBelief, inputs: Mapping[Variable, Any] | None = None
    ) -> MomentBelief:
        """The belief one step later.

        Parameters
        ----------
        belief : MomentBelief
        inputs : mapping of Variable to array_like
            Values (..., d) of the transition's inputs; may be left out if it has none.

        Returns
        -------
        MomentBelief

        Raises
        ------
        EvidenceError
            If an input is missing or of a wrong shape, or a variable given is no input.
        ModelError
            If the belief is not this filter's, or a function returns a wrong shape.
        LinearisationError, NumericalError
            If a linearisation, or the belief, has no finite value.
        """
        later = self._later(belief, inputs).of(self._own)
        if belief.behind is not None:
            later.log(belief.behind.log.on(belief.bare(), Copied(inputs), belief.behind.lag))
        return later if belief.watch is None else later.judged((), belief.watch.on(belief.step))

    def _later(self, belief: MomentBelief, inputs: Mapping[Variable, Any] | None) -> MomentBelief:
        """The belief predicted one step ahead.

        It is predicted in float64, or in twice the digits where float64 would lose too many. A
        sliding window behind the belief takes the step in as its newest one. If nothing was read at
        the step before, the window of that step is settled first.
        """
        require_own(belief, self.model, self.schedule, self._behind)
        if type(inputs) is not dict:
            given = {} if inputs is None else inputs
            inputs = step_evidence.mapping(given, "predict", "inputs to values")
        step, behind = belief.step + 1, belief.behind
        if isinstance(behind, Sliding):
            bound = step_evidence.inputs(self.model, belief, inputs)
            unread = behind.window is None  # of a step without readings the window is settled here
            behind = behind.on(self._windows, bound.transition, bound.lead)
            if unread and behind.before is not None:
                tell_online(behind.before.converged, self.schedule)
            return slid(
                self._windows, step, behind, np.broadcast_to(belief.log_evidence, bound.lead)
            )
        if is_plain(belief):
            ordinary = self._predicted(belief, inputs)
            if ordinary is not None:
                return ordinary
        plan = self._ahead(belief, inputs)
        carried = careful.predict(plan, step, in_digits(belief, plan))
        log_evidence = np.broadcast_to(belief.log_evidence, plan.lead)
        status = nothing_to_iterate(plan.lead)
        behind = None if behind is None else behind.on(None)
        return careful_belief(plan, step, carried, log_evidence, status, PREDICTED, behind)

    def _predicted(
        self, belief: MomentBelief, inputs: Mapping[Variable, Any]
    ) -> MomentBelief | None:
        """Predict in float64; None where that would lose too many digits.

        The mean m becomes F m + b and the covariance P becomes F P Fᵀ + Q, with the slope F,
        offset b and noise covariance Q of the linearised transition. A prediction that is not
        finite raises a `LinearisationError` or `NumericalError`.
        """
        step, behind = belief.step + 1, belief.behind
        laid = None if belief.lead else self._motions.motion(belief, inputs)
        if laid is None:
            chain = MomentChain(self._ahead(belief, inputs), ONCE, keep=False)
            ats = chain.motion(1)
        else:
            chain, ats = laid
        if isinstance(behind, Trail):
            chain = trailing(chain.plan, ats)
        plan, known = chain.plan, moments_of(belief, chain.plan)
        try:
            found = chain.predict(step, known, ats)
        except NumericalError:
            look_again(plan, ats, step, known)
            raise
        if not is_moderate(found, found):
            if not np.isfinite(found.mean.sum() + found.cov.sum()):
                look_again(plan, ats, step, known)
                refuse(step)
            return None
        log_evidence, status = belief.log_evidence, _DONE
        if laid is None:
            log_evidence = np.broadcast_to(log_evidence, plan.lead)
            status = nothing_to_iterate(plan.lead)
        if isinstance(behind, Trail):
            behind = behind.on(Passed(plan, known, found))
        status = told(status, plan, known, found, belief)
        return belief_of(plan, step, found, log_evidence, status, PREDICTED, behind)

    def _ahead(self, belief: MomentBelief, inputs: Mapping[Variable, Any]) -> ChainPlan:
        """The plan of one prediction, from a belief to the next step, with its `inputs` bound."""
        return self._plan(step_evidence.inputs(self.model, belief, inputs), belief.step)

    @_quiet
    def update(self, belief: MomentBelief, readings: Mapping[Variable, Any]) -> MomentBelief:
        """The belief given measurements of its step; a further update goes on from the first.

        Parameters
        ----------
        belief : MomentBelief
        readings : mapping of Variable
            For a sensor any number of measurements, ``pgm.sightings(values, given=...)`` without
            steps, or one measurement (..., d); for inputs that the sensors need, values (..., d).

        Returns
        -------
        MomentBelief

        Raises
        ------
        EvidenceError
            If a measurement does not fit its sensor.
        ModelError, LinearisationError
            See `predict`.
        NumericalError
            If a measurement contradicts an exact model, or the belief has no finite value.

        Warns
        -----
        ConvergenceWarning
            If two or more iterations were asked for and end before they settle.
        """
        require_own(belief, self.model, self.schedule, self._behind)
        if type(readings) is not dict:
            readings = step_evidence.mapping(readings, "update", "sensors to measurements")
        if leaves_open(readings):
            gate = self.schedule.gate
            if not np.isfinite(belief.cov).all():
                raise EvidenceError(
                    f"{titled(belief)} has an infinite variance still, given a flat prior, so that "
                    "sightings without identity cannot be compared with candidates: read what "
                    "tells it before, or give the prior a finite variance",
                    step=belief.step,
                )
            closed, seen = associated(self._graph, self.lineariser, belief, readings, gate)
            made = self.update(belief, closed).told(seen, gate)
            if belief.behind is not None:  # identities are asked for anew where steps are
                made.log(belief.behind.log.read(Copied(readings)))
            return made
        behind = belief.behind
        if isinstance(behind, Sliding):
            bound = step_evidence.readings(self.model, belief, readings)
            behind = behind.read(self._windows, bound.readings, bound.lead)
            made = slid(self._windows, belief.step, behind, belief.log_evidence)
            tell_online(made.status.converged, self.schedule)
            made = made.judged(*of_window(belief.watch, behind.settled(self._windows)))
            return made.of(self._own).log(behind.log.read(Copied(readings)))
        if is_plain(belief):
            ordinary = self._updated(belief, readings)
            if ordinary is not None:
                return ordinary
        plan = self._seen(belief, readings)
        prepare_gates(plan, self._filtering.gate)
        known = in_digits(belief, plan)
        found, taken, parts = careful.update(plan, belief.step, known, self._filtering)
        log_density = taken.solution.log_density.reshape(plan.lead)
        log_evidence = np.asarray(belief.log_evidence + log_density)
        status = Status.of(taken.residuals, taken.converged, plan.lead)
        tell_online(status.converged, self._filtering)
        behind = None if behind is None else behind._replace(imprecise=True)
        made = careful_belief(plan, belief.step, found, log_evidence, status, FILTERED, behind)
        squares = partial(at_last, plan, _careful_forward(plan, known, found))
        made = made.judged(*of_update(belief.watch, parts, squares))
        return self._updated_by(made, belief, readings)

    def _updated_by(
        self, made: MomentBelief, belief: MomentBelief, readings: Mapping[Variable, Any]
    ) -> MomentBelief:
        """The belief itself, new from an update of `belief` by readings, with a record of these."""
        before, values = belief.plain(), Copied(readings)
        found = made.of(Origin(self, lambda: (before, values.opened)))
        if found.behind is not None:
            found.log(found.behind.log.read(values))
        return found

    @cached_property
    def _own(self) -> Origin:
        """The origin of beliefs of which no update is told."""
        return Origin(self)

    def _updated(
        self, belief: MomentBelief, readings: Mapping[Variable, Any]
    ) -> MomentBelief | None:
        """Update in float64 with a step's readings; None where that would lose too many digits.

        The log-evidence grows by ln p(readings | earlier measurements), in nats.
        """
        laid = None if belief.lead else self._sensors.sensors(belief, readings)
        if laid is None:
            chain = MomentChain(self._seen(belief, readings), self._filtering, keep=False)
            parts = chain.readings(0)
        else:
            chain, parts = laid
        plan, known = chain.plan, moments_of(belief, chain.plan)
        try:
            found, log_density = chain.take(belief.step, known, parts) if parts else (known, 0.0)
        except NumericalError:
            return None  # with twice the digits there may be an answer; if not, it is refused
        if not is_moderate(found, known):
            return None
        if belief.lead or plan.lead:
            log_evidence = np.asarray(
                belief.log_evidence + np.broadcast_to(log_density, plan.runs).reshape(plan.lead)
            )
        else:
            log_evidence = np.array(belief.log_evidence.item() + float(log_density))
        if chain.residuals or plan.lead or plan.robust:
            status = Status.of(chain.residuals, chain.converged, plan.lead)
            tell_online(status.converged, self._filtering)
        else:
            status = _DONE if plan.linear else _LINEARISED
        status = told(status, plan, known, found, belief)
        made = belief_of(plan, belief.step, found, log_evidence, status, FILTERED, belief.behind)
        if chain.gate is not None or belief.watch is not None:
            made = made.judged(*of_update(belief.watch, parts, partial(at_moments, parts, known)))
        return self._updated_by(made, belief, readings)

    @_quiet
    def innovations(
        self, belief: MomentBelief, update: Pair | None
    ) -> dict[Variable, StepInnovations]:
        """The innovations of an update, of a belief by readings, which led to `belief`.

        The update is made again, at the same numbers. If that leads elsewhere, a function of the
        model has changed, and a ModelError refuses to tell innovations of another update.
        """
        if isinstance(belief.behind, Sliding):
            window = belief.behind.settled(self._windows)
            found = at_last_step(window.plan, window.ahead)
            return {z: StepInnovations(*each) for z, each in found.items()}
        assert update is not None
        before, readings = update
        plan, forward = self._update_again(before, readings)
        if not _is_same(belief, Moments.of(plan, forward.mean[0], forward.cov[0])):
            raise ModelError(
                f"{titled(belief)} has innovations of functions that answer otherwise by now: ask "
                "for them before what the functions read is changed, or make that an input",
                step=belief.step,
            )
        return {
            variable: StepInnovations(*each, alone=type(readings[variable]) is not Sightings)
            for variable, each in at_last_step(plan, forward).items()
        }

    @_quiet
    def measurement(
        self, belief: MomentBelief, variable: Variable, given: Mapping[Variable, Any]
    ) -> Gaussian:
        """The belief of a sensor's measurement at the step of a predicted belief.

        `given` has the values of the sensor's observed parents, in rows or constant.
        """
        bound, alone = step_evidence.unread(self.model, belief, variable, given)
        plan = self._plan(bound, belief.step)
        (sensor,) = plan.sensors
        mean, ahead = self._before(belief, plan)
        proper(sensor.family, belief.step, ahead.shown)
        first = belief.step
        family = unweighed(sensor, mean, ahead, first=first)
        found = Expected.of(family, sensor.parents, mean, ahead, first=first)
        mean, cov = found.mean.swapaxes(0, 1), found.spread.shown.swapaxes(0, 1)
        lead = plan.lead if alone else (*plan.lead, found.step.size)
        mean, cov = (part.reshape(*lead, *part.shape[2:]) for part in (mean, cov))
        return Gaussian._make((variable,), mean, cov)

    def _before(self, belief: MomentBelief, plan: ChainPlan) -> tuple[Array, Diffuse]:
        """The moments (1, runs, ...) of a predicted belief, and which directions are unknown."""
        if isinstance(belief.behind, Sliding):
            last = belief.behind.ahead(self._windows, belief.step).ahead.last
            rows = last.predicted_mean[0], *(part[0] for part in last.ahead)
            mean, *parts = (over(part, belief.lead, plan.lead)[None] for part in rows)
            return mean, Diffuse(*parts)
        if belief.careful is None:
            mean, cov = moments_of(belief, plan).by_run
            return mean[None], Diffuse.known(cov[None])
        mean, spread = in_digits(belief, plan).rounded
        return mean[None], Diffuse(*(part[None] for part in spread))

    def _update_again(
        self, before: MomentBelief, readings: Mapping[Variable, Any]
    ) -> tuple[ChainPlan, Forward]:
        """The plan of an update with its linearisations, and its forward pass, of one step."""
        if is_plain(before):
            plan = self._seen(before, readings)
            prepare_gates(plan, self._filtering.gate)
            known = moments_of(before, plan)
            try:
                found, _ = MomentChain(plan, self._filtering).take(0, known)
            except NumericalError:
                found = None  # as in the update, twice the digits are taken
            if found is not None and is_moderate(found, known):
                return plan, _forward(plan, known, found)
        plan = self._seen(before, readings)
        prepare_gates(plan, self._filtering.gate)
        before_it = in_digits(before, plan)
        after, _, _ = careful.update(plan, before.step, before_it, self._filtering)
        return plan, _careful_forward(plan, before_it, after)

    def _seen(self, belief: MomentBelief, readings: Mapping[Variable, Any]) -> ChainPlan:
        """The plan of one update at the step of a belief, with its `readings` bound."""
        plan = self._plan(step_evidence.readings(self.model, belief, readings), belief.step)
        require_cost(self._filtering, (sensor.family for sensor in plan.sensors))
        return plan

    def _windows(self, bound: BoundEvidence, first: int, prior: bool) -> ChainPlan:
        """The plan of a window, the steps within the lag, with the evidence `bound`.

        Its first step is number `first`. `prior` says whether the window begins with the model's
        prior, as at step 0, or with a belief.
        """
        plan = self._plan(bound, first, prior=prior)
        assert isinstance(self.schedule, FixedLag)
        require_cost(self.schedule.smoothing, plan.families)
        prepare_gates(plan, self.schedule.gate)
        return plan

    def _plan(self, bound: BoundEvidence, step: int, *, prior: bool = False) -> ChainPlan:
        """The plan of a chain with the evidence `bound`, whose first step is number `step`.

        `prior` says whether the chain begins with the model's prior, or with a belief.
        """
        return ChainPlan.make(self._graph, bound, self.lineariser, first=step, prior=prior)


def _made(model: DynamicBayesianNetwork, options: Mapping[str, Any]) -> MomentSteps:
    """Steps made anew, by their options."""
    return MomentSteps(model, **options)


def _careful_forward(plan: ChainPlan, known: Begin, found: Begin) -> Forward:
    """The forward pass of one step, from its beliefs in twice the digits before and after."""
    (mean, spread), (after, later) = known.rounded, found.rounded
    rows = mean[None], spread.shown[None], after[None], later.shown[None]
    diffuse = Diffuse(*(part[None] for part in spread)) if spread.open.any() else None
    return Forward(*rows, np.zeros((1, plan.runs)), diffuse=diffuse)


def _forward(plan: ChainPlan, known: Moments, found: Moments) -> Forward:
    """The forward pass of one step, from its moments before and after measurements."""
    (mean, cov), (after, spread) = known.by_run, found.by_run
    return Forward(mean[None], cov[None], after[None], spread[None], np.zeros((1, plan.runs)))


def _is_same(belief: MomentBelief, found: Moments) -> bool:
    """Whether a belief has these moments, to 10⁻⁶ standard deviations."""
    mean, cov = (
        part.reshape(own.shape)
        for part, own in zip(found.by_run, (belief.mean, belief.cov), strict=True)
    )
    std = deviation(belief.cov)
    near = np.abs(mean - belief.mean) <= _SAME * std + 1e-12 * np.abs(belief.mean)
    alike = cov == belief.cov  # as infinite ones are
    alike |= np.abs(cov - belief.cov) <= _SAME * std[..., None] * std[..., None, :]
    return bool(near.all() and alike.all())
