"""The part of a discrete network that bears on a query: its factors, hidden variables and evidence.

Outside this part are the CPDs of variables that are neither asked for nor observed and have no such
descendant, and the factors that the evidence separates from the variables asked for.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

from pgm.cpds import TableCPD
from pgm.evidence.static import BoundStates
from pgm.factors import Table
from pgm.factors.axes import States, discrete
from pgm.networks import BayesianNetwork, MarkovNetwork
from pgm.variables import Discrete, Variable

# A factor of a discrete network; and one with those of its variables whose state is not known.
Factor = TableCPD | Table
Family = tuple[Factor, States]


@dataclass(frozen=True, eq=False)
class Requisite:
    """The part of a network that bears on a query.

    A variable is *known* if it has one state alone or is observed in all runs.

    factors: The CPDs, and other factors, of the part.
    open: The variables of each of these that are not known.
    hidden: All variables of the part that are not known, those asked for first.
    evidence: The evidence on the variables of the part. Its `lead`, the lengths of its axes of
        runs, is () if all of it is given once for all runs.
    left_out: The factors outside the part, of CPDs those whose child has evidence or is an
        ancestor of a variable with evidence, each with its variables that are not known: they bear
        on nothing but the probability of the evidence.
    """

    factors: tuple[Factor, ...]
    open: tuple[States, ...]
    hidden: States
    evidence: BoundStates
    left_out: tuple[Family, ...] = ()

    @classmethod
    def of(
        cls, network: MarkovNetwork, wanted: Iterable[Discrete], evidence: BoundStates
    ) -> Requisite:
        """Find the part of a network that bears on the variables `wanted`, given evidence.

        `network` has CPDs of independent causes in their factors.

        A variable of a Bayesian network is *barren* if neither it nor any of its descendants is
        asked for or observed: its CPD sums to one, and is left out. Any other factor bears on the
        query if a path of factors, each sharing with the next a variable that is not known, joins
        it to a variable asked for; the product of all the rest is a constant. A variable with
        evidence in some runs alone, or with soft evidence, is not known; a variable of a single
        state is.

        Source: Lauritzen, Dawid, Larsen and Leimer (1990), Independence properties of directed
        Markov fields. Shachter (1998), Bayes-Ball: The rational pastime.
        """
        known, wanted = certain(evidence), tuple(wanted)
        families: list[Family] = []
        holding: dict[Variable, list[int]] = {}
        for factor in _bearing(network, wanted, evidence):
            axes = factor._potential.axes
            unknown = tuple(v for v in axes if v not in known and v.size > 1)
            for member in unknown:
                holding.setdefault(member, []).append(len(families))
            families.append((factor, unknown))
        reached = dict.fromkeys(v for v in wanted if v in holding)
        inside: dict[int, None] = {}
        front: list[Variable] = list(reached)
        while front:
            for k in holding[front.pop()]:
                if k not in inside:
                    inside[k] = None
                    new = [v for v in families[k][1] if v not in reached]
                    reached |= dict.fromkeys(new)
                    front += new
        factors = tuple(families[k][0] for k in inside)
        members = {v for factor in factors for v in factor.scope}
        return cls(
            factors,
            tuple(families[k][1] for k in inside),
            discrete(tuple(reached)),
            evidence_of(evidence, members),
            tuple(family for k, family in enumerate(families) if k not in inside),
        )


def _bearing(
    network: MarkovNetwork, wanted: Sequence[Discrete], evidence: BoundStates
) -> Iterator[Factor]:
    """The factors but the CPDs of barren variables."""
    if not isinstance(network, BayesianNetwork):
        yield from cast(Sequence[Factor], network.factors)
        return
    seen: set[Variable] = set()
    waiting: list[Variable] = [*wanted, *evidence.states, *evidence.weights]
    while waiting:
        variable = waiting.pop()
        if variable in seen or cast(Discrete, variable).size == 1:
            continue
        seen.add(variable)
        cpd = cast(TableCPD, network.cpd(variable))
        yield cpd
        waiting += cpd.given


def certain(evidence: BoundStates) -> set[Discrete]:
    """The variables with a hard observation in every run."""
    return {v for v, s in evidence.states.items() if isinstance(s, int) or s.min() >= 0}


def evidence_of(evidence: BoundStates, members: set[Variable]) -> BoundStates:
    """The evidence of the variables `members`, without those of a single state.

    A state given once for all runs, as an array (1,), becomes a number. The `lead` of evidence is
    the lengths of its axes of runs; that of the result is () if all of it is given once for all
    runs.
    """
    states = {
        v: s if isinstance(s, int) or s.size > 1 else int(s[0])
        for v, s in evidence.states.items()
        if v in members and v.size > 1
    }
    weights = {v: w for v, w in evidence.weights.items() if v in members and v.size > 1}
    alike = all(isinstance(s, int) for s in states.values()) and all(
        len(w) == 1 for w in weights.values()
    )
    return replace(evidence, lead=() if alike else evidence.lead, states=states, weights=weights)
