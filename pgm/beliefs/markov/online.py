"""Filtering a discrete dynamic network in a robot's loop, one step at a time.

Beliefs are over a *slice*, the hidden variables of a step: (*slice, *runs), an axis for each
variable, then one of runs, or none where the user gave no axes of runs. Their entries are numbers,
or logarithms where numbers may underflow: a *semiring* is the arithmetic of the one or the other.
`Held` is such a belief, with the weights ∝ p(measurements | states) of its step. A *log-scale* is
the logarithm of a number by which entries or weights have been divided.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from pgm.beliefs.markov.chain import TINY, StateChain
from pgm.beliefs.markov.measurements import at_rows
from pgm.beliefs.markov.online_beliefs import Held, OnlineStates, Passed
from pgm.beliefs.markov.plan import SlicePlan, TableSlices
from pgm.beliefs.markov.run import require_beliefs
from pgm.boundary import as_mapping
from pgm.compile import SliceGraph
from pgm.display import InCode, titled
from pgm.errors import ModelError
from pgm.evidence import BoundEvidence
from pgm.factors import Gaussian, GaussianMixture, Table
from pgm.factors.axes import discrete
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import LOG_SUM_PRODUCT, SUM_PRODUCT
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.belief_kind import FILTERED, PREDICTED
from pgm.schedules import step_evidence
from pgm.schedules.late import NOTHING, Copied, Log
from pgm.schedules.online_schedule import online_schedule
from pgm.schedules.schedule import FixedLag
from pgm.variables import Variable


class TableSteps(InCode, Immutable):
    """A filter of a discrete network for one step at a time.

    Made by ``OnlineFilter(model)``, of a network of tables. It is immutable, and so are its
    beliefs.

    lag: How many steps ``belief.lagged`` is behind; None in a filter without smoothed beliefs.
    """

    model: DynamicBayesianNetwork
    lag: int | None

    def __init__(self, model: DynamicBayesianNetwork, lag: int | None = None) -> None:
        self._set(model=model, lag=lag)
        require_beliefs(self._plan, BoundEvidence(0, (), (), ()), 2)

    @property
    def options(self) -> dict[str, Any]:
        """The options of `OnlineFilter` by which the same steps are made."""
        return {"lag": self.lag}

    @cached_property
    def _plan(self) -> SlicePlan:
        return SlicePlan(SliceGraph(self.model, 1).layout)

    def __getstate__(self) -> dict[str, Any]:
        # What was laid out is not part of the value.
        return {"model": self.model, "lag": self.lag}

    def __repr__(self) -> str:
        lag = "" if self.lag is None else f", lag={self.lag}"
        return f"OnlineFilter(over {list(self.model.states)}{lag})"

    def initial(self) -> OnlineStates:
        """The prior, as the predicted belief at step 0."""
        slices = TableSlices(self._plan, BoundEvidence(0, (), (), ()))
        semiring = SUM_PRODUCT if slices.smallest >= TINY else LOG_SUM_PRODUCT
        chain = StateChain(slices.within(semiring), semiring)
        prior = chain.start()
        held = Held(semiring.over(prior, chain.total(prior)), None, semiring.linear)
        return OnlineStates(self, 0, PREDICTED, held, np.zeros(()))

    def predict(
        self, belief: OnlineStates, inputs: Mapping[Variable, Any] | None = None
    ) -> OnlineStates:
        """The belief one step later, before its measurements.

        belief: A belief of this filter. One of another filter, or a smoothed one of `lagged`,
            raises `ModelError`.
        inputs: The value of each input of the transition: of a discrete one the name or index of a
            state, (...), of a vector its components, (..., d). The dots are axes of runs. None if
            the transition has no inputs.
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
            self,
            step,
            PREDICTED,
            held,
            before.log_evidence + log_density.reshape(bound.lead),
            trail[-self.lag :] if self.lag else (),
            belief._log.on(belief.restored(NOTHING), Copied(inputs), self.lag)
            if self.lag
            else NOTHING,
        )

    def update(self, belief: OnlineStates, readings: Mapping[Variable, Any]) -> OnlineStates:
        """The belief given measurements of its step, and those of earlier updates at this step.

        belief: A belief of this filter. One of another filter, or a smoothed one of `lagged`,
            raises `ModelError`.
        readings: For each sensor its measurement: the name or index of a state, (...); or `soft`
            weights of the states, (..., size); or any number of measurements, as
            ``pgm.sightings(values, given=...)`` without steps. The dots are axes of runs. Inputs
            that the sensors need are keys, too, with their states or values.
        """
        self._check(belief)
        given = step_evidence.mapping(readings, "update", "sensors to measurements")
        bound = step_evidence.readings(self.model, belief, given)
        step = belief.step
        slices = TableSlices(self._plan, step_evidence.at_step(bound, step), first=step)
        before = self._spread(belief, bound.lead)

        def taken(own: TableSlices, known: Held) -> tuple[Array, Array | None, Array | float]:
            """The belief `known` times the weights of the new measurements, which `own` has.

            Returns three: the entries of this product, (*slice, *runs), not normalised; the product
            of all weights of the step so far, None if there are none; and the log-scale of the new
            weights.
            """
            weights, scale = own.likelihood(step)
            if weights is None:
                return known.entries, known.weights, 0.0
            joint = own.semiring.times(known.entries, weights)
            weights = np.broadcast_to(weights, joint.shape)
            if known.weights is not None:
                weights = own.semiring.times(known.weights, weights)
            return joint, weights, scale

        held, log_density = self._in_digits(slices, before._held, taken)
        log_evidence = before.log_evidence + log_density.reshape(bound.lead)
        log = belief._log if self.lag is None else belief._log.read(Copied(readings))
        return OnlineStates(self, step, FILTERED, held, log_evidence, before._trail, log)

    def log(self, belief: OnlineStates) -> Log | None:
        """The steps behind a belief of this filter; None without a lag."""
        self._check(belief)
        return None if self.lag is None else belief._log

    def measurement(
        self, belief: OnlineStates, variable: Variable, given: Mapping[Variable, Any]
    ) -> Table | GaussianMixture:
        """The belief of a sensor's measurement at the step of a predicted belief.

        `given` has the values of the sensor's observed parents, in rows or constant.
        """
        bound, alone = step_evidence.unread(self.model, belief, variable, given)
        step, before = belief.step, self._spread(belief, bound.lead)
        bound = step_evidence.at_step(bound, step)
        asked = variable.at(step) if alone else variable
        (reading,), known = bound.readings, before._held.numbers
        rows = np.argsort(reading.order)
        found = at_rows(self._plan, bound, reading, asked, rows, [known] * rows.size)
        if isinstance(found, Table):
            return Table._plain(discrete((variable,)), found.values)
        of = found.components
        return GaussianMixture._make(found.weights, Gaussian._make((variable,), of.mean, of.cov))

    def _in_digits(self, slices: TableSlices, known: Held, work: Any) -> tuple[Held, Array]:
        """A prediction or an update, in numbers, or in logarithms where numbers may lose a state.

        A state is lost if its probability underflows.

        slices: The slices with the transition into the step, or with its new measurements.
        known: The belief before the prediction or update.
        work: The prediction or update itself, a function of slices and a belief, both in one
            semiring. It returns the entries of the new belief, (*slice, *runs), not normalised; the
            weights of the step's measurements, or None; and the log-scale of the entries.

        Returns: The new belief, of sum one; and ln of the sum of its entries before they were
            normalised, their scale included, (*runs): of an update ln p of the new measurements.
        """
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
        """The belief and those of its past steps, with their runs broadcast to the axes `lead`."""
        if belief.lead == lead:
            return belief
        axes = len(self._plan.slice)

        def wide(values: Array | None) -> Array | None:
            """Values (*slice, [runs]) of the belief's runs, for all runs of `lead`, (*slice, runs).

            They are repeated as `belief.lead` broadcasts to `lead`. None stays None.
            """
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
        return OnlineStates(self, belief.step, belief.kind, held(belief._held), log_evidence, trail)

    def _check(self, belief: OnlineStates) -> None:
        """Raise `ModelError` for a belief of another filter, or a smoothed one of `lagged`."""
        mine = isinstance(belief, OnlineStates) and belief._plan.model is self.model
        if not mine or belief.kind.lag > 0 or belief._lag != self.lag:
            raise ModelError(
                f"{titled(belief)} is no belief to go on from with {self!r}: begin with its "
                "initial(), and go on from the newest belief; copy or pickle a filter and its "
                "beliefs together"
            )


def online_tables(
    model: DynamicBayesianNetwork, schedule: Any = None, lag: int | None = None
) -> TableSteps:
    """The filter of a network of tables, made by ``OnlineFilter(model, ...)``.

    Its lag, in steps, is `lag` or that of a schedule `FixedLag`; else it has none.
    """
    chosen = online_schedule(schedule, lag)
    return TableSteps(model, chosen.lag if isinstance(chosen, FixedLag) else None)
