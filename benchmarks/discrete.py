"""Calibrating discrete networks: new evidence on a compiled network, then all marginals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

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


def tasks(seed: int = 0) -> dict[str, Task]:
    """Asia, and a random network of 200 variables and a junction tree of width 8 at the most."""
    medical = asia()
    named = {v.name: v for v in medical.variables}
    symptoms = {named["xray"]: 1, named["dyspnoea"]: 1}
    random = random_network(seed)
    rng = np.random.default_rng(seed)
    chosen = rng.choice(NODES, OBSERVED, replace=False)
    drawn = random.sample(rng=rng)
    seen = {random.variables[k]: int(drawn[random.variables[k]]) for k in chosen.tolist()}
    return {"asia": Task(medical, symptoms), "random_200": Task(random, seen)}


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


def with_pgm(task: Task) -> Callable[[], list[np.ndarray]]:
    """The work, with the network compiled beforehand."""
    graph, hidden = pgm.compile(task.network), task.hidden
    if graph.width > 8:
        raise RuntimeError(f"the network's junction tree has width {graph.width}; 8 was meant")

    def call() -> list[np.ndarray]:
        posterior = pgm.infer(graph, task.evidence)
        return [posterior[v].values for v in hidden]

    return call


def with_pyagrum(task: Task) -> Callable[[], list[np.ndarray]]:
    """The same work in pyAgrum, with its own default engine."""
    pyagrum: Any = import_module("pyagrum")
    peer = pyagrum.BayesNet()
    cpds = [cpd for cpd in task.network.cpds if isinstance(cpd, pgm.TableCPD)]
    for cpd in cpds:
        peer.add(pyagrum.LabelizedVariable(cpd.child.name, "", list(cpd.child.states)))
        for parent in cpd.parents:
            peer.addArc(parent.name, cpd.child.name)
    for cpd in cpds:
        table = peer.cpt(cpd.child.name)
        axes = [v.name for v in (*cpd.parents, cpd.child)]
        # Its arrays have the axes of its variables in reverse.
        order = [axes.index(name) for name in reversed(table.names)]
        table[:] = np.ascontiguousarray(np.transpose(cpd.table, order))
    engine = pyagrum.LazyPropagation(peer)
    evidence = {v.name: index for v, index in task.evidence.items()}
    names = [v.name for v in task.hidden]

    def call() -> list[np.ndarray]:
        engine.setEvidence(evidence)
        engine.makeInference()
        return [engine.posterior(name).toarray() for name in names]

    return call


def check(task: Task) -> None:
    """Both must give the same marginals."""
    for ours, theirs in zip(with_pgm(task)(), with_pyagrum(task)(), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)
