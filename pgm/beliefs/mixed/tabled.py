"""The network of tables, with the configurations of the parts as variables of their own.

A part's *choice* is a variable whose states are the part's possible configurations. For each
discrete parent of the part there is a factor, zero but where the parent has the state that the
chosen configuration has. The log-evidence of configurations is then soft evidence of the choice,
run by run, and its belief their probability.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pgm.beliefs.discrete.outcome import DiscreteOutcome
from pgm.beliefs.discrete.run import run as run_tables
from pgm.beliefs.mixed.parts import Part
from pgm.clustergraph import ClusterGraph
from pgm.compile.methods import JunctionTree
from pgm.evidence.rows import as_log_weights
from pgm.evidence.values import Soft, soft
from pgm.factors import Table
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.networks import MarkovNetwork
from pgm.networks.markov import Factor
from pgm.schedules.impossible import ImpossibleEvidence
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False)
class Tabled:
    """A network of tables and choices.

    Attributes
    ----------
    graph : ClusterGraph
    evidence : mapping of Discrete
        What is known of the discrete variables.
    choices : sequence of Discrete or None
        By part its choice; None where there is one configuration alone.
    every : Discrete
        A variable of which nothing is known in each run, so that tables have all axes of runs.
    lead : tuple of int
        The user's axes of runs.
    """

    graph: ClusterGraph
    evidence: Mapping[Variable, object]
    choices: Sequence[Discrete | None]
    every: Discrete
    lead: tuple[int, ...]

    @classmethod
    def of(
        cls,
        tables: Sequence[Factor],
        evidence: Mapping[Variable, object],
        parts: Sequence[tuple[Part, Integers]],
        lead: tuple[int, ...],
    ) -> Tabled:
        """The network of some tables, and of parts with their possible configurations."""
        names = {v.name for factor in tables for v in factor.scope}
        factors = list(tables)
        choices: list[Discrete | None] = []
        for part, configurations in parts:
            count = len(configurations)
            if count == 1 or not part.boundary:
                choices.append(None)
                continue
            choice = Discrete(_name(f"choice {len(choices)}", names), count)
            choices.append(choice)
            factors.append(Table.vacuous(choice))
            for k, parent in enumerate(part.boundary):
                own = configurations[:, k]
                if (own == own[0]).all() and parent in evidence:
                    continue  # it is observed to be that
                agrees = (own[:, None] == np.arange(parent.size)).astype(np.float64)
                factors.append(Table((choice, parent), agrees))
        every = Discrete(_name("every run", names), 1)
        factors.append(Table.vacuous(every))
        return cls(JunctionTree()(MarkovNetwork(factors)), evidence, choices, every, lead)

    def solved(
        self, logs: Sequence[Array], allowed: Sequence[Mask]
    ) -> tuple[DiscreteOutcome, Array]:
        """The beliefs of all tables and choices, and the log-evidence of all evidence, (runs,).

        `logs` are by part the log-evidence of its configurations, (configurations, runs), of which
        `allowed` count.
        """
        known, total = dict(self.evidence), np.zeros(math.prod(self.lead))
        for choice, log, mask in zip(self.choices, logs, allowed, strict=True):
            own = np.where(mask, log, -np.inf)
            if choice is None:
                total = total + own.max(axis=0)
            else:
                known[choice] = soft(own.T.reshape(*self.lead, choice.size), log=True)
        known[self.every] = soft(np.ones((*self.lead, self.every.size)))
        try:
            found = run_tables(self.graph, known, None)
        except ImpossibleEvidence as error:
            raise _impossible(error, self.lead) from None
        return found, total + np.ravel(found.log_evidence)

    def levelled(self) -> Tabled:
        """The same network, soft evidence telling but which states are possible at all."""
        known = dict(self.evidence)
        for variable, value in known.items():
            if isinstance(variable, Discrete) and isinstance(value, Soft):
                possible = as_log_weights(variable, value) > -np.inf
                known[variable] = soft(possible.astype(np.float64))
        return replace(self, evidence=known)


def _name(name: str, taken: set[str]) -> str:
    """The name, with as many primes as it takes for no other variable to have it."""
    while name in taken:
        name += "′"
    taken.add(name)
    return name


def _impossible(error: ImpossibleEvidence, lead: tuple[int, ...]) -> ImpossibleEvidence:
    where = f", in run {error.run}" if lead else ""
    return ImpossibleEvidence(
        f"the evidence has probability zero{where}: each configuration of the discrete variables "
        "is impossible by the tables, or contradicted by what continuous variables are known to be",
        error.lost,
        lead,
    )
