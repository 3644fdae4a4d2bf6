"""The most probable states of some variables of a discrete network, all others summed over.

Where the tables of the sums fit, that is one elimination for many runs; else a search by run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgm.beliefs.discrete.run import of_tree
from pgm.beliefs.discrete.run_pieces import pieces, tree_pieces
from pgm.clustergraph import ClusterGraph
from pgm.elimination.max_sum import MaxSumPlan, max_sum
from pgm.elimination.plan import Label
from pgm.evidence.static import BoundStates
from pgm.factors.axes import States
from pgm.inference.query.branch_and_bound import Problem, Search
from pgm.inference.query.elimination import tables
from pgm.inference.query.implied import has_intermediate, with_implied
from pgm.inference.query.plan import QueryPlan, scopes_of
from pgm.inference.query.requisite import Requisite
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import LOG_SUM_PRODUCT
from pgm.networks import MarkovNetwork
from pgm.progress import counted
from pgm.schedules import limits
from pgm.schedules.limits import Room


@dataclass(frozen=True, eq=False)
class MarginalMap:
    """The most probable states of some variables.

    states: (variables, runs), indices; arbitrary where the evidence is impossible.
    levels: (runs,): ln p(states, evidence).
    missing: (runs,): how much higher that of other states may be; zero where these are the best.
    """

    states: Integers
    levels: Array
    missing: Array


def marginal_map(
    graph: ClusterGraph, wanted: States, evidence: BoundStates, room: Room
) -> MarginalMap:
    """The most probable states of the variables wanted, given evidence.

    Those that are observed have the states that they were observed in.
    """
    network = graph._factorised
    states = np.zeros((len(wanted), evidence.runs), dtype=np.intp)
    missing = np.zeros(evidence.runs)
    question = _Question.of(network, wanted, evidence)
    if question.fits and not has_intermediate(network):
        first = 0
        for piece in pieces(evidence, limits.BATCH // max(question.plan.plan.cost, 1)):
            states[:, first : first + piece.runs] = question.answered(piece)
            first += piece.runs
    else:
        # A run by itself has more variables that are known, or whose states follow.
        each = tree_pieces(1, evidence, 1)
        for run, piece in enumerate(counted(each, "runs", evidence.runs)):
            alone = with_implied(network, piece)
            own = _Question.of(network, wanted, alone)
            states[:, [run]], missing[run] = own.searched(alone)
    return MarginalMap(states, _levels(graph, wanted, states, evidence, room), missing)


def _levels(
    graph: ClusterGraph, wanted: States, states: Integers, evidence: BoundStates, room: Room
) -> Array:
    """The values ln p(states, evidence), (runs,), of states of some variables, (variables, runs).

    Searches leave constants out; this is the log-evidence of the whole network.
    """
    chosen = dict(zip(wanted, states, strict=True))
    weights = {v: soft for v, soft in evidence.weights.items() if v not in chosen}
    known = BoundStates((evidence.runs,), {**evidence.states, **chosen}, weights)
    levels = of_tree(graph, known, room, allow=True).log_evidence
    for variable, soft in evidence.weights.items():
        if variable in chosen:
            runs = np.arange(evidence.runs) % len(soft)
            levels = levels + soft[runs, chosen[variable]]
    return levels


@dataclass(frozen=True, eq=False)
class _Question:
    """A plan of maxima over the variables wanted, of sums over the others.

    query: The tables that the plan multiplies; variables are places in its order.
    """

    wanted: States
    plan: MaxSumPlan
    query: QueryPlan

    @classmethod
    def of(cls, network: MarkovNetwork, wanted: States, evidence: BoundStates) -> _Question:
        """The plan for the variables wanted given some evidence."""
        requisite = Requisite.of(network, wanted, evidence)
        hidden, (weighted, scopes) = requisite.hidden, scopes_of(requisite)
        asked = {k for k, v in enumerate(hidden) if v in wanted}
        plan = max_sum(scopes, [v.size for v in hidden], asked)
        order = tuple(hidden[k] for k in plan.order)
        return cls(wanted, plan, QueryPlan(requisite, order, weighted, plan.plan))

    @property
    def fits(self) -> bool:
        """Whether tables from which all sums leave first are small enough."""
        return not self.plan.early and self.plan.plan.cost <= limits.LIMIT

    def answered(self, evidence: BoundStates) -> Integers:
        """The states wanted, (variables, runs), of some runs; sums leave first."""
        given, _ = tables(self.query, evidence, LOG_SUM_PRODUCT)
        return self._in_turn(self.plan.attained(given, evidence.runs), evidence)

    def searched(self, evidence: BoundStates) -> tuple[Integers, float]:
        """The states wanted, (variables, 1), of one run, and how much higher others may be."""
        given, _ = tables(self.query, evidence, LOG_SUM_PRODUCT)
        plan = self.plan.plan
        logs = [given(k)[..., 0] for k in range(len(plan.scopes))]
        best = Search(Problem(plan.scopes, logs, plan.sizes, self.plan.maximised)).found()
        if best is None:
            return self._in_turn({}, evidence), 0.0  # the evidence is impossible
        states = {self.plan.order[x]: np.array([own]) for x, own in best.states.items()}
        return self._in_turn(states, evidence), best.bound - best.level

    def _in_turn(self, states: Mapping[Label, Integers], evidence: BoundStates) -> Integers:
        """The states wanted, of those that are hidden and those that the evidence has."""
        found = np.zeros((len(self.wanted), evidence.runs), dtype=np.intp)
        hidden = self.query.requisite.hidden
        chosen = {hidden[x]: own for x, own in states.items()}
        for own, variable in zip(found, self.wanted, strict=True):
            # One of a single state may be neither.
            own[:] = chosen.get(variable, evidence.states.get(variable, 0))
        return found
