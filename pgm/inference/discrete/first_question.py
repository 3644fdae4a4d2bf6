"""The first question of a graph without loops: one set of evidence, answered without a plan.

A *plan* lays all tables and messages out once, for many sets of evidence; making it takes as long
as a dozen inferences with it. For the first set of evidence none is made: each cluster's table is
multiplied when it is needed, from its CPDs and the messages to it. From the second on, a plan pays.

Variables are denoted by numbers, their places in the network. An observed variable keeps an axis of
length one. All tables have their axes in one order, in which a cluster's *own* variables, those
that it does not share with its parent, stand before the shared ones. A cluster's table is thus a
matrix, with a row for each joint state of its own variables and a column for each joint state of
the shared ones: the message to the parent is the sum of the rows, and the message back multiplies
each row by one vector.
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

    graph: A cluster graph without loops.
    evidence: The evidence of one run, without axes of runs.

    Returns: The answer; None if a number underflows, or the evidence has probability zero.
    """
    try:
        return _answer(graph, evidence)
    except FloatingPointError:
        return None


@np.errstate(all="raise")
def _answer(graph: ClusterGraph, evidence: BoundStates) -> Answer:
    """The marginals and ln p(evidence) of one run, computed in plain numbers.

    Underflow, and evidence of probability zero, raise `FloatingPointError`.
    """
    return _Tree(graph, evidence).answer()


class _Tree:
    """The two passes of messages over the trees of a graph, for one set of evidence.

    In a tiny network one cluster, made for the purpose, holds all variables.

    variables: The variables of the network; elsewhere each is denoted by its index here.
    order: The numbers of the clusters, parents before children.
    parent: Of each cluster, the number of its parent; −1 for a root.
    scopes: Of each cluster, its variables in the order of the axes of its table.
    shared: Of each cluster, the variables that its parent has too, which stand last in its scope.
    rank: Of each variable, a number below zero; the axes of all tables stand in ascending rank.
    shown: The state of each observed variable.
    sizes: Of each variable, its number of states; 1 if it is observed.
    factors: Of each cluster, the factors whose product is its table: its CPDs, its soft evidence,
        and the messages from its children, appended when they are computed. A factor is a pair: its
        variables in the order of its axes, and its values.
    columns: Of each cluster, its message to the parent, (joint states of the shared variables,).
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
        """Root each tree at its cluster of least number, and rank the variables.

        The variables that a cluster does not share with its parent rank before all variables of the
        clusters above it. `joined` has the neighbours of each cluster, by number, `members` its
        variables. The attributes `order`, `parent`, `scopes`, `shared` and `rank` are set.
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
        """A CPD as a factor, each observed variable at its state, on an axis of length one.

        `family` are the numbers of the child, then of the parents; `table` has the parents' axes in
        that order, then the child's. The axes of the factor stand in ascending rank.
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
        """The soft evidence of the variable numbered `place`, weights (states,), as a factor.

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

        The tables are listed by the clusters' numbers. Each is the product of the cluster's
        factors, the messages from its children among them, as a matrix (joint states of own
        variables, joint states of shared ones). The sum of the matrix's rows is the message to the
        parent. It is written to `columns`, and is appended to the parent's factors with an axis for
        each shared variable; ``shapes[k]`` are the sizes of these axes for cluster k. A root's
        table keeps an axis for each variable and is divided by its sum.
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

        Each factor is over some of the scope's variables, in the scope's order. The result may be a
        view of a factor's values, which must not be written to.
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

        `tables` are those that `_collect` returns. From the roots down, each table is multiplied by
        the ratio of the parent's joint of the shared variables to the message that was sent to the
        parent. The product, which replaces it, is the joint of the cluster's variables given the
        evidence. Each marginal, (states,), is summed from the smallest table, of a cluster or of
        shared variables, that has the variable.
        """
        sizes = self.sizes
        homes: list[Factor] = [((), NOTHING)] * len(sizes)
        least = [math.inf] * len(sizes)

        def offer(scope: Sequence[int], table: Array) -> None:
            """Keep a joint table for those variables of its scope that have none as small yet.

            The marginal of a variable is summed at the end from the table that is kept for it.
            """
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
        """The marginals of hidden variables, (states,) each, by the variables.

        `hidden` are the variables' numbers. `sums` has for each of them an array (states,), its
        marginal but for rounding, which is divided by its total.
        """
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
    """A table over `scope` summed over all but the wanted variables.

    The axes of the wanted variables keep the order that they have in `scope`.
    """
    if len(wanted) == len(scope):
        return table
    axes = [axis for axis, place in enumerate(scope) if place not in wanted]
    if table.size < LONG:
        total: Array = np.add.reduce(table, tuple(axes))
        return total
    for gone, axis in enumerate(axes):
        table = np.add.reduce(table, axis - gone)
    return table
