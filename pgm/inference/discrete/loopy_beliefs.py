"""The beliefs of a graph of any shape after messages went round."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.evidence.discrete import BoundStates
from pgm.factors import Table
from pgm.factors.axes import States
from pgm.inference.discrete.beliefs import Beliefs
from pgm.inference.discrete.evidence import axes_left, put_in
from pgm.inference.discrete.joints import joint
from pgm.inference.discrete.loopy_messages import TableMessages
from pgm.inference.discrete.storage import Storage
from pgm.inference.forest import Forest
from pgm.kernels.arrays import Array
from pgm.variables import Discrete


@dataclass(frozen=True, eq=False)
class LoopyBeliefs(Beliefs):
    """The beliefs that messages make.

    Attributes
    ----------
    messages : TableMessages
    storage : Storage
    evidence : BoundStates
    """

    messages: TableMessages
    storage: Storage
    evidence: BoundStates
    _tables: Array
    _totals: Array

    @classmethod
    def of(cls, messages: TableMessages) -> LoopyBeliefs:
        """Multiply the messages into the potentials.

        Raises
        ------
        EvidenceError
            If the evidence has probability zero.
        """
        tables, totals = messages.beliefs()
        if messages.runs == 1:
            tables = tables[:, 0]
        return cls(messages, messages.storage, messages.evidence, tables, totals)

    @cached_property
    def _marginals(self) -> Array:
        return self.storage.marginals.read(self._tables)

    def marginal(self, variable: Discrete) -> Array:
        """The probabilities of a variable, (states, [runs])."""
        return self._marginals[self.storage.marginals.where[variable]]

    def read(self, reader: Callable[[Array], Array]) -> Array:
        """What a function makes of the tables, whose last axis, if any, is of runs."""
        return reader(self._tables)

    def joint(self, scope: States) -> Array:
        """The probabilities of variables that no one cluster of a tree holds."""
        forest = Forest.of(self.storage.graph)
        return joint(self.storage, forest, self._tables, scope)

    @cached_property
    def _log_evidence(self) -> Array:
        return self.messages.log_evidence(self._totals)

    def log_evidence(self) -> Array:
        """The Bethe value, (runs,)."""
        return self._log_evidence

    def log_total(self, cluster: int) -> Array:
        """The logarithm of the sum of a cluster's unnormalised belief, (runs,)."""
        total: Array = self._totals[cluster]
        return total

    def message(self, source: int, target: int) -> Table:
        """The message from one cluster to a neighbour, which sums to one."""
        edge = min(source, target), max(source, target)
        graph = self.storage.graph
        number = 2 * list(graph.sepsets).index(edge) + (source > target)
        plan = self.messages.plan
        scope = plan.sepsets[number]
        first = plan.first[number]
        logs = self.messages.logs[first : first + plan.widths[number]]
        with np.errstate(under="ignore"):
            whole: Array = np.exp(logs).reshape((*(v.size for v in scope), -1))
        known = put_in(self.evidence, scope)
        values = whole[tuple(known.get(v, slice(None)) for v in scope)]
        return self.table(axes_left(self.evidence, scope), values)
