"""The first question of a graph without loops: one run, answered before anything is laid out.

A plan serves many questions, and making it takes as long as a dozen of them. The first one does
without: each cluster's table is made where it is needed, of its CPDs and the messages to it, and
goes when the answer is there. A graph that is asked again is worth a plan.

Variables are numbers, their places in the network. One that is observed keeps an axis of one state.
All tables have their axes in one order, in which the variables that a cluster does not share with
its parent stand first: a message to the root is the sum of the rows of a matrix, and the message
back a factor of each of its rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.cpds import TableCPD
from pgm.evidence.discrete import BoundStates
from pgm.kernels.arrays import Array
from pgm.variables import Discrete

# Entries of a table, from which on it is summed over one axis after the other: over several at once
# the loops inside are as short as its last axes.
LONG = 2**8


@dataclass(frozen=True, eq=False)
class Answer:
    """The beliefs of one run.

    Attributes
    ----------
    marginals : mapping of Discrete to ndarray
        (states,): of the variables that are not observed.
    log_evidence : float
        ln p(evidence).
    """

    marginals: Mapping[Discrete, Array]
    log_evidence: float


class _Factor(NamedTuple):
    """A table: its variables, in the order of its axes, and its values."""

    scope: Sequence[int]
    values: Array


def answer(graph: ClusterGraph, evidence: BoundStates) -> Answer | None:
    """The beliefs of one run.

    Parameters
    ----------
    graph : ClusterGraph
        Without loops.
    evidence : BoundStates
        Without leading axes.

    Returns
    -------
    Answer or None
        None where a number is lost to underflow, or nothing is possible given the evidence.
    """
    try:
        with np.errstate(all="raise"):
            return _Tree(graph, evidence).answer()
    except FloatingPointError:
        return None


class _Tree:
    """The working place of `answer`.

    Attributes
    ----------
    order : list of int
        The clusters, parents before children.
    parent : list of int
        Of each cluster; −1 of a root.
    scopes, shared : list of (list of int)
        The variables of each cluster, and the last of them, which its parent has too.
    """

    def __init__(self, graph: ClusterGraph, evidence: BoundStates) -> None:
        network, places = graph.network, graph.network._places
        self.variables = cast(Sequence[Discrete], network.variables)
        self.shown = {places[v]: cast(int, state) for v, state in evidence.states.items()}
        self.sizes = [len(variable.states) for variable in self.variables]
        for place in self.shown:
            self.sizes[place] = 1
        self._hang(graph)
        cpds = cast(Sequence[TableCPD], network.cpds)
        self.factors = [
            [self._of_cpd(network._families[k], cpds[k].table) for k in numbers]
            for numbers in graph._assigned
        ]
        for variable, weights in evidence.weights.items():
            # A variable's own CPD stands where its family is: a cluster that has it.
            home = next(k for k, inside in enumerate(graph._assigned) if places[variable] in inside)
            self.factors[home].append(self._of_weights(places[variable], weights[0]))

    def _hang(self, graph: ClusterGraph) -> None:
        """Hang each tree at a cluster, and order the axes: those of clusters far down stand first."""
        joined, members = graph._neighbours, graph._members
        self.order, self.parent = list[int](), [-2] * len(joined)
        self.scopes, self.shared = [list[int]()] * len(joined), [list[int]()] * len(joined)
        self.rank = rank = [0] * len(self.sizes)
        found = 0
        for root in range(len(joined)):
            waiting = [root] if self.parent[root] == -2 else []
            while waiting:
                k = waiting.pop()
                self.order.append(k)
                before = found
                for place in members[k]:
                    if not rank[place]:
                        found -= 1
                        rank[place] = found
                self.scopes[k] = scope = sorted(members[k], key=rank.__getitem__)
                self.shared[k] = scope[before - found :]
                above = self.parent[k] if k != root else -1
                self.parent[k] = above
                for other in joined[k]:
                    if other != above:
                        self.parent[other] = k
                        waiting.append(other)

    def _of_cpd(self, family: Sequence[int], table: Array) -> _Factor:
        """A CPD, child first, given the states that are observed."""
        given = [*family[1:], family[0]]
        if self.shown:
            state = self.shown.get
            index = [ALL if (s := state(place)) is None else slice(s, s + 1) for place in given]
            table = table[tuple(index)]
        scope = sorted(given, key=self.rank.__getitem__)
        if scope != given:
            table = table.transpose([given.index(place) for place in scope])
        return _Factor(scope, table)

    def _of_weights(self, place: int, weights: Array) -> _Factor:
        state = self.shown.get(place)
        return _Factor([place], weights if state is None else weights[state : state + 1])

    def answer(self) -> Answer:
        """Send the messages to the roots and back.

        Raises
        ------
        FloatingPointError
            If a number is lost, or the evidence is impossible.
        """
        tables, messages, log_evidence = self._collect()
        return Answer(self._distribute(tables, messages), log_evidence)

    def _collect(self) -> tuple[list[Array], list[Array], float]:
        """The tables with the messages from below, the messages to parents, and ln p(evidence)."""
        sizes, log_evidence = self.sizes, 0.0
        tables, messages = [NOTHING] * len(self.order), [NOTHING] * len(self.order)
        for k in reversed(self.order):
            table = self._product(self.scopes[k], self.factors[k])
            if self.parent[k] < 0:
                total = float(np.add.reduce(table, None))
                log_evidence += math.log(total) if total else -math.inf
                tables[k] = np.divide(table, total)
                continue
            shared = self.shared[k]
            shape = [sizes[place] for place in shared]
            tables[k] = matrix = table.reshape(-1, math.prod(shape))
            messages[k] = message = np.add.reduce(matrix, 0)
            self.factors[self.parent[k]].append(_Factor(shared, message.reshape(shape)))
        return tables, messages, log_evidence

    def _product(self, scope: Sequence[int], factors: Iterable[_Factor]) -> Array:
        """The product of some factors, with an axis for each variable of a scope."""
        sizes = self.sizes
        table: Array | None = None
        for own, values in factors:
            if len(own) < len(scope):
                shape = [sizes[place] if place in own else 1 for place in scope]
                values = values.reshape(shape)
            table = values if table is None else np.multiply(table, values)
        full = tuple([sizes[place] for place in scope])
        if table is None or table.shape != full:
            return np.broadcast_to(1.0 if table is None else table, full)
        return table

    def _distribute(
        self, tables: list[Array], messages: Sequence[Array]
    ) -> dict[Discrete, Array]:
        """The marginals, each from the smallest table that has the variable."""
        sizes = self.sizes
        homes = [_Factor((), NOTHING)] * len(sizes)
        least = [math.inf] * len(sizes)
        for k in self.order:
            scope, parent = self.scopes[k], self.parent[k]
            found = [_Factor(scope, tables[k])]
            if parent >= 0:
                shared = self.shared[k]
                sepset = _to(shared, _Factor(self.scopes[parent], tables[parent]))
                ratio = sepset.ravel() / _divisor(messages[k])
                matrix = np.multiply(tables[k], ratio)
                tables[k] = table = matrix.reshape([sizes[place] for place in scope])
                found = [_Factor(shared, sepset), _Factor(scope, table)]
            for factor in found:
                size = factor.values.size
                for place in factor.scope:
                    if size < least[place]:
                        least[place], homes[place] = size, factor
        hidden = [place for place in range(len(sizes)) if place not in self.shown]
        return self._normalised(hidden, [_to((place,), homes[place]) for place in hidden])

    def _normalised(
        self, hidden: Sequence[int], sums: Sequence[Array]
    ) -> dict[Discrete, Array]:
        if not hidden:
            return {}
        widths = [self.sizes[place] for place in hidden]
        stops = np.cumsum(widths)
        flat = np.concatenate(sums)
        # They sum to one but for rounding, which grows with the depth of a tree.
        flat /= np.add.reduceat(flat, stops - widths).repeat(widths)
        flat.flags.writeable = False
        variables = [self.variables[place] for place in hidden]
        slices = zip(variables, widths, stops.tolist(), strict=True)
        return {variable: flat[stop - width : stop] for variable, width, stop in slices}


ALL = slice(None)
NOTHING = np.empty(0)


def _divisor(message: Array) -> Array:
    """A message with one for zero: 0/0 becomes 0, for the dividend is zero too."""
    return message if np.logical_and.reduce(message) else np.where(message, message, 1.0)


def _to(scope: Sequence[int], factor: _Factor) -> Array:
    """The sums of a table to some of its variables, in its order."""
    if len(scope) == len(factor.scope):
        return factor.values
    axes = [axis for axis, place in enumerate(factor.scope) if place not in scope]
    total = factor.values
    if total.size < LONG:
        return cast(Array, np.add.reduce(total, tuple(axes)))
    for gone, axis in enumerate(axes):
        total = np.add.reduce(total, axis - gone)
    return total
