"""The belief of an online filter at a step, and what it carries from one step to the next.

Where float64 has too few digits, steps are made with moments in pairs of float64, *in twice the
digits*; a belief has these as `careful`. Float64 loses digits where a covariance is nearly
singular, where a variance falls far at once, or where a mean is very many standard deviations from
zero; moments without any of these are *moderate*. A compiled step leaves its results packed in
slots, the *core*, from which the attributes of a belief are made when one is asked for.

A belief is over the *slice*, the hidden variables of a step, which `layout` stacks to a vector of n
components. `mean` and `cov` are (*lead, n) and (*lead, n, n), where `lead` is the shape of the
user's axes of runs. With a lag a belief has in `behind` the earlier steps that the filter keeps: a
`Trail` of transitions, or a `Sliding` window; without a lag it has None. Its `watch` is the test
whether the belief is lost, that is, wrong by more than its covariance says; None if the filter was
made without. `_gated` has the decisions of gates at its last update: of each a sensor, the
decisions, and the order of the sightings. A *plan* (`ChainPlan`) lays out the CPDs and evidence of
a few steps, for some runs. In arrays of moments with a *batch* that is the last axis, of runs; one
run has no such axis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any, ClassVar, NoReturn, Protocol

import numpy as np

from pgm.beliefs.moments.digits import certificate, close_points, last_places
from pgm.beliefs.moments.digits.careful_belief import Belief, over
from pgm.beliefs.moments.digits.careful_pass import Begin
from pgm.beliefs.moments.online.judged import Decided
from pgm.beliefs.moments.online.origin import Origin, Pair
from pgm.beliefs.moments.online.records import Records
from pgm.beliefs.moments.online.watch import Watch
from pgm.beliefs.moments.online.window import Sliding, Trail, is_like
from pgm.beliefs.moments.steps.gate import Asked
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.compile import SliceLayout
from pgm.display import Summary, titled
from pgm.errors import EvidenceError, ModelError, NumericalError, Unanswered
from pgm.factors import Gaussian
from pgm.factors.scope import namesake
from pgm.immutable import Immutable, set_writeable
from pgm.kernels import gaussian
from pgm.kernels.arrays import Array, Integers, Mask, block, symmetric
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.associations import NONE, Found
from pgm.posteriors.belief_kind import FILTERED, PREDICTED, Kind
from pgm.posteriors.lost import PageTest
from pgm.posteriors.online_belief import OnlineBelief
from pgm.posteriors.posterior import require_variable
from pgm.posteriors.predictions import require_parents
from pgm.posteriors.rejections import Rejections, RejectionsBySensor
from pgm.posteriors.status import CLOSE_POINTS, FAR_APART, LAST_PLACE, Status, digits
from pgm.posteriors.step_innovations import StepInnovations, StepInnovationsBySensor
from pgm.posteriors.summaries import at_a_step
from pgm.schedules.late import NOTHING, Log
from pgm.schedules.schedule import Filtering, FixedLag
from pgm.variables import Variable

# The least share of a variance that the components before it, or a step, leave of moderate moments.
_REGULAR = 1.0 / certificate.MODERATE


class Steps(Protocol):
    """The part of a filter's compiled steps that a belief reads from its core.

    `layout` is that of the slices. `only` is the slice's hidden variable, if there is just one and
    machine code for its `marginal`, which is made from a core's bytes; else None. `record` says how
    numbers lie in these: the mean (n,), the covariance (n, n), the log-evidence, and with a watch
    its numbers. Behind them stand `Records`. `asks` are the filter's steps, of which a belief asks
    what it has no numbers of.
    """

    layout: SliceLayout
    only: Variable | None
    marginal: Callable[[bytes], Gaussian]
    record: Any
    asks: Any


def opened(steps: Steps, numbers: bytes) -> Any:
    """The numbers of a core by name, as views that cannot be written to."""
    return _array((), steps.record, numbers)


_array = np.ndarray


class _Later:
    """An attribute of a belief that is made from the core when it is first asked for."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, belief: MomentBelief | None, owner: type) -> Any:
        """Make all attributes from the core, and return this one.

        A belief without a core has the attribute itself or, being incomplete, raises an
        `AttributeError`.
        """
        steps = None if belief is None else belief._steps
        if belief is None or steps is None:
            raise AttributeError(self.name)
        step, numbers, kind = belief._number, belief._numbers, belief._kind
        records, behind = belief._records, belief._behind
        assert records is not None
        found = opened(steps, numbers)
        rest = np.frombuffer(numbers, offset=steps.record.itemsize)
        moments = found["mean"], found["cov"], found["total"]
        parts = step, steps.layout, (), *moments, records.status(rest), kind, None, behind
        MomentBelief.__init__(belief, *parts)
        pair = None
        if kind == FILTERED and hasattr(belief, "_before"):  # one out of a log has none
            pair = partial(_update, steps, step, belief._before, records, rest)
        belief.__dict__["_origin"] = Origin(steps.asks, pair)
        if "watch" in steps.record.names:
            belief.__dict__["watch"] = Watch.of(found["watch"])
        belief.__dict__["_gated"] = records.decided(rest) if kind == FILTERED else ()
        put_steps(belief, steps)
        return belief.__dict__[self.name]


_later: Any = _Later


def _update(steps: Steps, step: int, before: bytes, records: Records, rest: Array) -> Pair:
    """The belief before an update in machine code, and the readings, from the numbers of both."""
    found = opened(steps, before)
    moments = found["mean"], found["cov"], found["total"]
    known = MomentBelief(step, steps.layout, (), *moments, nothing_to_iterate(()), PREDICTED)
    return known, records.given(rest)


class _Kept:
    """Base of online beliefs: the core.

    _steps: The compiled steps of its filter; None where there is no core, but attributes alone.
    _number: The step.
    _numbers: Mean, covariance and log-evidence, and the step's records; see `Steps`.
    _kind: Whether it is predicted or filtered.
    _records: How the step's records are read; None of an adopted belief, which has its attributes.
    _behind: The steps behind it; None without a lag.
    _before: After an update, the numbers of the belief before it.
    """

    __slots__ = ("_before", "_behind", "_kind", "_number", "_numbers", "_records", "_steps")

    _steps: Steps | None
    _number: int
    _numbers: bytes
    _kind: Kind
    _records: Records | None
    _behind: Trail | None
    _before: bytes


class MomentBelief(_Kept, OnlineBelief, Immutable):
    """The belief of an online filter at one step, as a mean and a covariance over the slice.

    careful: The belief in twice the digits, where float64 has too few; else None. Given a flat
        prior it has what measurements have told of it, as long as that leaves directions unknown.
    behind: The steps kept behind it for a lag; None without.
    watch: The state of the test whether it is lost; None without.
    _origin: What made it, and its last update; None of a lagged one.
    """

    beliefs: ClassVar[str] = "Gaussian beliefs"

    step: int = _later()
    layout: SliceLayout = _later()
    lead: tuple[int, ...] = _later()
    mean: Array = _later()
    cov: Array = _later()
    log_evidence: Array = _later()
    status: Status = _later()
    kind: Kind = _later()
    careful: Begin | None = _later()
    behind: Trail | Sliding | None = _later()
    associations: Found = NONE
    _gated: tuple[Decided, ...] = _later()
    watch: Watch | None = _later()
    _origin: Origin | None = _later()
    _arrays: ClassVar[str] = ".mean and .cov by variable, belief[x].mean"

    def __init__(
        self,
        step: int,
        layout: SliceLayout,
        lead: tuple[int, ...],
        mean: Array,
        cov: Array,
        log_evidence: Array,
        status: Status,
        kind: Kind,
        careful: Begin | None = None,
        behind: Trail | Sliding | None = None,
    ) -> None:
        set_writeable(mean, False)
        set_writeable(cov, False)
        set_writeable(log_evidence, False)
        values = self.__dict__  # as `_set`, in a third of the time
        values["step"] = step
        values["layout"] = layout
        values["lead"] = lead
        values["mean"] = mean
        values["cov"] = cov
        values["log_evidence"] = log_evidence
        values["status"] = status
        values["kind"] = kind
        values["careful"] = careful
        values["behind"] = behind
        values["_gated"] = ()
        values["watch"] = None
        values["_origin"] = None
        put_steps(self, None)

    def __getstate__(self) -> dict[str, Any]:
        state = {"step": self.step} | super().__getstate__()  # the step first: it makes the rest
        return {k: v for k, v in state.items() if k not in _Kept.__slots__} | {"_steps": None}

    def __getitem__(self, variable: Variable) -> Gaussian:
        """The marginal of a hidden variable at the belief's step, (*runs, d).

        Raises
        ------
        EvidenceError
            If the belief is not over the variable, or of another step.
        """
        steps = self._steps
        if steps is not None and variable is steps.only:
            marginal = steps.marginal  # as a method it is looked up in four times the time
            return marginal(self._numbers)
        if type(variable) is not Variable:
            require_variable(variable)
        layout, template = self.layout, variable.template
        known = layout.slice if self.step else layout.states
        if template not in known or variable.step not in (None, self.step):
            raise EvidenceError(
                f"the belief at step {self.step} is over {list(known)}, not {variable!r}"
                f"{namesake(variable, known)}",
                variable=variable,
                step=self.step,
            )
        mean, cov = self.mean, self.cov
        if layout.slice != (template,):
            places = layout.places[template]
            mean, cov = mean[..., places], block(cov, places, places)
        # That of one run is exactly symmetric.
        return Gaussian._make((variable,), mean, symmetric(cov) if self.lead else cov)

    def told(self, associations: Found, gate: Asked | None) -> MomentBelief:
        """The same belief with the `associations` of its update's measurements, by sensor.

        Its watch, if it has one, counts them, too: of a sensor without a gate all associated
        sightings, of a sensor with one only those that were taken for no candidate. `gate` is the
        probability of all sensors' gates, or a mapping from sensors to theirs; None for no gate.
        """
        found = copy(self)
        watch = None if self.watch is None else self.watch.told(associations, gate)
        found._set(associations=MappingProxyType(dict(associations)), watch=watch)
        return found

    def judged(self, gated: tuple[Decided, ...], watch: Watch | None) -> MomentBelief:
        """The same belief with the decisions `gated` of gates at its last update, and a `watch`."""
        found = object.__new__(type(self))  # as `copy`, in a fifth of the time
        found.__dict__.update(self.__dict__, _gated=gated, watch=watch)
        put_steps(found, None)
        return found

    @property
    def rejected(self) -> Mapping[Variable, Rejections]:
        """The decisions of the gates at the last update, by sensor."""
        return RejectionsBySensor(
            {
                variable: Rejections.of(record, np.full(len(order), self.step), order, self.lead)
                for variable, record, order in self._gated
            }
        )

    @property
    def innovations(self) -> Mapping[Variable, StepInnovations]:
        """The innovations of the last update, by sensor; of none if the belief is predicted.

        They are found when they are asked for, by making the update again.

        Raises
        ------
        ModelError
            If a function of the model answers otherwise than it did in the update.
        """
        return self._innovations

    @cached_property
    def _innovations(self) -> StepInnovationsBySensor:
        origin = self._origin
        if origin is None or self.kind != FILTERED:
            return StepInnovationsBySensor({})
        return StepInnovationsBySensor(origin.steps.innovations(self, origin.pair))

    def _measurement(self, variable: Variable, given: Mapping[Variable, Any]) -> Gaussian:
        if variable in self.layout.slice:
            return self[variable]
        require_parents(self.layout.model, variable, given, self.step)
        assert self._origin is not None  # as of all that are predicted
        return self._origin.steps.measurement(self, variable, given)

    def plain(self) -> MomentBelief:
        """The same belief without steps behind it, and without what it was made by."""
        parts = self.step, self.layout, self.lead, self.mean, self.cov, self.log_evidence
        found = MomentBelief(*parts, self.status, self.kind, self.careful)
        found.__dict__["watch"] = self.watch
        return found

    def bare(self) -> MomentBelief:
        """The same belief without a log of the steps behind it, for another log to keep."""
        found = self.plain()
        assert self.behind is not None
        found.__dict__["behind"] = self.behind.logged(NOTHING)
        return found

    def restored(self, log: Log) -> MomentBelief:
        """A bare belief with a log of the steps behind it, from which the filter can go on."""
        return self.judged(self._gated, self.watch).log(log)

    def log(self, log: Log) -> MomentBelief:
        """The belief itself, which is new, with a log of the steps behind it."""
        assert self.behind is not None
        self.__dict__["behind"] = self.behind.logged(log)
        return self

    def of(self, origin: Origin) -> MomentBelief:
        """The belief itself, which is new, with its origin."""
        self.__dict__["_origin"] = origin
        return self

    @property
    def lost(self) -> Mask:
        """Whether the belief is probably wrong, (*runs): the verdict of a filter's watch.

        The filter has to be made with ``watch=True``.

        Raises
        ------
        EvidenceError
            If the filter does not watch.
        """
        return self._watched.lost.reshape(self.lead)

    @property
    def lost_since(self) -> Integers:
        """The step at which being lost probably began, (*runs); −1 where the belief is not lost."""
        found = self._watched
        return np.where(found.lost, found.first, -1).reshape(self.lead)

    @property
    def _watched(self) -> PageTest:
        """The state of the tests whether the belief is lost, after all its measurements.

        A filter made without ``watch=True`` has none, which raises an `EvidenceError`.
        """
        if self.watch is None:
            raise Unanswered(
                f"{self._title} was not watched, whether it is lost: make the filter with "
                "OnlineFilter(model, watch=True)",
                step=self.step,
            )
        return self.watch.test(self.step)

    @cached_property
    def lagged(self) -> MomentBelief:
        """The belief at the step a lag before this one, given all measurements so far.

        As long as fewer steps than the lag have been made, it is that of step 0. It exists if the
        filter's schedule is a `FixedLag`: ``belief.lagged[x]`` is x at ``belief.lagged.step``, and
        ``belief.lagged.kind`` tells how many later steps' measurements it knows. A filter goes on
        from the belief itself, not from the lagged one.

        Raises
        ------
        EvidenceError
            If the filter has no lag.
        NumericalError
            If float64 has too few digits to go back.
        """
        if self.behind is None:
            raise Unanswered(
                f"{self._title} is of a filter without a lag; make it with OnlineFilter(model, "
                "lag=5)",
                step=self.step,
            )
        step, mean, cov = self.behind.lagged(self.step, self.mean, self.cov)
        if step == self.step:
            return self
        kind = Kind(self.step - step + self.kind.lag)
        mean, cov = mean.copy(), cov.copy()
        parts = self.layout, self.lead, mean, cov, self.log_evidence, self.status, kind
        return MomentBelief(step, *parts)

    @property
    def _title(self) -> str:
        return f"OnlineBelief({self.kind}, step {self.step}, over {list(self.layout.slice)})"

    def _summary(self) -> Summary:
        """The summary that is displayed: how often gates rejected, runs lost, then the moments."""
        known = self.layout.slice if self.step else self.layout.states
        found = at_a_step(self._title, self, known, self.lead)
        told = [f"{v!r}: {those._title}" for v, those in self.rejected.items()]
        if self.watch is not None and self.lost.any():
            since = self.lost_since[self.lost].min()
            told.append(f"lost since step {since}, {int(self.lost.sum())} of {self.lost.size} runs")
        return Summary(found.title, [*told, *found.parts]) if told else found


put_steps: Callable[[MomentBelief, Steps | None], None] = _Kept.__dict__["_steps"].__set__


put_behind: Callable[[MomentBelief, Trail], None] = _Kept.__dict__["_behind"].__set__


def put_core(
    belief: MomentBelief,
    steps: Steps,
    number: int,
    numbers: bytes,
    kind: Kind,
    records: Records | None,
    behind: Trail | None,
) -> None:
    """Give a belief a core."""
    core = {"_steps": steps, "_number": number, "_numbers": numbers}
    belief._set(**core, _kind=kind, _records=records, _behind=behind)


def belief_of(
    plan: ChainPlan,
    step: int,
    found: Moments,
    log_evidence: Array,
    status: Status,
    kind: Kind,
    behind: Trail | Sliding | None,
    careful: Begin | None = None,
) -> MomentBelief:
    """A belief from moments `found`: mean (n, *batch) and covariance (n, n, *batch).

    `plan`, that of the step, tells the layout of the slice and the user's axes of runs. The
    belief's own arrays have these axes first, as `log_evidence`, (*lead), has them already.
    `careful` are the moments in twice the digits, None if the step was made in float64 alone.
    """
    lead, (mean, cov) = plan.lead, found
    if lead:
        mean, cov = (part.reshape(*lead, *part.shape[1:]) for part in found.by_run)
    told = log_evidence, status, kind, careful, behind
    return MomentBelief(step, plan.layout, lead, mean, cov, *told)


def careful_belief(
    plan: ChainPlan,
    step: int,
    found: Begin,
    log_evidence: Array,
    status: Status,
    kind: Kind,
    behind: Trail | None,
) -> MomentBelief:
    """A belief from moments in twice the digits, whose status tells how many digits means have.

    `found` has the moments, and `plan`, that of the step, tells the layout of the slice and the
    axes of runs. `log_evidence` is (*lead); `status` is that of the step, to which the digits are
    added. Moments or a log-evidence that are not finite in float64 raise a `NumericalError`, but
    for variances along directions of which nothing is known yet, given a flat prior.
    """
    (mean, spread), own = found.rounded, found.belief
    cov = spread.shown
    if not all(np.isfinite(part).all() for part in (mean, spread.cov, log_evidence)):
        refuse(step)
    status = status._losing(own.error(), FAR_APART)
    status = status._losing(last_places.of_beliefs(mean, cov, own.largest), LAST_PLACE)
    status._warn()
    parts = Moments.of(plan, mean, cov), log_evidence, status, kind, behind, found
    return belief_of(plan, step, *parts)


def moments_of(belief: MomentBelief, plan: ChainPlan) -> Moments:
    """The moments of a belief with the axis of runs last, repeated for the runs of a plan.

    The mean is (n, runs) and the covariance (n, n, runs), without the last axis for a single run.
    """
    if not plan.lead:
        return Moments(belief.mean, belief.cov)
    return Moments.of(plan, _wide(belief.mean, plan, 1), _wide(belief.cov, plan, 2))


def in_digits(belief: MomentBelief, plan: ChainPlan) -> Begin:
    """The moments of a belief in twice the digits, repeated for the runs of a plan.

    They are those that it has as `careful`, or are widened from float64.
    """
    if belief.careful is None:
        return Begin.known(Belief.of(_wide(belief.mean, plan, 1), _wide(belief.cov, plan, 2)))
    found: Begin = over(belief.careful, belief.lead, plan.lead)
    return found


def is_plain(belief: MomentBelief) -> bool:
    """Whether the next step from a belief may be made in float64.

    It may where the belief has no moments in twice the digits, or where float64 can carry these.
    """
    if belief.careful is None:
        return True
    return certificate.is_ordinary(belief.mean, belief.cov, certificate.SHARE)


def is_moderate(found: Moments, before: Moments) -> bool:
    """Whether float64 has digits enough for the moments `found`, made by a step from `before`.

    Three things are asked of each component. Its variance has to be at least 5·10⁻⁸ of its variance
    before the step. Its variance given the components that stand before it in the slice has to be
    at least 5·10⁻⁸ of its variance. Its mean has to be within 4.5·10¹⁰ standard deviations of zero.
    A component of variance zero passes if its variance was zero before.
    """
    return gaussian.is_moderate(found.mean, found.cov, before.cov, _REGULAR, certificate.FAR)


def told(
    status: Status, plan: ChainPlan, before: Moments, after: Moments, belief: MomentBelief
) -> Status:
    """The status of a step in float64, with the decimal digits that rounding leaves of means.

    Digits are lost where sigma points lie close together, or where a mean is very large beside its
    standard deviation. `before` and `after` are the moments before and after the step; `belief` is
    the belief before it, whose status has the digits left then. Without a loss the status stays as
    it is; else a `PrecisionWarning` is given if fewer than six digits are left.
    """
    left = belief.status.digits if belief.careful is None else None
    place = last_places.of_step(after)
    lost = close_points.of_step(plan, before, after, left, place)
    if lost is None:
        return status
    cause = CLOSE_POINTS if left is None else belief.status._cause
    if isinstance(place, float):  # digits are told anyhow
        lost = np.hypot(lost, last_places.of_each_step(after))
    elif place.max(initial=0.0) ** 2 > 0.5 * lost.max(initial=0.0) ** 2:
        cause = LAST_PLACE
    status = status._measured(digits(lost, plan.lead), cause)
    status._warn()
    return status


def refuse(step: int) -> NoReturn:
    """Raise the `NumericalError` that a belief, or its log-evidence, at a step is not finite."""
    raise NumericalError(
        f"the belief at step {step} or its log-evidence is not finite: numbers of the model or the "
        "evidence are larger, or further apart, than float64 can hold; give them in other units",
        step=step,
    )


def _wide(array: Array, plan: ChainPlan, own: int) -> Array:
    """A belief's array (*lead, ...) repeated for the runs of a plan, (runs, ...).

    `own` is how many axes of components the array has, its last ones: 1 of a mean, 2 of a
    covariance.
    """
    rest = array.shape[-own:]
    return np.broadcast_to(array, (*plan.lead, *rest)).reshape(plan.runs, *rest)


def nothing_to_iterate(lead: tuple[int, ...]) -> Status:
    """The status of a step in which nothing was linearised: one iteration, all runs converged."""
    return Status(1, np.empty((0, *lead)), np.ones(lead, dtype=bool))


def require_own(
    belief: object,
    model: DynamicBayesianNetwork,
    schedule: Filtering | FixedLag,
    behind: Trail | Sliding | None,
) -> None:
    """Refuse to go on from a belief of another model or schedule, or from one that is lagged.

    `behind` are the steps behind the filter's prior. The steps behind the belief have to be of the
    same kind, a trail or a window, and of the same lag. The error is a `ModelError`.
    """
    if not isinstance(belief, MomentBelief) or belief.layout.model is not model:
        raise ModelError(
            f"{titled(belief)} is no belief of this filter's model; begin with initial(). One that "
            "was pickled goes on with the filter pickled beside it, pickle.dumps((robot, belief))"
        )
    if not is_like(belief.behind, behind) or belief.kind.lag > 0:
        raise ModelError(
            f"{titled(belief)} is no belief to go on from with {schedule!r}: it is of a filter "
            "with another schedule, or lags behind one; begin with initial(), and go on from the "
            "newest belief"
        )
