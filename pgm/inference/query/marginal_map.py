"""The most probable states of some variables of a discrete network, all others summed over.

Where the tables of the sums fit, that is one elimination for many runs; else a search by run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgm.beliefs.discrete.run_pieces import pieces, tree_pieces
from pgm.elimination.max_sum import MaxSumPlan, max_sum
from pgm.elimination.plan import Label
from pgm.evidence.static import BoundStates
from pgm.factors.axes import States
from pgm.inference.query.branch_and_bound import Problem, Search
from pgm.inference.query.elimination import tables
from pgm.inference.query.plan import QueryPlan, scopes_of
from pgm.inference.query.requisite import Requisite
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import LOG_SUM_PRODUCT
from pgm.networks import MarkovNetwork
from pgm.progress import counted
from pgm.schedules import limits


@dataclass(frozen=True, eq=False)
class MarginalMap:
    """The most probable states of some variables.

    states: (variables, runs), indices.
    missing: (runs,): how much higher ln p of other states may be; zero where these are the best.
    """

    states: Integers
    missing: Array


def marginal_map(network: MarkovNetwork, wanted: States, evidence: BoundStates) -> MarginalMap:
    """The most probable states of the variables wanted, given evidence that is possible."""
    found = MarginalMap(
        np.zeros((len(wanted), evidence.runs), dtype=np.intp), np.zeros(evidence.runs)
    )
    question = _Question.of(network, wanted, evidence)
    if question.plan.early or question.plan.plan.cost > limits.LIMIT:
        # A run by itself has more variables that are known.
        each = tree_pieces(1, evidence, 1)
        for run, piece in enumerate(counted(each, "runs", evidence.runs)):
            alone = _Question.of(network, wanted, piece)
            found.states[:, [run]], found.missing[run] = alone.searched(piece)
        return found
    first = 0
    for piece in pieces(evidence, limits.BATCH // max(question.plan.plan.cost, 1)):
        here = slice(first, first + piece.runs)
        found.states[:, here] = question.answered(piece)
        first += piece.runs
    return found


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
