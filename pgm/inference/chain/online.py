"""Filtering in a robot's loop: the same rounds as a forward sweep, one at a time."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.compile import compile
from pgm.errors import EvidenceError, ModelError, NumericalError
from pgm.evidence import BoundEvidence, Constant, Sightings, bind, constant, sightings
from pgm.evidence.arrays import as_rows
from pgm.immutable import Immutable
from pgm.inference.chain import forward, online_careful
from pgm.inference.chain.cost import require_cost
from pgm.inference.chain.online_belief import OnlineBelief
from pgm.inference.chain.online_careful import CarefulBelief, is_regular
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.reading import MomentReading, Taken, Updated, take
from pgm.inference.chain.taking import variances
from pgm.inference.chain.update import sensors_due
from pgm.inference.kind import FILTERED, PREDICTED, Kind
from pgm.inference.schedule import ONCE, Filtering
from pgm.inference.status import Status, digits
from pgm.kernels.arrays import Array, block
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.inference.chain.online_single import Single


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
    def _single(self) -> Single | None:
        """The lean steps of a single robot; None where readings are linearised several times."""
        if self.schedule.iterations > 1:
            return None
        from pgm.inference.chain.online_single import Single  # here, since LAPACK is slow to import

        return Single(self._ahead, self._seen)

    def __getstate__(self) -> dict[str, Any]:
        # What was prepared is not part of the value.
        return {name: getattr(self, name) for name in ("model", "lineariser", "schedule")}

    @_quiet
    def initial(self) -> OnlineBelief:
        """The prior, at step 0."""
        layout, lead = self._graph.layout, self.model.lead
        plan = self._plan(BoundEvidence(0, lead, (), ()), 0, prior=True)
        states = layout.state_places
        slice_mean = np.zeros((plan.runs, layout.slice_size))
        slice_cov = np.zeros((plan.runs, layout.slice_size, layout.slice_size))
        mean, cov = forward.start(plan, linearise=True)
        slice_mean[:, states] = mean
        forward.put(slice_cov, states, cov)
        log_evidence, status = np.zeros(lead), _nothing_to_iterate(lead)
        if is_regular(slice_cov):
            return _belief(plan, 0, slice_mean, slice_cov, log_evidence, status, PREDICTED)
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
        single = self._single
        if single is not None and not belief.lead and belief.careful is None:
            after = single.predict(belief, inputs)
            if after is not None:
                return after
        return self._predicted(belief, inputs)

    def _predicted(self, belief: OnlineBelief, inputs: Mapping[Variable, Any]) -> OnlineBelief:
        plan = self._ahead(belief, inputs)
        step, status = belief.step + 1, _nothing_to_iterate(plan.lead)
        log_evidence = np.broadcast_to(belief.log_evidence, plan.lead)
        if belief.careful is None:
            mean, cov = _wide(belief.mean, plan, 1), _wide(belief.cov, plan, 2)
            states = plan.layout.state_places
            mean, cov = forward.predict(
                plan, 0, mean[:, states], block(cov, states, states), linearise=True
            )
            if is_regular(cov):
                return _belief(plan, step, mean, cov, log_evidence, status, PREDICTED)
        found = online_careful.predict(plan, step, _careful(belief, plan))
        return _carried(plan, step, found, log_evidence, status, PREDICTED)

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
        single = self._single
        if single is not None and not belief.lead and belief.careful is None:
            after = single.update(belief, readings)
            if after is not None:
                return after
        return self._updated(belief, readings)

    def _updated(self, belief: OnlineBelief, readings: Mapping[Variable, Any]) -> OnlineBelief:
        plan = self._seen(belief, readings)
        ordinary = self._update(belief, plan) if belief.careful is None else None
        if ordinary is not None:
            return ordinary
        # A plan keeps what was linearised; one laid out anew begins at the belief.
        plan = self._seen(belief, readings)
        known = _careful(belief, plan)
        found, taken = online_careful.update(plan, belief.step, known, self.schedule)
        log_evidence, status = _told(belief, plan, taken)
        return _carried(plan, belief.step, found, log_evidence, status, FILTERED)

    def _update(self, belief: OnlineBelief, plan: ChainPlan) -> OnlineBelief | None:
        """In float64; None where it has too few digits."""
        mean, cov = _wide(belief.mean, plan, 1), _wide(belief.cov, plan, 2)
        try:
            taken = take(MomentReading(sensors_due(plan.sensors, 0), 0, mean, cov), self.schedule)
        except NumericalError:
            return None  # with twice the digits there may be an answer; if not, the same is refused
        after = taken.solution.cov
        if online_careful.fell(variances(cov), variances(after)) or not is_regular(after):
            return None
        log_evidence, status = _told(belief, plan, taken)
        return _belief(plan, belief.step, taken.mean, after, log_evidence, status, FILTERED)

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


def _told(belief: OnlineBelief, plan: ChainPlan, taken: Taken[Updated]) -> tuple[Array, Status]:
    """The log-evidence with readings that were taken, and how that went."""
    log_evidence = belief.log_evidence + taken.solution.log_density.reshape(plan.lead)
    return np.asarray(log_evidence), Status.of(taken.residuals, taken.converged, plan.lead)


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
    """A belief with the digits that it has, carried in twice those of float64 while it must be."""
    mean, cov = found.moments
    _refuse_infinite(step, mean, cov, log_evidence)
    status = status.with_digits(digits(found.error, plan.lead))
    kept = None if found.is_ordinary else found
    return _belief(plan, step, mean, cov, log_evidence, status, kind, kept)


def _belief(
    plan: ChainPlan,
    step: int,
    mean: Array,
    cov: Array,
    log_evidence: Array,
    status: Status,
    kind: Kind,
    careful: CarefulBelief | None = None,
) -> OnlineBelief:
    """A belief with the runs as the user's axes."""
    _refuse_infinite(step, mean, cov, log_evidence)
    lead, size = plan.lead, mean.shape[-1]
    mean, cov = mean.reshape(*lead, size), cov.reshape(*lead, size, size)
    return OnlineBelief(step, plan.layout, lead, mean, cov, log_evidence, status, kind, careful)


def _refuse_infinite(step: int, *parts: Array) -> None:
    """Refuse what float64 cannot hold."""
    if not all(np.isfinite(part).all() for part in parts):
        raise NumericalError(
            f"the belief at step {step} or its log-evidence is not finite: numbers of the model or "
            "the evidence are larger, or further apart, than float64 can hold; give them in other "
            "units",
            step=step,
        )
