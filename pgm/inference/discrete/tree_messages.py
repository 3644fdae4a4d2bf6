"""The messages of a tree by their definition, made on request."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pgm.evidence.discrete import BoundStates
from pgm.factors.axes import States, discrete
from pgm.inference.discrete.evidence import axes_left, one_hot, put_in
from pgm.inference.discrete.storage import Storage
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import LOG_SUM_PRODUCT, log_sum


class TreeMessages:
    """Messages of a graph without loops, each from the potential and the other messages.

    All are logarithms, with an axis for each variable that is not put in, and one of runs, or of
    length one.

    Parameters
    ----------
    storage : Storage
    evidence : BoundStates
    logs : ndarray
        (entries,): the logarithms of the potentials.
    """

    def __init__(self, storage: Storage, evidence: BoundStates, logs: Array) -> None:
        self.storage, self.evidence, self.logs = storage, evidence, logs
        self._messages: dict[tuple[int, int], Array] = {}

    def message(self, source: int, target: int) -> Array:
        """The message from one cluster to a neighbour; it and those it is made of are kept."""
        waiting = [] if (source, target) in self._messages else [(source, target)]
        while waiting:
            i, j = waiting[-1]
            inputs = [(k, i) for k in self.storage.graph.neighbours(i) if k != j]
            missing = [edge for edge in inputs if edge not in self._messages]
            waiting += missing
            if not missing:
                waiting.pop()
                self._messages[i, j] = self._sent(i, j, inputs)
        return self._messages[source, target]

    def sepset(self, i: int, j: int) -> States:
        """The variables that a message is over."""
        sepset = self.storage.graph.sepsets[min(i, j), max(i, j)]
        return axes_left(self.evidence, discrete(sepset))

    def _sent(self, i: int, j: int, inputs: Iterable[tuple[int, int]]) -> Array:
        scope = axes_left(self.evidence, self.storage.scopes[i])
        total = self._potential(i, scope)
        for edge in inputs:
            total = total + _with_axes(self.sepset(*edge), self._messages[edge], scope)
        sepset = self.sepset(i, j)
        return log_sum(total, tuple(k for k, v in enumerate(scope) if v not in sepset))

    def _potential(self, cluster: int, scope: States) -> Array:
        """A cluster's CPDs times the evidence: states in every cluster, weights in one."""
        known = put_in(self.evidence, self.storage.scopes[cluster])
        whole = self.storage.table(self.logs, cluster)
        logs = whole[tuple(known.get(v, slice(None)) for v in self.storage.scopes[cluster])]
        logs = logs[..., None]
        for variable in scope:
            state = self.evidence.states.get(variable)
            if state is not None:
                shown = one_hot(np.reshape(state, -1), variable.size)
                logs = logs + _with_axes((variable,), LOG_SUM_PRODUCT.entries(shown), scope)
        for variable, weights in self.evidence.weights.items():
            if self.storage.homes[variable] == cluster:
                logs = logs + _with_axes((variable,), LOG_SUM_PRODUCT.entries(weights.T), scope)
        return logs


def _with_axes(own: States, logs: Array, scope: States) -> Array:
    """Logarithms with an axis for each variable of a wider scope; both in the network's order."""
    return logs.reshape((*(v.size if v in own else 1 for v in scope), -1))
