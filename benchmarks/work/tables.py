"""Discrete networks and what is observed of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pgm
from models.discrete import asia

NODES, WINDOW, OBSERVED = 200, 6, 20


@dataclass(frozen=True, eq=False)
class Task:
    """A network, with what is observed: the index of a state by variable."""

    network: pgm.BayesianNetwork
    evidence: dict[pgm.Variable, int]

    @property
    def hidden(self) -> list[pgm.Discrete]:
        """The variables whose marginals are asked for."""
        variables = (v for v in self.network.variables if v not in self.evidence)
        return [v for v in variables if isinstance(v, pgm.Discrete)]


def medical() -> Task:
    """Asia, with two symptoms."""
    network = asia()
    named = {v.name: v for v in network.variables}
    return Task(network, {named["xray"]: 1, named["dyspnoea"]: 1})


def random(seed: int = 0) -> Task:
    """A random network of 200 variables and a junction tree of width 8 at the most."""
    network = random_network(seed)
    rng = np.random.default_rng(seed)
    chosen = rng.choice(NODES, OBSERVED, replace=False)
    drawn = network.sample(rng=rng)
    seen = {network.variables[k]: int(drawn[network.variables[k]]) for k in chosen.tolist()}
    return Task(network, seen)


def random_network(seed: int) -> pgm.BayesianNetwork:
    """200 variables of two to four states, each with up to three parents not far before it."""
    rng = np.random.default_rng(seed)
    variables = [pgm.Discrete(f"v{k}", int(rng.integers(2, 5))) for k in range(NODES)]
    cpds = []
    for k, child in enumerate(variables):
        near = variables[max(0, k - WINDOW) : k]
        chosen = rng.choice(len(near), min(len(near), int(rng.integers(1, 4))), replace=False)
        parents = [near[j] for j in sorted(chosen.tolist())]
        shape = tuple(parent.size for parent in parents)
        table = rng.dirichlet(np.ones(child.size), size=shape)
        cpds.append(pgm.TableCPD(child, parents, table=table))
    return pgm.BayesianNetwork(cpds)
