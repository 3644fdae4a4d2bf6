"""The first question of a graph without loops: one set of evidence, answered without a plan.

A *plan* lays all tables and messages out once, for many sets of evidence; making it takes as long
as a dozen inferences with it. For the first set of evidence none is made: each cluster's table is
multiplied when it is needed, from its CPDs and the messages to it. From the second on, a plan pays.

The clusters themselves are a plan of elimination, which is carried out at once: each is a step that
multiplies its factors, and leaves to its parent the variables that it shares with it. Variables are
denoted by numbers, their places in the network. An observed variable keeps an axis of length one.
All tables have their axes in one order, in which a cluster's *own* variables, those that it does
not share with its parent, stand before the shared ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import cast

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.cpds import TableCPD
from pgm.elimination import Calibrated, Plan, Scope, Step, TableAlgebra
from pgm.evidence.static import BoundStates, scaled
from pgm.factors import Table
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import SUM_PRODUCT
from pgm.variables import Discrete

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
    question = _Question(graph, evidence)
    algebra = TableAlgebra(SUM_PRODUCT, question.sizes, aligned=0)
    calibrated = Calibrated(question.plan, question.factors, algebra)
    log_evidence = question.log_scale
    for root in question.plan.roots:
        total = calibrated.totals[root]
        log_evidence += math.log(total) if total else -math.inf
    return Answer(_marginals(question, calibrated, algebra), log_evidence)


class _Question:
    """A graph's clusters as a plan of elimination, and the tables that evidence makes of its CPDs.

    In a tiny network one cluster, made for the purpose, holds all variables.

    variables: The variables of the network; elsewhere each is denoted by its index here.
    rank: Of each variable, a number below zero; the axes of all tables stand in ascending rank.
    shown: Of each observed variable its state, as a slice of length one.
    sizes: Of each variable, its number of states; 1 if it is observed.
    factors: The tables of the CPDs, and the soft evidence of variables that have it, divided by its
        largest weight.
    log_scale: The sum of the logarithms of these largest weights.
    plan: The steps, one a cluster, children before parents; what a step leaves is the sepset of its
        cluster and the parent.
    """

    def __init__(self, graph: ClusterGraph, evidence: BoundStates) -> None:
        network, places = graph._factorised, graph._factorised._places
        self.variables = cast(Sequence[Discrete], network.variables)
        states = cast(Mapping[Discrete, int], evidence.states)
        self.shown = {places[v]: slice(state, state + 1) for v, state in states.items()}
        self.sizes = [len(variable.states) for variable in self.variables]
        for place in self.shown:
            self.sizes[place] = 1
        if len(self.sizes) <= FEW and math.prod(self.sizes) <= TINY:
            everything = range(len(self.sizes))
            assigned: Sequence[Sequence[int]] = [range(len(network.factors))]
            joined: Sequence[Sequence[int]] = [()]
            members: Sequence[Sequence[int]] = [everything]
        else:
            assigned, joined, members = graph._assigned, graph._neighbours, graph._members
        self._hang(joined, members)
        self.factors: list[Array] = []
        scopes: list[Scope] = []
        # Of each cluster, the numbers and the scopes of its factors.
        entering = [list[int]() for _ in members]
        over = [list[Scope]() for _ in members]
        tables = cast(Sequence[Table | TableCPD], network.factors)
        for numbers, factors, own in zip(assigned, entering, over, strict=True):
            for number in numbers:
                scope = self._add_factor(network._families[number], tables[number])
                factors.append(len(scopes))
                own.append(scope)
                scopes.append(scope)
        self.log_scale = 0.0
        if evidence.weights:
            homes = {place: k for k, held in enumerate(members) for place in held}
            for variable, weights in evidence.weights.items():
                place = places[variable]
                entering[homes[place]].append(len(scopes))
                over[homes[place]].append((place,))
                scopes.append((place,))
                below, top = scaled(weights[0])
                self._add_weights(place, SUM_PRODUCT.of_logs(below))
                self.log_scale += float(top)
        self.plan = Plan(scopes, self.sizes, self._steps(entering, over, len(scopes)), ())

    def _hang(self, joined: Sequence[Sequence[int]], members: Sequence[Sequence[int]]) -> None:
        """Root each tree at its cluster of least number, and rank the variables.

        The variables that a cluster does not share with its parent rank before all variables of the
        clusters above it. `joined` has the neighbours of each cluster, by number, `members` its
        variables. Of each cluster that sets `hung`: its number, its parent, −1 of a root, its
        variables in ascending rank, and those that the parent has too, which stand last among them.
        The clusters are in turn, parents before children.
        """
        self.hung: list[tuple[int, int, Scope, Scope]] = []
        parent = [UNSEEN] * len(joined)
        self.rank = rank = [0] * len(self.sizes)
        found = 0
        for root in range(len(joined)):
            if parent[root] != UNSEEN:
                continue
            parent[root] = -1
            waiting = [root]
            while waiting:
                k = waiting.pop()
                before = found
                # Parents before children, as in most tables, which then stay as they are.
                for place in reversed(members[k]):
                    if not rank[place]:
                        found -= 1
                        rank[place] = found
                scope = tuple(sorted(members[k], key=rank.__getitem__))
                self.hung.append((k, parent[k], scope, scope[before - found :]))
                for other in joined[k]:
                    if other != parent[k]:
                        parent[other] = k
                        waiting.append(other)

    def _steps(
        self, entering: Sequence[list[int]], over: Sequence[list[Scope]], first: int
    ) -> list[Step]:
        """The clusters as steps, children before parents.

        entering, over: Of each cluster, the numbers and scopes of its factors; what its children
            leave, numbered from `first` on, joins them.

        A variable that nothing which enters a cluster has is none of the step's: the product is
        alike in all its states. A cluster that nothing enters makes no step.
        """
        steps = list[Step]()
        for cluster, parent, scope, shared in reversed(self.hung):
            own, count = over[cluster], len(scope)
            if not own:
                continue
            if count not in map(len, own):
                known = set().union(*own)
                if len(known) < count:
                    scope = tuple([place for place in scope if place in known])
                    shared = tuple([place for place in shared if place in known])
            if parent >= 0:
                entering[parent].append(first + len(steps))
                over[parent].append(shared)
            steps.append(Step(tuple(entering[cluster]), tuple(own), scope, shared))
        return steps

    def _add_factor(self, family: Sequence[int], factor: Table | TableCPD) -> Scope:
        """Add a factor's table, each observed variable at its state; returns its scope.

        An observed variable keeps an axis of length one. `family` are the numbers of the factor's
        variables, of a CPD the child first, whose axis is the last one. The axes of the table that
        is added stand in ascending rank.
        """
        if isinstance(factor, TableCPD):
            given, table = [*family[1:], family[0]], factor.table
        else:
            given, table = list(family), factor._potential.entries(SUM_PRODUCT)
        shown = self.shown
        if not shown.keys().isdisjoint(given):
            table = table[tuple([shown.get(place, ALL) for place in given])]
        scope = sorted(given, key=self.rank.__getitem__)
        if scope != given:
            table = table.transpose([given.index(place) for place in scope])
        self.factors.append(table)
        return tuple(scope)

    def _add_weights(self, place: int, weights: Array) -> None:
        """Add a variable's soft evidence, weights (states,), to the factors.

        The variable is numbered `place`. If it is observed, too, the factor has the weight of its
        state alone.
        """
        self.factors.append(weights[self.shown.get(place, ALL)])


def _marginals(
    question: _Question, calibrated: Calibrated[Array], algebra: TableAlgebra
) -> dict[Discrete, Array]:
    """The marginals of the hidden variables, (states,) each, by the variables.

    Each is summed from the smallest table, of a cluster or of shared variables, that has the
    variable.
    """
    count = len(question.sizes)
    homes: list[tuple[Scope, Array]] = [((), NOTHING)] * count
    least = [math.inf] * count
    for step, joint, outside in calibrated.back():
        for scope, table in ((step.left, outside), (step.scope, joint)):
            if table is not None:
                size = table.size
                for place in scope:
                    if size < least[place]:
                        least[place], homes[place] = size, (scope, table)
    hidden = [place for place in range(count) if place not in question.shown]
    if not hidden:
        return {}
    sums = []
    for place in hidden:
        scope, table = homes[place]
        sums.append(algebra.total(table, scope, (place,)))
    widths = [question.sizes[place] for place in hidden]
    ends = list(accumulate(widths, initial=0))
    flat = np.concatenate(sums)
    # They sum to one but for rounding, which grows with the depth of a tree.
    flat /= np.add.reduceat(flat, ends[:-1]).repeat(widths)
    flat.flags.writeable = False
    variables = [question.variables[place] for place in hidden]
    return {v: flat[start:stop] for v, (start, stop) in zip(variables, pairwise(ends), strict=True)}


UNSEEN = -2
ALL = slice(None)
NOTHING = np.empty(0)
