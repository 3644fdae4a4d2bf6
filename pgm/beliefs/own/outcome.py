"""Outcomes of a user's own family of beliefs: its beliefs of all steps, and the marginals shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from pgm.beliefs.own.marginals import Asked, shown, with_moments
from pgm.compile import DynamicGraph
from pgm.display import NoArray, Shown, Summary
from pgm.errors import EvidenceError
from pgm.factors.scope import Scope, as_scope, listed, namesake
from pgm.kernels.arrays import Array, Integers
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.belief_kind import Kind
from pgm.posteriors.hidden import require_step
from pgm.posteriors.outcome import Outcome
from pgm.posteriors.posterior import require_variable
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import ends, over_time
from pgm.variables import Variable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pgm.beliefs.own.family import BeliefFamily


class Hidden(NamedTuple):
    """The hidden variables of a network's slices, and their components among the d of a point.

    places: By state and hidden control, in the order of a slice.
    """

    model: DynamicBayesianNetwork
    places: Mapping[Variable, slice]

    @property
    def size(self) -> int:
        """The number of components of a slice, d."""
        return sum(variable.dimension for variable in self.places)

    def first(self, scope: Scope) -> int:
        """The first step at which all variables of a scope stand: 1 if one is a hidden control."""
        return int(any(v.template in self.model.controls for v in scope))

    def require(self, variable: Variable) -> Variable:
        """The same variable; one that is not hidden raises an EvidenceError."""
        variable = require_variable(variable)
        if variable.template not in self.places or variable.lag:
            raise EvidenceError(
                f"{variable!r} is no hidden variable of the network; those are "
                f"{listed(self.places)}{namesake(variable, tuple(self.places))}",
                variable=variable,
            )
        return variable

    def asked(self, scope: Scope, lead: tuple[int, ...], steps: Integers | None) -> Asked:
        """The question to beliefs, by the scope of a marginal, the axes of runs, and the steps."""
        each = [np.arange(p.start, p.stop) for p in (self.places[v.template] for v in scope)]
        return Asked(scope, np.concatenate(each), lead, steps, self.size)


@dataclass(frozen=True, eq=False, repr=False)
class OwnMarginals(Shown, NoArray):
    """The marginals of hidden variables over all steps, by variable, of a user's own family.

    Attributes
    ----------
    kind : Kind
        Which measurements they know: predicted, filtered, fixed-lag or smoothed.
    """

    kind: Kind
    # The family and its beliefs of all steps, T + 1 of them; the user's axes of runs.
    _family: BeliefFamily[Any]
    _hidden_ones: Hidden
    _each: Sequence[Any]
    _lead: tuple[int, ...]

    def __getitem__(self, variable: Variable) -> Any:
        """The marginal of a hidden variable, at all steps or at one."""
        return self._joint(require_variable(variable))

    def _joint(self, *variables: Variable) -> Any:
        """The joint of some hidden variables of one step, or of all steps."""
        return shown(self._family, *self._asked(variables))

    def _moments(self, variable: Variable) -> Any:
        """The marginal of a variable, in a form that has moments."""
        beliefs, asked = self._asked((variable,))
        return with_moments(self._family, shown(self._family, beliefs, asked), asked)

    def _asked(self, variables: Sequence[Variable]) -> tuple[Sequence[Any], Asked]:
        """The beliefs of the steps that are asked for, and what is asked of them."""
        if not variables:
            raise EvidenceError("joint takes variables of the network, like x.at(3), m.at(3)")
        hidden, last = self._hidden_ones, len(self._each) - 1
        scope = as_scope(variables, "a joint")
        for variable in scope:
            hidden.require(variable)
        steps = {require_step(variable, last) for variable in scope}
        if len(steps) != 1:
            raise EvidenceError(
                f"{self._family.beliefs} have joints of variables of one step, not of "
                f"{listed(scope)}",
                variable=scope[0],
            )
        (step,) = steps
        first = hidden.first(scope)
        if step is not None and step < first:
            raise EvidenceError(f"{scope[0]!r}: controls begin at step 1", step=step)
        some = self._each[first:] if step is None else [self._each[step]]
        at = None if step is not None else np.arange(first, last + 1)
        return some, hidden.asked(scope, self._lead, at)

    @property
    def _title(self) -> str:
        runs = f", runs {self._lead}" if self._lead else ""
        return f"Marginals({self.kind}, {self._family!r}, steps 0..{len(self._each) - 1}{runs})"

    def _summary(self) -> Summary:
        places, states = tuple(self._hidden_ones.places), self._hidden_ones.model.states
        return Summary(self._title, ends(self, places, states, self._lead, len(self._each) - 1))


@dataclass(frozen=True, eq=False, repr=False)
class OwnOutcome(Outcome[Any]):
    """The beliefs of a user's own family over the steps of a chain.

    family: The user's value.
    predicted: The marginals before the measurements of each step.
    """

    graph: DynamicGraph
    family: BeliefFamily[Any]
    log_evidence: Array
    status: Status
    predicted: OwnMarginals
    _marginals: OwnMarginals
    # The forward pass of a smoother; None of a filter, which is one.
    _forward: OwnOutcome | None = None

    moving: ClassVar[bool] = True
    called: ClassVar[str] = "chain"

    @property
    def kind(self) -> Kind:
        """Which measurements the beliefs know."""
        return self._marginals.kind

    @property
    def beliefs(self) -> str:  # type: ignore[override]
        """The family's beliefs in the text of a refusal."""
        return self.family.beliefs

    @property
    def _hidden(self) -> Scope:
        return tuple(self._marginals._hidden_ones.places)

    @property
    def log_evidence_kind(self) -> str:
        """``own``: the sum of what the family's `take` returned."""
        return "own"

    def __getitem__(self, variable: Variable) -> Any:
        """The marginal of a hidden variable, at all steps or at one."""
        return self._marginals[variable]

    def _moments(self, variable: Variable) -> Any:
        return self._marginals._moments(variable)

    @property
    def filtered(self) -> OwnOutcome:
        """The beliefs of the forward pass, with its status; of a filter, the same."""
        return self if self._forward is None else self._forward

    def joint(self, *variables: Variable) -> Any:
        """The joint of some hidden variables of one step, or of all steps."""
        return self._marginals._joint(*variables)

    @property
    def _title(self) -> str:
        runs = self.log_evidence.shape
        which = f", runs {runs}" if runs else ""
        return (
            f"Posterior({self.kind}, over {list(self._hidden)}, {self.family!r}, "
            f"{self.graph.steps + 1} steps{which})"
        )

    def _summary(self) -> Summary:
        return over_time(self._title, self, self._hidden, self.log_evidence.shape, self.graph.steps)
