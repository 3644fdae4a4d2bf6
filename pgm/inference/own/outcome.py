"""What a user's own family of beliefs keeps: its beliefs of all steps, and the marginals shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from pgm.compile import DynamicGraph
from pgm.display import Summary
from pgm.errors import EvidenceError
from pgm.factors.scope import Scope, as_scope, listed, namesake
from pgm.inference.belief_kind import FILTERED, PREDICTED, Kind
from pgm.inference.grid.belief import require_step
from pgm.inference.outcome import Outcome
from pgm.inference.own.marginals import OverTime, shown
from pgm.inference.posterior import require_variable
from pgm.inference.status import Status
from pgm.inference.summaries import over_time
from pgm.kernels.arrays import Array, Integers
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pgm.inference.belief_family import BeliefFamily


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

    def columns(self, scope: Scope) -> Integers:
        """The indices of a scope's components among the d of a point."""
        each = [np.arange(p.start, p.stop) for p in (self.places[v.template] for v in scope)]
        found: Integers = np.concatenate(each)
        return found


@dataclass(frozen=True, eq=False, repr=False)
class OwnOutcome(Outcome[Any]):
    """The beliefs of a user's own family over the steps of a chain.

    family: The user's value.
    known: The beliefs given the measurements up to each step, T + 1 of them.
    predicted: Those before the measurements of each step.
    smoothed: Those that know later measurements as well, by `kind`; None of a filter.
    """

    graph: DynamicGraph
    family: BeliefFamily[Any]
    kind: Kind
    log_evidence: Array
    status: Status
    _hidden_ones: Hidden
    _known: Sequence[Any]
    _predicted: Sequence[Any]
    _smoothed: Sequence[Any] | None = None

    moving: ClassVar[bool] = True
    called: ClassVar[str] = "chain"

    @property
    def beliefs(self) -> str:  # type: ignore[override]
        """The family's beliefs in the text of a refusal."""
        return self.family.beliefs

    @property
    def _hidden(self) -> Scope:
        return tuple(self._hidden_ones.places)

    @property
    def log_evidence_kind(self) -> str:
        """``own``: the sum of what the family's `take` returned."""
        return "own"

    def __getitem__(self, variable: Variable) -> Any:
        """The marginal of a hidden variable, at all steps or at one."""
        return self.joint(require_variable(variable))

    @property
    def filtered(self) -> OwnOutcome:
        """The beliefs of the forward pass; of a filter, the same."""
        if self._smoothed is None:
            return self
        return replace(self, kind=FILTERED, _smoothed=None)

    @property
    def predicted(self) -> OverTime:
        """Marginals given the measurements before each step."""
        return OverTime(replace(self, kind=PREDICTED, _smoothed=self._predicted))

    def joint(self, *variables: Variable) -> Any:
        """The joint of some hidden variables of one step, or of all steps."""
        if not variables:
            raise EvidenceError("joint takes variables of the network, like x.at(3), m.at(3)")
        scope = as_scope(variables, "a joint")
        for variable in scope:
            self._hidden_ones.require(variable)
        steps = {require_step(variable, self.graph.steps) for variable in scope}
        if len(steps) != 1:
            raise EvidenceError(
                f"{self.beliefs} have joints of variables of one step, not of {listed(scope)}",
                variable=scope[0],
            )
        (step,) = steps
        first = self._hidden_ones.first(scope)
        every = self._known if self._smoothed is None else self._smoothed
        if step is not None and step < first:
            raise EvidenceError(f"{scope[0]!r}: controls begin at step 1", step=step)
        some = every[first:] if step is None else [every[step]]
        at = None if step is not None else np.arange(first, len(every))
        columns = self._hidden_ones.columns(scope)
        lead, size = self.log_evidence.shape, self._hidden_ones.size
        return shown(self.family, some, scope, columns, lead, at, size)

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
