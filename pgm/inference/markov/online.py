"""Filtering a discrete dynamic network in a robot's loop, one step at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from pgm.boundary import as_mapping
from pgm.compile import compile
from pgm.display import InCode, NoArray, Shown, Summary, titled
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence
from pgm.factors import Table
from pgm.factors.axes import discrete
from pgm.factors.scope import namesake
from pgm.immutable import Immutable
from pgm.inference.markov.chain import TINY, BackwardChain, StateChain, smallest
from pgm.inference.markov.plan import SlicePlan, TableSlices
from pgm.inference.markov.run import require_beliefs
from pgm.inference.online import step_evidence
from pgm.inference.posterior import require_variable
from pgm.inference.schedule import Filtering, FixedLag
from pgm.inference.status import FILTERED, PREDICTED, Kind, Status
from pgm.inference.summaries import at_a_step
from pgm.kernels.arrays import Array, frozen
from pgm.kernels.tables import LOG_SUM_PRODUCT, SUM_PRODUCT, Semiring
from pgm.linearisers import TAYLOR
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable


class Held(NamedTuple):
    """A belief over a slice, of sum one, and the weights of its step's measurements so far.

    entries: (*states, *runs), numbers or logarithms.
    weights: The same; None, if there were no measurements.
    linear: Whether they are numbers.
    """

    entries: Array
    weights: Array | None
    linear: bool

    @property
    def semiring(self) -> Semiring:
        """The semiring of the entries."""
        return SUM_PRODUCT if self.linear else LOG_SUM_PRODUCT

    def within(self, semiring: Semiring) -> Held:
        """The same, in another semiring."""
        if semiring.linear == self.linear:
            return self
        weights = None if self.weights is None else semiring.entries(self.weights)
        return Held(semiring.entries(self.entries), weights, semiring.linear)

    @property
    def numbers(self) -> Array:
        """The probabilities."""
        if self.linear:
            return self.entries
        with np.errstate(under="ignore"):
            found: Array = np.exp(self.entries)
        return found

    @property
    def loses(self) -> bool:
        """Whether numbers may have lost a state, so that logarithms are due."""
        return self.linear and smallest(self.entries) < TINY


class Passed(NamedTuple):
    """A step that lies behind a belief: its own belief, and the transition out of it."""

    held: Held
    ahead: TableSlices


class OnlineStates(Shown, NoArray, Immutable):
    """The belief of an online filter of a discrete network at one step.

    log_evidence: (*runs): ln p of all measurements so far.
    status: Tables need no iterations.
    kind: Filtered after an update, predicted before; of `lagged`, fixed-lag.
    """

    step: int
    log_evidence: Array
    status: Status
    kind: Kind
    lead: tuple[int, ...]
    # A window of steps that are linearised again, which tables need none of.
    behind: None
    _plan: SlicePlan
    _held: Held
    _trail: tuple[Passed, ...]
    _lag: int | None

    _arrays: ClassVar[str] = "probabilities by variable, belief[x].probabilities"

    def __init__(
        self,
        plan: SlicePlan,
        step: int,
        kind: Kind,
        held: Held,
        log_evidence: Array,
        lag: int | None,
        trail: tuple[Passed, ...] = (),
    ) -> None:
        lead = log_evidence.shape
        status = Status.of([], np.ones(math.prod(lead), dtype=bool), lead)
        self._set(
            step=step, kind=kind, log_evidence=frozen(np.asarray(log_evidence)), status=status
        )
        self._set(lead=lead, behind=None, _plan=plan, _held=held, _lag=lag, _trail=trail)

    def __getitem__(self, variable: Variable) -> Table:
        """The marginal of a hidden variable at the belief's step.

        Returns (*runs, size).
        """
        plan, template = self._plan, require_variable(variable).template
        hidden = plan.slice if self.step else plan.states
        if template not in hidden or variable.step not in (None, self.step):
            raise EvidenceError(
                f"the belief at step {self.step} is over {list(hidden)}, not {variable!r}"
                f"{namesake(variable, hidden)}",
                variable=variable,
                step=self.step,
            )
        own = plan.labels[template]
        others = tuple(k for k in range(len(plan.slice)) if k != own)
        values = self._held.numbers.sum(axis=others) if others else self._held.numbers
        rows = np.array(values.T).reshape(*self.lead, values.shape[0])
        return Table._plain(discrete((template,)), frozen(rows))

    @property
    def lagged(self) -> OnlineStates:
        """The belief at the step a lag before, given all measurements; at step 0 until then."""
        if self._lag is None:
            raise EvidenceError(
                f"{self._title} is of a filter without a lag; make it with OnlineFilter(model, "
                "lag=5)",
                step=self.step,
            )
        if not self._trail:
            return self
        passed = len(self._trail)
        values = _Window(self._trail, self._held, self.lead).smoothed()
        found = Held(values, None, linear=True)
        kind = Kind(passed + self.kind.lag)
        return OnlineStates(
            self._plan, self.step - passed, kind, found, np.array(self.log_evidence), self._lag
        )

    @property
    def _title(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        return f"OnlineStates({self.kind}, step {self.step}{runs})"

    def _summary(self) -> Summary:
        hidden = self._plan.slice if self.step else self._plan.states
        return at_a_step(self._title, self, hidden, self.lead)


class _Window:
    """The steps of a lag, to go back along; forward they have been gone."""

    def __init__(self, passed: Sequence[Passed], last: Held, lead: tuple[int, ...]) -> None:
        every = [*(each.held for each in passed), last]
        linear = all(each.linear for each in every)
        self.semiring = SUM_PRODUCT if linear else LOG_SUM_PRODUCT
        self.held = [each.within(self.semiring) for each in every]
        self.ahead = [each.ahead for each in passed]
        self.steps, self.lead = len(passed), lead

    def smoothed(self) -> Array:
        """The probabilities of the first step's states, given all of the window."""
        chain = BackwardChain(self, self.semiring)
        chain.known = [each.entries for each in self.held]
        message = chain.unit()
        for step in range(self.steps - 1, -1, -1):
            message = chain.back(step, message)
        return chain.posterior(0, message)

    def likelihood(self, step: int) -> tuple[Array | None, Array | float]:
        return self.held[step].weights, 0.0

    def backward(self, step: int, message: Array) -> Array:
        ahead = self.ahead[step - 1].within(self.semiring)
        return ahead.backward(ahead.first, message)  # whose only row is of its own step


class OnlineTables(InCode, Immutable):
    """A filter of a discrete network for one step at a time.

    Made by ``OnlineFilter(model)``, of a network of tables. It is immutable, and so are its
    beliefs.

    lag: In steps, of ``belief.lagged``.
    """

    model: DynamicBayesianNetwork
    lag: int | None

    def __init__(self, model: DynamicBayesianNetwork, lag: int | None = None) -> None:
        self._set(model=model, lag=lag)
        require_beliefs(self._plan, BoundEvidence(0, (), (), ()), 2)

    @cached_property
    def _plan(self) -> SlicePlan:
        return SlicePlan(compile(self.model, 1).layout)

    def __getstate__(self) -> dict[str, Any]:
        # What was laid out is not part of the value.
        return {"model": self.model, "lag": self.lag}

    def __repr__(self) -> str:
        lag = "" if self.lag is None else f", lag={self.lag}"
        return f"OnlineFilter(over {list(self.model.states)}{lag})"

    def initial(self) -> OnlineStates:
        """The prior, at step 0."""
        slices = TableSlices(self._plan, BoundEvidence(0, (), (), ()))
        semiring = SUM_PRODUCT if slices.smallest >= TINY else LOG_SUM_PRODUCT
        chain = StateChain(slices.within(semiring), semiring)
        prior = chain.start()
        held = Held(semiring.over(prior, chain.total(prior)), None, semiring.linear)
        return OnlineStates(self._plan, 0, PREDICTED, held, np.zeros(()), self.lag)

    def predict(
        self, belief: OnlineStates, inputs: Mapping[Variable, Any] | None = None
    ) -> OnlineStates:
        """The belief one step later.

        inputs: Of the transition's inputs the name or index of a state, (...), or values (..., d).
        """
        self._check(belief)
        given = as_mapping(inputs, "the inputs of predict")
        bound = step_evidence.inputs(self.model, belief, given)
        step = belief.step + 1
        slices = TableSlices(self._plan, bound, first=step)
        before = self._spread(belief, bound.lead)
        held, log_density = self._in_digits(
            slices, before._held, lambda own, known: (own.forward(step, known.entries), None, 0.0)
        )
        trail = (*before._trail, Passed(before._held, slices))
        return OnlineStates(
            self._plan,
            step,
            PREDICTED,
            held,
            before.log_evidence + log_density.reshape(bound.lead),
            self.lag,
            trail[-self.lag :] if self.lag else (),
        )

    def update(self, belief: OnlineStates, readings: Mapping[Variable, Any]) -> OnlineStates:
        """The belief given measurements of its step; a further update goes on from the first.

        readings: For a sensor the name or index of the state measured, (...), `soft` weights (...,
            size), or ``pgm.sightings(values, given=...)`` without steps, any number; for inputs
            that the sensors need, their states or values.
        """
        self._check(belief)
        given = step_evidence.mapping(readings, "update", "sensors to measurements")
        bound = step_evidence.readings(self.model, belief, given)
        step = belief.step
        shifted = tuple(replace(r, step=r.step + step) for r in bound.readings)
        slices = TableSlices(self._plan, replace(bound, readings=shifted), first=step)
        before = self._spread(belief, bound.lead)

        def taken(own: TableSlices, known: Held) -> tuple[Array, Array | None, Array | float]:
            weights, scale = own.likelihood(step)
            if weights is None:
                return known.entries, known.weights, 0.0
            joint = own.semiring.times(known.entries, weights)
            weights = np.broadcast_to(weights, joint.shape)
            if known.weights is not None:
                weights = own.semiring.times(known.weights, weights)
            return joint, weights, scale

        held, log_density = self._in_digits(slices, before._held, taken)
        return OnlineStates(
            self._plan,
            step,
            FILTERED,
            held,
            before.log_evidence + log_density.reshape(bound.lead),
            self.lag,
            before._trail,
        )

    def _in_digits(self, slices: TableSlices, known: Held, work: Any) -> tuple[Held, Array]:
        """Work on a belief in numbers, or where these lose a state in logarithms; its log-mass."""
        for semiring in (SUM_PRODUCT, LOG_SUM_PRODUCT):
            if semiring.linear and (not known.linear or slices.smallest < TINY):
                continue
            chain = StateChain(slices, semiring)
            entries, weights, scale = work(slices.within(semiring), known.within(semiring))
            totals = chain.total(entries)
            if semiring.linear and slices.smallest < TINY:  # as tables of functions have told
                continue
            if not np.all(totals > semiring.zero):
                if semiring.linear:
                    continue
                own = slices.within(semiring)
                own.refuse(slices.first, known.within(semiring).entries, int(np.argmin(totals)))
            if weights is not None:  # of the states that are possible the largest one is one
                weights = np.where(entries > semiring.zero, weights, semiring.zero)
                top = weights.max(axis=tuple(range(len(self._plan.slice))))
                weights = semiring.over(weights, top)
            held = Held(semiring.over(entries, totals), weights, semiring.linear)
            if not held.loses:
                break
        return held, np.asarray(semiring.logs(totals) + scale)

    def _spread(self, belief: OnlineStates, lead: tuple[int, ...]) -> OnlineStates:
        """The belief of one run, or of fewer axes of runs, as that of all of them."""
        if belief.lead == lead:
            return belief
        axes = len(self._plan.slice)

        def wide(values: Array | None) -> Array | None:
            if values is None:
                return None
            new = (1,) * (len(lead) - len(belief.lead))
            own = values.reshape(*values.shape[:axes], *new, *belief.lead)
            spread = np.broadcast_to(own, (*values.shape[:axes], *lead))
            return spread.reshape(*values.shape[:axes], math.prod(lead))

        def held(each: Held) -> Held:
            entries = wide(each.entries)
            assert entries is not None
            return Held(entries, wide(each.weights), each.linear)

        trail = tuple(Passed(held(each.held), each.ahead) for each in belief._trail)
        log_evidence = np.array(np.broadcast_to(belief.log_evidence, lead))
        return OnlineStates(
            self._plan, belief.step, belief.kind, held(belief._held), log_evidence, self.lag, trail
        )

    def _check(self, belief: OnlineStates) -> None:
        mine = isinstance(belief, OnlineStates) and belief._plan.model is self.model
        if not mine or belief.kind.lag > 0 or belief._lag != self.lag:
            raise ModelError(
                f"{titled(belief)} is no belief to go on from with {self!r}: begin with its "
                "initial(), and go on from the newest belief; copy or pickle a filter and its "
                "beliefs together"
            )


def online_tables(
    model: DynamicBayesianNetwork,
    lineariser: Any = TAYLOR,
    schedule: Any = None,
    lag: int | None = None,
) -> OnlineTables:
    """The filter of a network of tables, where nothing is asked for that it has no use of."""
    if lineariser != TAYLOR:
        raise ModelError(f"an online filter of tables linearises nothing: leave {lineariser!r} out")
    if schedule is not None and lag is not None:
        raise ModelError(f"lag={lag!r} beside {schedule!r}: an online filter takes one of them")
    if lag is not None:
        schedule = FixedLag(lag)
    if schedule is not None and not isinstance(schedule, Filtering | FixedLag):
        raise ModelError(
            f"an online filter takes pgm.Filtering(...) or pgm.FixedLag(...), not {schedule!r}"
        )
    return OnlineTables(model, schedule.lag if isinstance(schedule, FixedLag) else None)
