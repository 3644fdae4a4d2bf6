"""Whether the evidence that a query leaves out is possible.

A query leaves out the factors that evidence separates from the variables asked for. Summed over all
unknown variables, the product of these is a constant given the evidence. The posterior does
not depend on the constant unless it is zero: then the evidence is impossible.

The constant can be zero only where tables have zeros. So only those factors are examined whose
tables have a zero at the evidence. Of these, a CPD is dropped if its child has no evidence and is
in no other one examined: some state of the child is always possible. What remains falls into
*parts* that share no unknown variable, and the probability of the evidence of each part, up to a
factor, is found by elimination.

A variable is *known* if it has one state alone or is observed in all runs. A *family* is a factor
with those of its variables that are unknown.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pgm.beliefs.discrete.impossible import ADVICE
from pgm.beliefs.discrete.run_pieces import pieces
from pgm.cpds import TableCPD
from pgm.cpds.causal_independence import of_user
from pgm.evidence.static import BoundStates
from pgm.factors.axes import discrete, sizes
from pgm.factors.scope import in_run, names
from pgm.inference.query.elimination import eliminate, lost_runs, refusal
from pgm.inference.query.plan import QueryPlan
from pgm.inference.query.requisite import Factor, Family, Requisite, evidence_of
from pgm.kernels.arrays import Integers, Mask
from pgm.schedules import limits
from pgm.schedules.impossible import OF_RUNS, ImpossibleEvidence
from pgm.variables import Discrete


@dataclass(frozen=True, eq=False)
class Contradiction:
    """Evidence of probability zero in factors that a query leaves out.

    lost: The mask (runs,) of the runs with such evidence; it marks one at least.
    part: The plan of the elimination that found the probability zero; or a factor, with all
        variables known, which is zero at their states.
    """

    lost: Mask
    part: QueryPlan | Factor

    def error(self, evidence: BoundStates) -> ImpossibleEvidence:
        """The error that refuses the impossible evidence.

        `evidence` is the evidence of the whole network.
        """
        if isinstance(self.part, QueryPlan):
            return refusal(self.part, self.lost, evidence.lead)
        factor, lead = self.part, evidence.lead
        cpd = factor if isinstance(factor, TableCPD) else None
        observed = tuple(
            dict.fromkeys(of_user(v) for v in discrete(factor.scope) if v in evidence.states)
        )
        table = (
            f"the table of {of_user(cpd.child)!r}"
            if cpd
            else f"the factor over {names(factor.scope)}"
        )
        return ImpossibleEvidence(
            f"the evidence has probability zero{in_run(self.lost.reshape(lead))}: that for "
            f"{names(observed)} contradicts itself, for {table} is zero there. "
            f"{ADVICE}{OF_RUNS if lead else ''}",
            self.lost,
            lead,
            variable=of_user(cpd.child) if cpd else next(iter(factor.scope), None),
            cpd=cpd,
        )


def contradictions(left_out: Sequence[Family], evidence: BoundStates) -> list[Contradiction]:
    """The contradictions among the factors that a query leaves out: evidence of probability zero.

    There is one for each part, or factor with all variables known, whose evidence is impossible in
    some run. A part is not examined where elimination would need tables above the limit of memory.

    left_out: The factors that the query leaves out, each with its unknown variables.
    evidence: The evidence of the whole network.
    """
    constraints = [family for family in left_out if _has_zero(family, evidence)]
    if not constraints:
        return []
    found = []
    for factor, unknown in constraints:
        if not unknown:
            potential = factor._potential
            state = tuple(_state(v, evidence) for v in potential.axes)
            zero = np.atleast_1d(potential.values[state] == 0.0)
            found.append(Contradiction(np.broadcast_to(zero, evidence.runs), factor))
    for part in _parts(_restricting(constraints, evidence)):
        members = {v for factor, _ in part for v in factor.scope}
        if members.isdisjoint(evidence.states) and members.isdisjoint(evidence.weights):
            continue
        hidden = discrete(tuple(dict.fromkeys(v for _, unknown in part for v in unknown)))
        factors, scopes = zip(*part, strict=True)
        plan = QueryPlan.of(
            Requisite(factors, scopes, hidden, evidence_of(evidence, members)), hidden[-1:]
        )
        if plan.sums.peak > limits.LIMIT:
            continue
        some = pieces(plan.requisite.evidence, limits.BATCH // plan.sums.peak)
        lost = np.concatenate([lost_runs(eliminate(plan, piece)) for piece in some])
        found.append(Contradiction(np.broadcast_to(lost, evidence.runs), plan))
    return [each for each in found if each.lost.any()]


def _state(variable: Discrete, evidence: BoundStates) -> int | Integers:
    """The state of a known variable: a number for all runs, or an array of states (runs or 1,)."""
    return 0 if variable.size == 1 else evidence.states[variable]


def _has_zero(family: Family, evidence: BoundStates) -> bool:
    """Whether a factor has a zero at the known states of its variables.

    If a variable is unknown, or its known state may differ from run to run, all its states are
    examined. Where a CPD is stored in a shorter form, such as a sparse matrix, and its full table
    would be above the limit of memory, the answer is False without an examination.
    """
    factor, unknown = family
    if isinstance(factor, TableCPD):
        if factor._maps and math.prod(sizes(discrete(factor.scope))) > limits.LIMIT:
            return False
        if factor._positive:
            return False
    potential = factor._potential
    index: list[int | slice] = []
    for variable in potential.axes:
        state = slice(None) if variable in unknown else _state(variable, evidence)
        index.append(state if isinstance(state, int) else slice(None))
    return not potential.values[tuple(index)].all()


def _restricting(constraints: Sequence[Family], evidence: BoundStates) -> list[Family]:
    """The families of `constraints` that may make the evidence impossible, in their order.

    `constraints` are the families whose tables have a zero at the evidence. Those without unknown
    variables are left out, and so is a CPD whose child is unknown, has no evidence and is in no
    other family: whatever the states of its parents, some state of the child is possible. Leaving
    a family out may free the children of others in the same way.
    """
    some = [family for family in constraints if family[1]]
    left: dict[Discrete, Family] = {}
    others: list[Family] = []
    for family in some:
        factor, _ = family
        if isinstance(factor, TableCPD) and factor.child not in left:
            left[factor.child] = family
        else:  # a table, or a second CPD of a child, whose states are then not all possible
            others.append(family)
    count = Counter(v for _, unknown in some for v in unknown)
    waiting = list(left)
    while waiting:
        child = waiting.pop()
        if child not in left or count[child] != 1:
            continue
        _, unknown = left[child]
        if child not in unknown or child in evidence.states or child in evidence.weights:
            continue
        del left[child]
        count.subtract(unknown)
        waiting += unknown
    return [*left.values(), *others]


def _parts(families: Sequence[Family]) -> Iterator[list[Family]]:
    """The families in parts: two families of different parts share no unknown variable."""
    holding: dict[Discrete, list[int]] = {}
    for k, (_, unknown) in enumerate(families):
        for variable in unknown:
            holding.setdefault(variable, []).append(k)
    seen: set[int] = set()
    for first in range(len(families)):
        if first in seen:
            continue
        seen.add(first)
        part, waiting = [], [first]
        while waiting:
            k = waiting.pop()
            part.append(families[k])
            for variable in families[k][1]:
                new = [other for other in holding.pop(variable, ()) if other not in seen]
                seen.update(new)
                waiting += new
        yield part
