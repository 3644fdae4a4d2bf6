"""The first question of a graph without loops: one set of evidence, answered without a plan.

A plan serves many sets of evidence, and making it takes as long as a dozen of them. The first one
does without: each cluster's table is made when it is needed, from its CPDs and the messages to it.
A graph that is asked again is worth a plan.

Variables are denoted by numbers, their places in the network. One that is observed keeps an axis of
length one. All tables have their axes in one order, in which a cluster's *own* variables, those
that it does not share with its parent, stand first. A table is thus a matrix (own, shared): the
message to the root is the sum of its rows, and the message back multiplies each row by one vector.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import cast

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.cpds import TableCPD
from pgm.evidence.static import BoundStates
from pgm.kernels.arrays import Array
from pgm.variables import Discrete

# A table of at least so many entries is summed over one axis after the other: summed over several
# axes at once, its inner loops are as short as its last axes.
LONG = 2**8
# In a network of at most `FEW` variables, whose joint has at most `TINY` entries, one cluster holds
# them all.
FEW, TINY = 16, 2**7


@dataclass(frozen=True, eq=False)
class Answer:
    """The marginals and log-evidence of one run: the answer to a graph's first question.

    marginals: Of each variable that is not observed, its probabilities, (states,).
    log_evidence: ln p(evidence).
    """

    marginals: Mapping[Discrete, Array]
    log_evidence: float


# The variables of a table, in the order of its axes, and its values.
Factor = tuple[Sequence[int], Array]


def answer(graph: ClusterGraph, evidence: BoundStates) -> Answer | None:
    """The marginals and ln p(evidence) of one run, computed in plain numbers.

    graph: Without loops.
    evidence: Without axes of runs.

    Returns: None where a number underflows, or the evidence has probability zero.
    """
    try:
        return _answer(graph, evidence)
    except FloatingPointError:
        return None


@np.errstate(all="raise")
def _answer(graph: ClusterGraph, evidence: BoundStates) -> Answer:
    """The beliefs of one run; underflow and impossible evidence raise `FloatingPointError`."""
    return _Tree(graph, evidence).answer()


class _Tree:
    """The two passes of messages over the trees of a graph, for one set of evidence.

    order: The clusters, parents before children.
    parent: Of each cluster; −1 of a root.
    scopes: Of each cluster, its variables in the order of the axes of its table.
    shared: Of each cluster, the last ones of its scope, which its parent has too.
    rank: Of each variable, a number below zero; axes stand in the order of rank.
    shown: The state of each observed variable.
    sizes: Of each variable, its number of states; 1 if it is observed.
    factors: Of each cluster, what its table is the product of: CPDs, soft evidence, and messages
        from its children as they come.
    columns: Of each cluster, its message to the parent, (entries of shared variables,).
    """

    def __init__(self, graph: ClusterGraph, evidence: BoundStates) -> None:
        network, places = graph.network, graph.network._places
        self.variables = cast(Sequence[Discrete], network.variables)
        self.shown = {places[v]: cast(int, state) for v, state in evidence.states.items()}
        self.sizes = [len(variable.states) for variable in self.variables]
        for place in self.shown:
            self.sizes[place] = 1
        if len(self.sizes) <= FEW and math.prod(self.sizes) <= TINY:
            everything = range(len(self.sizes))
            assigned: Sequence[Sequence[int]] = [everything]
            self._hang([()], [everything])
        else:
            assigned = graph._assigned
            self._hang(graph._neighbours, graph._members)
        cpds = cast(Sequence[TableCPD], network.cpds)
        self.factors = [
            [self._of_cpd(network._families[k], cpds[k].table) for k in numbers]
            for numbers in assigned
        ]
        if evidence.weights:
            # A variable goes where its own CPD does: into a cluster that has it.
            homes = {number: k for k, numbers in enumerate(assigned) for number in numbers}
            for variable, weights in evidence.weights.items():
                place = places[variable]
                self.factors[homes[place]].append(self._of_weights(place, weights[0]))

    def _hang(self, joined: Sequence[Sequence[int]], members: Sequence[Sequence[int]]) -> None:
        """Root each tree at its cluster of least number, and rank variables, the deepest first.

        `joined` are the neighbours of each cluster, by number, `members` its variables. Sets
        `order`, `parent`, `scopes`, `shared` and `rank`.
        """
        self.order = list[int]()
        self.parent = parent = [UNSEEN] * len(joined)
        self.scopes, self.shared = [list[int]()] * len(joined), [list[int]()] * len(joined)
        self.rank = rank = [0] * len(self.sizes)
        found = 0
        for root in range(len(joined)):
            if parent[root] != UNSEEN:
                continue
            parent[root] = -1
            waiting = [root]
            while waiting:
                k = waiting.pop()
                self.order.append(k)
                before = found
                # Parents before children, as in most tables, which then stay as they are.
                for place in reversed(members[k]):
                    if not rank[place]:
                        found -= 1
                        rank[place] = found
                self.scopes[k] = scope = sorted(members[k], key=rank.__getitem__)
                self.shared[k] = scope[before - found :]
                for other in joined[k]:
                    if other != parent[k]:
                        parent[other] = k
                        waiting.append(other)

    def _of_cpd(self, family: Sequence[int], table: Array) -> Factor:
        """A CPD as a factor, with its observed variables at their states, on axes of length one.

        `family` is the child, then the parents; the table has the parents' axes in that order, then
        the child's.
        """
        given = [*family[1:], family[0]]
        if not self.shown.keys().isdisjoint(given):
            state = self.shown.get
            index = [ALL if (s := state(place)) is None else slice(s, s + 1) for place in given]
            table = table[tuple(index)]
        scope = sorted(given, key=self.rank.__getitem__)
        if scope != given:
            table = table.transpose([given.index(place) for place in scope])
        return scope, table

    def _of_weights(self, place: int, weights: Array) -> Factor:
        """The soft evidence of variable `place`, its weights (states,), as a factor.

        If the variable is observed too, the factor has the weight of its state alone.
        """
        state = self.shown.get(place)
        return [place], weights if state is None else weights[state : state + 1]

    def answer(self) -> Answer:
        """Send the messages to the roots and back, and read marginals and ln p(evidence).

        Raises
        ------
        FloatingPointError
            If a number underflows, or the evidence has probability zero.
        """
        sizes = self.sizes
        shapes = [[sizes[place] for place in shared] for shared in self.shared]
        ends = list(accumulate(map(math.prod, shapes), initial=0))
        messages = np.zeros(ends[-1])
        self.columns = [messages[start:stop] for start, stop in pairwise(ends)]
        tables, log_evidence = self._collect(shapes)
        # 0/0 becomes 0, for the dividend is zero too.
        np.putmask(messages, messages == 0.0, 1.0)
        return Answer(self._distribute(tables), log_evidence)

    def _collect(self, shapes: Sequence[Sequence[int]]) -> tuple[list[Array], float]:
        """Send the messages to the roots; returns the clusters' tables, and ln p(evidence).

        The table of a cluster is the product of its factors, the messages from its children among
        them, as a matrix (entries of own variables, entries of shared ones). The sum of its rows,
        the message to the parent, is written to `columns`; ``shapes[k]`` are the sizes of the
        shared variables of cluster k, the message's axes where it is a factor. A root's table keeps
        an axis for each variable and is divided by its sum.
        """
        tables: list[Array] = [NOTHING] * len(self.order)
        log_evidence = 0.0
        for k in reversed(self.order):
            table = self._product(self.scopes[k], self.factors[k])
            if self.parent[k] < 0:
                total = float(np.add.reduce(table, None))
                log_evidence += math.log(total) if total else -math.inf
                tables[k] = np.divide(table, total)
                continue
            message = self.columns[k]
            tables[k] = matrix = table.reshape(-1, len(message))
            np.add.reduce(matrix, 0, out=message)
            self.factors[self.parent[k]].append((self.shared[k], message.reshape(shapes[k])))
        return tables, log_evidence

    def _product(self, scope: Sequence[int], factors: Iterable[Factor]) -> Array:
        """The product of some factors, with an axis for each variable of a scope, in its order.

        Each factor is over some of these variables, in the same order. The product may be a view.
        """
        sizes = self.sizes
        table: Array | None = None
        for own, values in factors:
            if len(own) < len(scope):
                values = values.reshape([sizes[place] if place in own else 1 for place in scope])
            table = values if table is None else np.multiply(table, values)
        full = tuple([sizes[place] for place in scope])
        if table is None or table.shape != full:
            return np.broadcast_to(1.0 if table is None else table, full)
        return table

    def _distribute(self, tables: list[Array]) -> dict[Discrete, Array]:
        """Send the messages back from the roots; returns the marginals of variables not observed.

        `tables` are those that `_collect` returns. From the roots down, each is replaced by its
        product with the parent's joint of the shared variables over the message that went up, and
        so becomes the joint of its variables given the evidence. Each marginal is summed from the
        smallest table, of a cluster or of shared variables, that has the variable.
        """
        sizes = self.sizes
        homes: list[Factor] = [((), NOTHING)] * len(sizes)
        least = [math.inf] * len(sizes)

        def offer(scope: Sequence[int], table: Array) -> None:
            size = table.size
            for place in scope:
                if size < least[place]:
                    least[place], homes[place] = size, (scope, table)

        for k in self.order:
            scope, parent = self.scopes[k], self.parent[k]
            table = tables[k]
            if parent >= 0:
                sepset = _to(self.shared[k], self.scopes[parent], tables[parent])
                offer(self.shared[k], sepset)
                ratio = np.divide(sepset.reshape(-1), self.columns[k])
                table = np.multiply(table, ratio).reshape([sizes[place] for place in scope])
                tables[k] = table
            offer(scope, table)
        hidden = [place for place in range(len(sizes)) if place not in self.shown]
        return self._normalised(hidden, [_to((place,), *homes[place]) for place in hidden])

    def _normalised(self, hidden: Sequence[int], sums: Sequence[Array]) -> dict[Discrete, Array]:
        """The marginals of hidden variables: `sums`, (states,) of each, divided by their totals."""
        if not hidden:
            return {}
        widths = [self.sizes[place] for place in hidden]
        ends = list(accumulate(widths, initial=0))
        flat = np.concatenate(sums)
        # They sum to one but for rounding, which grows with the depth of a tree.
        flat /= np.add.reduceat(flat, ends[:-1]).repeat(widths)
        flat.flags.writeable = False
        variables = [self.variables[place] for place in hidden]
        return {
            v: flat[start:stop] for v, (start, stop) in zip(variables, pairwise(ends), strict=True)
        }


UNSEEN = -2
ALL = slice(None)
NOTHING = np.empty(0)


def _to(wanted: Sequence[int], scope: Sequence[int], table: Array) -> Array:
    """A table over `scope` summed to the wanted variables, which keep the table's order."""
    if len(wanted) == len(scope):
        return table
    axes = [axis for axis, place in enumerate(scope) if place not in wanted]
    if table.size < LONG:
        total: Array = np.add.reduce(table, tuple(axes))
        return total
    for gone, axis in enumerate(axes):
        table = np.add.reduce(table, axis - gone)
    return table
