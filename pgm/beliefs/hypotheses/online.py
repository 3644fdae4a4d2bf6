"""Filtering a chain of discrete and continuous variables in a robot's loop, one step at a time.

A belief is that of all pairs of a step (`chain.Pairs`): a Gaussian for each component of the step
before and each regime, so that several updates of a step may follow one another. They are merged
when the next step is predicted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from pgm.beliefs.hypotheses.chain import HypothesisChain
from pgm.beliefs.hypotheses.counts import leading
from pgm.beliefs.hypotheses.forward import chain_of
from pgm.beliefs.hypotheses.innovations import innovations
from pgm.beliefs.hypotheses.measurements import Members, flow_of, of_rows
from pgm.beliefs.hypotheses.outcome import Beliefs, Marginals
from pgm.beliefs.hypotheses.records import Asked, Pairs
from pgm.beliefs.hypotheses.run import associations_of
from pgm.boundary import as_mapping
from pgm.compile import SliceLayout
from pgm.display import InCode, Summary, titled
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence, Sightings
from pgm.factors import Gaussian, GaussianMixture, Table
from pgm.factors.axes import discrete
from pgm.factors.scope import Scope
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, components_last, quiet
from pgm.kernels.semirings import log_sum
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.associations import Found
from pgm.posteriors.belief_kind import FILTERED, PREDICTED, Kind
from pgm.posteriors.hidden import located
from pgm.posteriors.online_belief import OnlineBelief
from pgm.posteriors.predictions import require_parents
from pgm.posteriors.status import Status
from pgm.posteriors.step_innovations import NoGains, StepInnovations, StepInnovationsBySensor
from pgm.posteriors.summaries import at_a_step
from pgm.schedules import step_evidence
from pgm.schedules.online_schedule import online_schedule
from pgm.schedules.schedule import Filtering
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class OnlineMixture(OnlineBelief):
    """The belief of an online filter at one step, of discrete and continuous variables.

    Attributes
    ----------
    step : int
        The number of the step.
    log_evidence : ndarray
        (*runs): ln p of all measurements so far.
    status : Status
        How the last step went.
    kind : Kind
        Filtered after an update, predicted before.
    associations : mapping of Variable to Associations
        By sensor, of the last update's sightings that left open what was seen.
    """

    beliefs: ClassVar[str] = "mixtures of Gaussians"
    # A window of steps behind it, of which there is none.
    behind: ClassVar[None] = None

    step: int
    log_evidence: Array
    status: Status
    kind: Kind
    _marginals: Marginals
    _pairs: Pairs
    _steps: HypothesisSteps
    # The pairs before the last update, and its evidence, sensors by themselves among it.
    _update: tuple[Pairs, BoundEvidence, frozenset[Variable]] | None = None
    associations: Found = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.log_evidence.flags.writeable = False

    @property
    def lead(self) -> tuple[int, ...]:
        """The shape of the axes of runs."""
        return self.log_evidence.shape

    def __getitem__(self, variable: Variable) -> Any:
        """The marginal of a hidden variable at the belief's step, its leading axes runs."""
        return self.joint(variable)

    def joint(self, *variables: Variable) -> Any:
        """The joint of discrete variables, or of continuous ones, at the belief's step."""
        layout, places = self._marginals.layout, []
        for variable in variables:
            template, first = located(layout, variable, self.step)
            if self.step < first or variable.step not in (None, self.step):
                raise EvidenceError(
                    f"the belief at step {self.step} is over {list(self._over)}, not {variable!r}",
                    variable=variable,
                    step=self.step,
                )
            places.append(template)
        return self._marginals.of(tuple(places), tuple(places), 0, self.lead)

    @cached_property
    def innovations(self) -> StepInnovationsBySensor:
        """The innovations of the last update by sensor: of the mixture, found when asked for."""
        if self._update is None:
            return StepInnovationsBySensor({})
        return StepInnovationsBySensor(self._steps.innovations(self.step, *self._update))

    def _measurement(self, variable: Variable, given: Mapping[Variable, Any]) -> Any:
        if variable in self._marginals.layout.slice:
            return self[variable]
        require_parents(self._steps.model, variable, given, self.step)
        return self._steps.measurement(self, variable, given)

    @property
    def _over(self) -> Scope:
        """The hidden variables that stand at its step."""
        layout = self._marginals.layout
        return layout.slice if self.step else layout.states

    @property
    def _title(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        return f"OnlineBelief({self.kind}, step {self.step}{runs})"

    def _summary(self) -> Summary:
        return at_a_step(self._title, self, self._over, self.lead)


class HypothesisSteps(InCode, Immutable):
    """The steps of an online filter of discrete and continuous variables.

    Made by ``OnlineFilter(model)``. It is immutable, and so are its beliefs.

    Attributes
    ----------
    model : DynamicBayesianNetwork
    asked : Asked
        How many Gaussians are kept.
    """

    model: DynamicBayesianNetwork
    asked: Asked
    lineariser: Lineariser
    schedule: Any

    def __init__(
        self,
        model: DynamicBayesianNetwork,
        asked: Asked,
        lineariser: Lineariser = TAYLOR,
        schedule: Any = None,
    ) -> None:
        chosen = online_schedule(schedule, None)
        if chosen is not None and not isinstance(chosen, Filtering):
            raise ModelError(
                f"{schedule!r}: mixtures of Gaussians are filtered online, and smoothed by "
                "pgm.smooth(..., lag=...): give pgm.Filtering(...), or leave it out"
            )
        self._set(model=model, asked=asked, lineariser=lineariser, schedule=schedule)
        self._chain(BoundEvidence(0, model.lead, (), ()), 0)  # which refuses what cannot be

    @property
    def options(self) -> Mapping[str, Any]:
        """The options of `OnlineFilter` by which the same steps are made."""
        return {"lineariser": self.lineariser, "schedule": self.schedule}

    def __repr__(self) -> str:
        return f"OnlineFilter(over {list(self.model.states)})"

    def initial(self) -> OnlineMixture:
        """The prior, as the predicted belief at step 0."""
        return self._initial(self.model.lead)

    def _initial(self, lead: tuple[int, ...]) -> OnlineMixture:
        chain = self._chain(BoundEvidence(0, lead, (), ()), 0)
        pairs = chain.start()
        assert isinstance(pairs, Pairs)
        return self._belief(chain, 0, PREDICTED, pairs, np.zeros(chain.runs))

    def predict(
        self, belief: OnlineMixture, inputs: Mapping[Variable, Any] | None = None
    ) -> OnlineMixture:
        """The belief one step later, given the inputs of that step; as of `OnlineFilter`."""
        self._check(belief)
        given = as_mapping(inputs, "the inputs of predict")
        bound = step_evidence.inputs(self.model, belief, given)
        belief = self._of_runs(belief, bound.lead)
        chain = self._chain(bound, belief.step)
        pairs = chain.predict(1, chain.merged(0, belief._pairs))
        assert isinstance(pairs, Pairs)
        total = belief.log_evidence.reshape(-1)
        return self._belief(chain, belief.step + 1, PREDICTED, pairs, total)

    def update(self, belief: OnlineMixture, readings: Mapping[Variable, Any]) -> OnlineMixture:
        """The belief given measurements of its step; as of `OnlineFilter`."""
        self._check(belief)
        given = step_evidence.mapping(readings, "update", "sensors to measurements")
        bound = step_evidence.readings(self.model, belief, given, among=True)
        belief = self._of_runs(belief, bound.lead)
        chain = self._chain(bound, belief.step)
        pairs, density = chain.observe(0, belief._pairs)
        total = belief.log_evidence.reshape(-1) + density
        alone = frozenset(v for v, each in given.items() if not isinstance(each, Sightings))
        update = belief._pairs, bound, alone
        return self._belief(chain, belief.step, FILTERED, pairs, total, update)

    @quiet()
    def measurement(
        self, belief: OnlineMixture, variable: Variable, given: Mapping[Variable, Any]
    ) -> Table | GaussianMixture:
        """The belief of a sensor's measurement at the step of a predicted belief.

        `given` has the values of the sensor's observed parents, in rows or constant.
        """
        bound, alone = step_evidence.unread(self.model, belief, variable, given)
        belief = self._of_runs(belief, bound.lead)
        chain = self._chain(bound, belief.step)
        members, (reading,) = Members.of(chain, [flow_of(belief._pairs)]), bound.readings
        rows, asked = np.argsort(reading.order), variable.at(belief.step) if alone else variable
        layout = belief._marginals.layout
        found = of_rows(layout, chain.given, chain.regimes, members, asked, reading, rows)
        if isinstance(found, Table):
            return Table._plain(discrete((variable,)), found.values)
        of = found.components
        return GaussianMixture._make(found.weights, Gaussian._make((variable,), of.mean, of.cov))

    @quiet()
    def innovations(
        self, step: int, before: Pairs, bound: BoundEvidence, alone: frozenset[Variable]
    ) -> dict[Variable, StepInnovations]:
        """The innovations of an update by continuous sensor, at the pairs before it."""
        chain = self._chain(bound, step)
        members = Members.of(chain, [flow_of(before)])
        return {
            reading.cpd.child: StepInnovations(
                innovations(chain.given, chain.regimes, members, reading),
                NoGains(),
                alone=reading.cpd.child in alone,
            )
            for reading in bound.readings
            if not reading.cpd.discrete
        }

    def _chain(self, bound: BoundEvidence, first: int) -> HypothesisChain:
        """The forward pass of one step, whose evidence begins at step `first`."""
        schedule = online_schedule(self.schedule, None)
        filtering = schedule if isinstance(schedule, Filtering) else Filtering()
        return chain_of(self.model, bound, self.asked, self.lineariser, filtering, first=first)

    def _belief(
        self,
        chain: HypothesisChain,
        step: int,
        kind: Kind,
        pairs: Pairs,
        total: Array,
        update: tuple[Pairs, BoundEvidence, frozenset[Variable]] | None = None,
    ) -> OnlineMixture:
        """The belief of some pairs; `total` is ln p of all measurements so far, (runs,)."""
        lead = chain.given.bound.lead
        shares = leading(pairs.logs, pairs.counts, (0, 1))
        members = math.prod(shares.shape[:2])
        size, runs = chain.size, chain.runs
        beliefs = Beliefs.of(
            kind,
            chain.given.hidden,
            shares.reshape(1, members, runs),
            components_last(pairs.mean.reshape(size, members, runs), 1)[None],
            components_last(pairs.cov.reshape(size, size, members, runs), 2)[None],
            log_sum(shares, 0)[None],
        )
        marginals = Marginals(SliceLayout.of(self.model), beliefs, chain.regimes)
        residuals, converged = chain.settled()
        status = Status.of(residuals, converged, lead)
        found = associations_of(chain)
        return OnlineMixture(
            step,
            np.array(total).reshape(lead),
            status,
            kind,
            marginals,
            pairs,
            self,
            update,
            found,
        )

    def _of_runs(self, belief: OnlineMixture, lead: tuple[int, ...]) -> OnlineMixture:
        """The belief with the runs of the evidence; one of a single run becomes one of all."""
        if belief.lead == lead:
            return belief
        if belief.step == 0 and belief.kind == PREDICTED:
            return self._initial(lead)
        if belief.lead:
            raise EvidenceError(
                f"evidence of runs {lead} for a belief of runs {belief.lead}; give the first "
                f"evidence, or the prior's mean, all axes {lead}",
                step=belief.step,
            )
        wide = belief._pairs.repeated(math.prod(lead))
        total = np.broadcast_to(belief.log_evidence, lead).copy()
        return OnlineMixture(
            belief.step, total, belief.status, belief.kind, belief._marginals, wide, self
        )

    def _check(self, belief: Any) -> None:
        """Raise `ModelError` for a belief of another filter."""
        mine = isinstance(belief, OnlineMixture) and belief._marginals.layout.model is self.model
        if not mine:
            raise ModelError(
                f"{titled(belief)} is no belief to go on from with {self!r}: begin with its "
                "initial(); copy or pickle a filter and its beliefs together"
            )
