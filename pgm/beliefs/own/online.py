"""Filtering with a user's own family of beliefs in a robot's loop, one step at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from pgm.beliefs.own.marginals import Asked, shown, with_moments
from pgm.beliefs.own.outcome import Hidden
from pgm.beliefs.own.run import OwnChain
from pgm.beliefs.own.status import status_of
from pgm.beliefs.points.filter import PointFilter
from pgm.beliefs.points.model import ParticleModel
from pgm.display import Summary
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.belief_kind import FILTERED, PREDICTED, Kind
from pgm.posteriors.online_belief import OnlineBelief
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import at_a_step
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.beliefs.own.family import BeliefFamily


@dataclass(frozen=True, eq=False, repr=False)
class OnlineOwnBelief(OnlineBelief):
    """The belief of an online filter at one step, of a user's own family.

    Attributes
    ----------
    step : int
        The number of the step.
    log_evidence : ndarray
        (*runs): ln p of all measurements so far, as the family's `take` tells it.
    status : Status
        The family's numbers at this step.
    kind : Kind
        Filtered after an update, predicted before.
    value : object
        The belief itself, as the family made it.
    """

    step: int
    log_evidence: Array
    status: Status
    kind: Kind
    value: Any
    _family: BeliefFamily[Any]
    _hidden: Hidden
    # How many updates of its step it knows.
    _updates: int = 0
    # A window of steps behind it, of which there is none.
    behind: ClassVar[None] = None

    def __post_init__(self) -> None:
        self.log_evidence.flags.writeable = False

    @property
    def beliefs(self) -> str:  # type: ignore[override]
        """The family's beliefs in the text of a refusal."""
        return self._family.beliefs

    @property
    def lead(self) -> tuple[int, ...]:
        """The shape of the axes of runs."""
        return self.log_evidence.shape

    def __getitem__(self, variable: Variable) -> Any:
        """The marginal of a hidden variable at the belief's step, its leading axes runs."""
        return shown(self._family, [self.value], self._asked(variable))

    def _moments(self, variable: Variable) -> Any:
        asked = self._asked(variable)
        return with_moments(self._family, shown(self._family, [self.value], asked), asked)

    def _asked(self, variable: Variable) -> Asked:
        """The question to the belief, by a hidden variable, which has to be of its step."""
        variable = self._hidden.require(variable)
        scope = (variable.template,)
        if variable.step not in (None, self.step) or scope[0] not in self._over:
            raise EvidenceError(
                f"the belief at step {self.step} is over {list(self._over)}, not {variable!r}",
                variable=variable,
                step=self.step,
            )
        return self._hidden.asked(scope, self.lead, None)

    @property
    def _over(self) -> Scope:
        """The hidden variables that stand at its step."""
        return tuple(v for v in self._hidden.places if self.step >= self._hidden.first((v,)))

    @property
    def _title(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        return f"OnlineBelief({self.kind}, step {self.step}, {self._family!r}{runs})"

    def _summary(self) -> Summary:
        return at_a_step(self._title, self, self._over, self.lead)


class OwnSteps(PointFilter[OnlineOwnBelief]):
    """The steps of an online filter with a user's own family of beliefs.

    Parameters
    ----------
    model : DynamicBayesianNetwork
    belief : BeliefFamily
    """

    def __init__(self, model: DynamicBayesianNetwork, belief: BeliefFamily[Any]) -> None:
        self._set(model=model, belief=belief)

    def initial(self) -> OnlineOwnBelief:
        """The prior belief, at step 0, with the model's leading axes of runs."""
        return self._initial(self.model.lead)

    def _initial(self, lead: tuple[int, ...]) -> OnlineOwnBelief:
        bound = BoundEvidence(0, lead, (), ())
        chain = self._chain(bound, 0)
        return self._belief(0, PREDICTED, chain.start(), chain, bound, np.zeros(bound.runs))

    def _predicted(self, belief: OnlineOwnBelief, bound: BoundEvidence) -> OnlineOwnBelief:
        """The belief one step later, by the inputs of that step."""
        belief = self._of_runs(belief, bound)
        chain, step = self._chain(bound, belief.step), belief.step + 1
        value = chain.predict(step, belief.value)
        return self._belief(step, PREDICTED, value, chain, bound, belief.log_evidence)

    def _updated(self, belief: OnlineOwnBelief, bound: BoundEvidence) -> OnlineOwnBelief:
        """The belief given the measurements of its step."""
        belief = self._of_runs(belief, bound)
        chain = self._chain(bound, belief.step, belief._updates)
        value, log_density = chain.take(belief.step, belief.value)
        total, updates = belief.log_evidence.reshape(-1) + log_density, belief._updates + 1
        return self._belief(belief.step, FILTERED, value, chain, bound, total, updates)

    def _of_runs(self, belief: OnlineOwnBelief, bound: BoundEvidence) -> OnlineOwnBelief:
        """The belief with the runs of the evidence: a prior is made anew, others have to fit."""
        if belief.lead == bound.lead:
            return belief
        if belief.step == 0 and belief.kind == PREDICTED:
            return self._initial(bound.lead)
        raise EvidenceError(
            f"evidence of runs {bound.lead} for a belief of runs {belief.lead}; give the first "
            f"evidence, or the prior's mean, all axes {bound.lead}",
            step=belief.step,
        )

    def _chain(self, bound: BoundEvidence, first: int, updates: int = 0) -> OwnChain:
        """The family along a chain whose inputs begin at step `first` + 1."""
        model = ParticleModel(self.model, bound, np.float64, first, weighed=False)
        return OwnChain(self.belief, model, updates)

    def _owns(self, belief: Any) -> bool:
        mine = isinstance(belief, OnlineOwnBelief) and belief._hidden.model is self.model
        return mine and belief._family is self.belief

    def _belief(
        self,
        step: int,
        kind: Kind,
        value: Any,
        chain: OwnChain,
        bound: BoundEvidence,
        log_evidence: Array,
        updates: int = 0,
    ) -> OnlineOwnBelief:
        """The user's belief at a step; `log_evidence` is of all measurements so far."""
        status = status_of(self.belief, [value], bound.lead)
        places: Mapping[Variable, slice] = dict(chain.model.places)
        total = np.array(log_evidence).reshape(bound.lead)
        hidden = Hidden(self.model, places)
        told = step, total, status, kind, value, self.belief, hidden
        return OnlineOwnBelief(*told, updates)
