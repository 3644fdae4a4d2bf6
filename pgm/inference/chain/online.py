"""Filtering in a robot's loop: the same rounds as a forward sweep, one at a time."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.compile import SliceLayout, compile
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence, Constant, Sightings, bind, constant, sightings
from pgm.evidence.arrays import as_rows
from pgm.factors import Gaussian
from pgm.immutable import Immutable
from pgm.inference.chain import forward
from pgm.inference.chain.cost import require_cost
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.reading import take
from pgm.inference.posterior import require_variable
from pgm.inference.schedule import ONCE, Filtering
from pgm.inference.status import Status
from pgm.kernels.arrays import Array, block, symmetric
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.inference.chain.online_single import Single


class OnlineBelief(Immutable):
    """The belief of an online filter at one step.

    Attributes
    ----------
    step : int
    log_evidence : ndarray
        (...): ln p of all readings so far.
    status : Status
        How the linearisations of the last update went.
    """

    __slots__ = ("cov", "layout", "lead", "log_density", "mean", "status", "step")

    step: int
    layout: SliceLayout
    lead: tuple[int, ...]
    mean: Array
    cov: Array
    log_density: Array
    status: Status

    def __init__(
        self,
        step: int,
        layout: SliceLayout,
        lead: tuple[int, ...],
        mean: Array,
        cov: Array,
        log_density: Array,
        status: Status,
    ) -> None:
        for array in (mean, cov, log_density):
            array.setflags(write=False)
        put = object.__setattr__
        put(self, "step", step)
        put(self, "layout", layout)
        put(self, "lead", lead)
        put(self, "mean", mean)
        put(self, "cov", cov)
        put(self, "log_density", log_density)
        put(self, "status", status)

    def after(
        self, step: int, mean: Array, cov: Array, log_density: Array, status: Status
    ) -> OnlineBelief:
        """The belief of a single run that follows this one, from moments (n,) and (n, n)."""
        return OnlineBelief(
            step, self.layout, self.lead, mean[None], cov[None], log_density, status
        )

    @property
    def log_evidence(self) -> Array:
        """The value ln p of all readings so far, (...)."""
        return self.log_density.reshape(self.lead)

    def __getitem__(self, variable: Variable) -> Gaussian:
        """The marginal of a hidden variable at the belief's step."""
        known = self.layout.slice if self.step else self.layout.states
        template = require_variable(variable).template
        if template not in known or variable.step not in (None, self.step):
            raise EvidenceError(
                f"the belief at step {self.step} is over {list(known)}, not {variable!r}",
                variable=variable,
                step=self.step,
            )
        places = self.layout.places[template]
        mean, cov = self.mean[:, places], symmetric(block(self.cov, places, places))
        return Gaussian._make(
            (variable,),
            mean.reshape(*self.lead, -1),
            cov.reshape(*self.lead, *cov.shape[-2:]),
        )

    def __repr__(self) -> str:
        return f"OnlineBelief(step {self.step}, over {list(self.layout.slice)})"


class OnlineFilter(Immutable):
    """A filter for one step at a time; immutable, and so are its beliefs.

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

        return Single()

    def __getstate__(self) -> dict[str, Any]:
        # What was prepared is not part of the value.
        return {name: getattr(self, name) for name in ("model", "lineariser", "schedule")}

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
        return OnlineBelief(
            0, layout, lead, slice_mean, slice_cov, np.zeros(plan.runs), _nothing_to_iterate(lead)
        )

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
        inputs = {} if inputs is None else _mapping(inputs, "predict", "inputs to values")
        if self._single is not None and belief.lead == ():
            after = self._single.predict(belief, inputs, self._ahead)
            if after is not None:
                return after
        plan = self._ahead(belief, inputs)
        mean, cov, log_density = _wide(belief, plan)
        states = plan.layout.state_places
        mean, cov = forward.predict(
            plan, 0, mean[:, states], block(cov, states, states), linearise=True
        )
        status = _nothing_to_iterate(plan.lead)
        return OnlineBelief(belief.step + 1, plan.layout, plan.lead, mean, cov, log_density, status)

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
        readings = _mapping(readings, "update", "sensors to readings")
        if self._single is not None and belief.lead == ():
            after = self._single.update(belief, readings, self._seen)
            if after is not None:
                return after
        plan = self._seen(belief, readings)
        mean, cov, log_density = _wide(belief, plan)
        taken = take(plan.sensors, 0, mean, cov, self.schedule)
        total = log_density + taken.log_density
        status = Status.of(taken.residuals, taken.converged, plan.lead)
        return OnlineBelief(
            belief.step, plan.layout, plan.lead, taken.mean, taken.cov, total, status
        )

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
        count = np.shape(value.values)[-2] if np.ndim(value.values) > 1 else 0
        return Sightings(value.values, np.zeros(count, dtype=np.intp), value.given)

    def _plan(self, bound: BoundEvidence, step: int, *, prior: bool = False) -> ChainPlan:
        return ChainPlan.make(
            self._graph, bound, self.lineariser, first=step, prior=prior, probe=False
        )


def _nothing_to_iterate(lead: tuple[int, ...]) -> Status:
    return Status(1, np.empty((0, *lead)), np.ones(lead, dtype=bool))


def _mapping(value: Any, method: str, what: str) -> Mapping[Variable, Any]:
    if not isinstance(value, Mapping):
        raise EvidenceError(f"{method} takes a mapping of {what}, not {type(value).__name__}")
    return value


def _constant(value: Any) -> Constant:
    return value if isinstance(value, Constant) else constant(value)


def _wide(belief: OnlineBelief, plan: ChainPlan) -> tuple[Array, Array, Array]:
    """The belief's arrays for the runs of a plan."""
    if belief.lead == plan.lead:
        return belief.mean, belief.cov, belief.log_density

    def wide(array: Array) -> Array:
        rest = array.shape[1:]
        full = np.broadcast_to(array.reshape((*belief.lead, *rest)), (*plan.lead, *rest))
        return full.reshape((plan.runs, *rest))

    return wide(belief.mean), wide(belief.cov), wide(belief.log_density)
