"""Filtering in a robot's loop: the same rounds as a forward sweep, one at a time."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from math import isfinite
from typing import Any, NoReturn

import numpy as np

from pgm.compile import compile
from pgm.errors import EvidenceError, ModelError, NumericalError
from pgm.evidence import BoundEvidence, Constant, Sightings, bind, constant, sightings
from pgm.evidence.arrays import as_rows
from pgm.immutable import Immutable
from pgm.inference.chain import online_careful
from pgm.inference.chain.cost import require_cost
from pgm.inference.chain.moments import MomentChain
from pgm.inference.chain.online_belief import OnlineBelief
from pgm.inference.chain.online_careful import REGULAR, CarefulBelief
from pgm.inference.chain.online_layouts import Layouts
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.readings import Moments
from pgm.inference.kind import FILTERED, PREDICTED, Kind
from pgm.inference.schedule import ONCE, Filtering
from pgm.inference.status import Status, digits
from pgm.kernels import gaussian
from pgm.kernels.arrays import Array
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable

# Of one robot: nothing was to iterate, and linearised once.
_DONE, _LINEARISED = (Status(1, np.empty(0), np.array(converged)) for converged in (True, False))
# Numbers too large for float64 are refused where they end up, so that NumPy need not warn. A
# decorator takes half as long as a block.
_quiet = np.errstate(over="ignore", invalid="ignore", divide="ignore")


class OnlineFilter(Immutable):
    """A filter for one step at a time; immutable, and so are its beliefs.

    Beliefs belong to the filter's own model: to go on from one in another process, pickle the two
    together.

    Parameters
    ----------
    model : DynamicBayesianNetwork
    lineariser : Lineariser, optional
        For every CPD that has none of its own; `Taylor()` without.
    schedule : Filtering, optional
        How often readings are linearised; once without.

    Examples
    --------
    >>> robot = OnlineFilter(model)  # doctest: +SKIP
    >>> belief = robot.initial()  # doctest: +SKIP
    >>> belief = robot.predict(belief, {u: odometry})  # doctest: +SKIP
    >>> belief = robot.update(belief, {z: sightings(zs, given={m: ms})})  # doctest: +SKIP
    """

    model: DynamicBayesianNetwork
    lineariser: Lineariser
    schedule: Filtering

    def __init__(
        self,
        model: DynamicBayesianNetwork,
        lineariser: Lineariser = TAYLOR,
        schedule: Filtering = ONCE,
    ) -> None:
        if not isinstance(model, DynamicBayesianNetwork):
            raise ModelError(f"a dynamic network was due, not {model!r}")
        if not callable(lineariser) or isinstance(lineariser, type):
            raise ModelError(f"{lineariser!r} is no lineariser; give one like pgm.Taylor()")
        if not isinstance(schedule, Filtering):
            raise ModelError(f"a filter takes pgm.Filtering(...), not {schedule!r}")
        for cpd in model.prior:
            cpd.require_proper("an online filter begins at a belief, which has moments")
        self._set(model=model, lineariser=lineariser, schedule=schedule)

    @cached_property
    def _graph(self) -> Any:
        return compile(self.model, 1)

    @cached_property
    def _motions(self) -> Layouts:
        """The transition, laid out for each kind of inputs of one robot."""
        return Layouts(self._ahead, ONCE)

    @cached_property
    def _sensors(self) -> Layouts:
        """Sensors, laid out for each kind of readings of one robot."""
        return Layouts(self._seen, self.schedule)

    def __getstate__(self) -> dict[str, Any]:
        # What was prepared is not part of the value.
        return {name: getattr(self, name) for name in ("model", "lineariser", "schedule")}

    @_quiet
    def initial(self) -> OnlineBelief:
        """The prior, at step 0."""
        lead = self.model.lead
        plan = self._plan(BoundEvidence(0, lead, (), ()), 0, prior=True)
        found = MomentChain(plan, ONCE, keep=False).start()
        log_evidence, status = np.zeros(lead), _nothing_to_iterate(lead)
        if gaussian.is_regular(found.cov, found.cov, REGULAR):
            return _belief(plan, 0, found, log_evidence, status, PREDICTED)
        return _carried(plan, 0, online_careful.first(plan), log_evidence, status, PREDICTED)

    @_quiet
    def predict(
        self, belief: OnlineBelief, inputs: Mapping[Variable, Any] | None = None
    ) -> OnlineBelief:
        """The belief one step later.

        Parameters
        ----------
        belief : OnlineBelief
        inputs : mapping of Variable to array_like
            Values (..., d) of the transition's inputs.

        Raises
        ------
        EvidenceError
            If an input is missing or of a wrong shape, or something is no input.
        """
        self._check(belief)
        if type(inputs) is not dict:
            inputs = {} if inputs is None else _mapping(inputs, "predict", "inputs to values")
        step = belief.step + 1
        if belief.careful is None:
            laid = None if belief.lead else self._motions.motion(belief, inputs)
            if laid is None:
                chain = MomentChain(self._ahead(belief, inputs), ONCE, keep=False)
                ats = chain.motion(1)
            else:
                chain, ats = laid
            plan, known = chain.plan, _moments(belief, chain.plan)
            found = chain.predicted(ats, step, known)
            regular = gaussian.is_regular(found.cov, found.cov, REGULAR)
            if not (_is_finite(found) and (regular or np.isfinite(found.cov).all())):
                MomentChain(plan, ONCE, keep=False, check=True).predicted(ats, step, known)
                _refuse(step)
            if regular:
                log_evidence, status = belief.log_evidence, _DONE
                if laid is None:
                    log_evidence = np.broadcast_to(log_evidence, plan.lead)
                    status = _nothing_to_iterate(plan.lead)
                return _belief(plan, step, found, log_evidence, status, PREDICTED)
        plan = self._ahead(belief, inputs)
        carried = online_careful.predict(plan, step, _careful(belief, plan))
        log_evidence = np.broadcast_to(belief.log_evidence, plan.lead)
        status = _nothing_to_iterate(plan.lead)
        return _carried(plan, step, carried, log_evidence, status, PREDICTED)

    def _ahead(self, belief: OnlineBelief, inputs: Mapping[Variable, Any]) -> ChainPlan:
        """The plan of a prediction, its inputs checked."""
        needed = {v for cpd in self.model.transition for v in cpd.parents}
        for variable in inputs:
            if variable not in needed or variable not in self.model.inputs:
                raise EvidenceError(
                    f"predict takes inputs of the transition, not {variable!r}; "
                    "readings go to update",
                    variable=variable,
                    step=belief.step + 1,
                )
        evidence = {v: _constant(value) for v, value in inputs.items()}
        bound = bind(self.model.transition, (), evidence, 1, belief.lead)
        return self._plan(bound, belief.step + 1)

    @_quiet
    def update(self, belief: OnlineBelief, readings: Mapping[Variable, Any]) -> OnlineBelief:
        """The belief given readings of its step; a further update goes on from the first.

        Parameters
        ----------
        belief : OnlineBelief
        readings : mapping of Variable
            For a sensor ``pgm.sightings(values, given=...)`` without steps, any number, or one
            reading (..., d); for inputs that the sensors need, values (..., d).

        Raises
        ------
        EvidenceError
            If a reading does not fit its sensor.
        NumericalError
            If a reading contradicts an exact model.
        """
        self._check(belief)
        if type(readings) is not dict:
            readings = _mapping(readings, "update", "sensors to readings")
        if belief.careful is None:
            ordinary = self._updated(belief, readings)
            if ordinary is not None:
                return ordinary
        plan = self._seen(belief, readings)
        known = _careful(belief, plan)
        found, taken = online_careful.update(plan, belief.step, known, self.schedule)
        log_density = taken.solution.log_density.reshape(plan.lead)
        log_evidence = np.asarray(belief.log_evidence + log_density)
        status = Status.of(taken.residuals, taken.converged, plan.lead)
        return _carried(plan, belief.step, found, log_evidence, status, FILTERED)

    def _updated(
        self, belief: OnlineBelief, readings: Mapping[Variable, Any]
    ) -> OnlineBelief | None:
        """The belief given readings, in float64; None where that has too few digits."""
        laid = None if belief.lead else self._sensors.sensors(belief, readings)
        if laid is None:
            chain = MomentChain(self._seen(belief, readings), self.schedule, keep=False)
            parts = chain.readings(0)
        else:
            chain, parts = laid
        plan, known = chain.plan, _moments(belief, chain.plan)
        log_density: Array | float = 0.0
        found = known
        if parts:
            try:
                found, log_density = chain.taken(parts, belief.step, known)
            except NumericalError:
                return None  # with twice the digits there may be an answer; if not, it is refused
        if not gaussian.is_regular(found.cov, known.cov, REGULAR):
            return None
        if belief.lead or plan.lead:
            log_evidence = np.asarray(
                belief.log_evidence + np.broadcast_to(log_density, plan.runs).reshape(plan.lead)
            )
        else:
            log_evidence = np.array(belief.log_evidence.item() + float(log_density))
        if (laid is None or not parts) and not _is_finite(found):
            _refuse(belief.step)
        if chain.residuals or plan.lead:
            status = Status.of(chain.residuals, chain.converged, plan.lead)
        else:
            status = _DONE if chain.converged[0] else _LINEARISED
        return _belief(plan, belief.step, found, log_evidence, status, FILTERED)

    def _seen(self, belief: OnlineBelief, readings: Mapping[Variable, Any]) -> ChainPlan:
        """The plan of an update, its readings checked."""
        evidence = {v: self._reading(v, value) for v, value in readings.items()}
        bound = bind(
            self.model.transition,
            self.model.observation,
            evidence,
            0,
            belief.lead,
            transition_inputs=False,
        )
        plan = self._plan(bound, belief.step)
        require_cost(self.schedule, (sensor.family for sensor in plan.sensors))
        return plan

    def _check(self, belief: OnlineBelief) -> None:
        if not isinstance(belief, OnlineBelief) or belief.layout.model is not self.model:
            raise ModelError(
                f"{belief!r} is no belief of this filter's model; begin with initial()"
            )

    def _reading(self, variable: Variable, value: Any) -> Any:
        if variable not in self.model.sensors:
            return _constant(value)
        if not isinstance(value, Sightings):
            value = sightings(as_rows(variable, value, None)[..., None, :])
        if value.step is not None:
            raise EvidenceError(
                f"sightings of {variable!r} online belong to the belief's step; leave step= out",
                variable=variable,
            )
        if value.values is None:
            return Sightings(None, np.zeros(0, dtype=np.intp), value.given)
        rows = as_rows(variable, value.values, "M")
        return Sightings(rows, np.zeros(rows.shape[-2], dtype=np.intp), value.given)

    def _plan(self, bound: BoundEvidence, step: int, *, prior: bool = False) -> ChainPlan:
        return ChainPlan.make(self._graph, bound, self.lineariser, first=step, prior=prior)


def _nothing_to_iterate(lead: tuple[int, ...]) -> Status:
    return Status(1, np.empty((0, *lead)), np.ones(lead, dtype=bool))


def _mapping(value: Any, method: str, what: str) -> Mapping[Variable, Any]:
    if not isinstance(value, Mapping):
        raise EvidenceError(f"{method} takes a mapping of {what}, not {type(value).__name__}")
    return value


def _constant(value: Any) -> Constant:
    return value if isinstance(value, Constant) else constant(value)


def _wide(array: Array, plan: ChainPlan, own: int) -> Array:
    """A belief's array for the runs of a plan, as one axis."""
    rest = array.shape[-own:]
    return np.broadcast_to(array, (*plan.lead, *rest)).reshape(plan.runs, *rest)


def _moments(belief: OnlineBelief, plan: ChainPlan) -> Moments:
    """Moments for the runs of a plan."""
    if not plan.lead:
        return Moments(belief.mean, belief.cov)
    return Moments.of(plan, _wide(belief.mean, plan, 1), _wide(belief.cov, plan, 2))


def _is_finite(found: Moments) -> bool:
    """Whether all numbers are finite, of one run's mean alone: its covariance is regular."""
    if found.mean.ndim > 1:
        return bool(np.isfinite(found.mean.sum() + found.cov.sum()))
    # A sum of few numbers tells it most quickly.
    return isfinite(sum(found.mean.tolist()))


def _careful(belief: OnlineBelief, plan: ChainPlan) -> CarefulBelief:
    """A belief in twice the digits, for the runs of a plan."""
    if belief.careful is not None:
        return belief.careful.over(belief.lead, plan.lead)
    return online_careful.beginning(_wide(belief.mean, plan, 1), _wide(belief.cov, plan, 2))


def _carried(
    plan: ChainPlan,
    step: int,
    found: CarefulBelief,
    log_evidence: Array,
    status: Status,
    kind: Kind,
) -> OnlineBelief:
    """A belief whose status has its digits, carried in twice those of float64 while it must be."""
    mean, cov = found.moments
    if not all(np.isfinite(part).all() for part in (mean, cov, log_evidence)):
        _refuse(step)
    status = status.with_digits(digits(found.error, plan.lead))
    kept = None if found.is_ordinary else found
    return _belief(plan, step, Moments.of(plan, mean, cov), log_evidence, status, kind, kept)


def _refuse(step: int) -> NoReturn:
    raise NumericalError(
        f"the belief at step {step} or its log-evidence is not finite: numbers of the model or the "
        "evidence are larger, or further apart, than float64 can hold; give them in other units",
        step=step,
    )


def _belief(
    plan: ChainPlan,
    step: int,
    found: Moments,
    log_evidence: Array,
    status: Status,
    kind: Kind,
    careful: CarefulBelief | None = None,
) -> OnlineBelief:
    """A belief with the runs as the user's axes."""
    lead, (mean, cov, _) = plan.lead, found
    if lead:
        mean, cov = (part.reshape(*lead, *part.shape[1:]) for part in found.by_run)
    return OnlineBelief(step, plan.layout, lead, mean, cov, log_evidence, status, kind, careful)
