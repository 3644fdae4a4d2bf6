"""The messages of a tree of tables, computed from the potentials on request.

The message from cluster i to cluster j is μ_ij = Σ ψ_i Π_k μ_ki. Here ψ_i is the potential of i
times the evidence that enters i, the product is over the neighbours k of i except j, and the sum is
over the variables of i that j does not have.
"""

from collections.abc import Iterable

from pgm.beliefs.discrete.entered_evidence import enter_everywhere
from pgm.beliefs.discrete.storage import Storage, sepset_between
from pgm.evidence.static import BoundStates
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import log_sum


class TreeMessages:
    """The messages of a graph without loops, as logarithms, (sizes of the sepset..., runs).

    storage: Where each cluster's table stands in a flat array.
    potentials: (entries, runs): the logarithms of all ψ_i in that array.
    """

    def __init__(self, storage: Storage, evidence: BoundStates) -> None:
        self.storage = storage
        self.potentials = enter_everywhere(storage, evidence)
        self._messages: dict[tuple[int, int], Array] = {}

    def message(self, source: int, target: int) -> Array:
        """The message from one cluster to a neighbour, given by number, as logarithms.

        It is computed at the first call, with all messages that enter into it, and kept.
        """
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

    def _sent(self, i: int, j: int, inputs: Iterable[tuple[int, int]]) -> Array:
        """The logarithm of the message from cluster i to j, from the messages that enter into it.

        `inputs` are the (sender, receiver) of these messages, which are computed already: (k, i)
        for each neighbour k of i except j.
        """
        scope, graph = self.storage.scopes[i], self.storage.graph
        total = self.storage.table(self.potentials, i)
        for edge in inputs:
            # Sepsets and clusters both have the network's order.
            own = sepset_between(graph, *edge)
            sizes = (v.size if v in own else 1 for v in scope)
            total = total + self._messages[edge].reshape((*sizes, -1))
        kept = sepset_between(graph, i, j)
        return log_sum(total, tuple(k for k, v in enumerate(scope) if v not in kept))
