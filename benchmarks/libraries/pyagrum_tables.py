"""pyAgrum on discrete networks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyagrum

import pgm
from benchmarks.timing import Contender
from benchmarks.work.tables import Task


def filled(network: pgm.BayesianNetwork) -> pyagrum.BayesNet:
    """A network of our numbers."""
    peer = pyagrum.BayesNet()
    cpds = [cpd for cpd in network.cpds if isinstance(cpd, pgm.TableCPD)]
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
    return peer


def marginals(tasks: Sequence[Task]) -> Contender:
    """Each set of evidence of one network, then all marginals, by its own default engine."""
    engine = pyagrum.LazyPropagation(filled(tasks[0].network))
    asked = [
        ({v.name: index for v, index in task.evidence.items()}, [v.name for v in task.hidden])
        for task in tasks
    ]

    def call() -> list[np.ndarray]:
        found = []
        for evidence, names in asked:
            engine.setEvidence(evidence)
            engine.makeInference()
            found += [engine.posterior(name).toarray() for name in names]
        return found

    return Contender(call, len(tasks))


def whole(task: Task) -> Contender:
    """One set of evidence of a network of which it has nothing yet."""
    return Contender(lambda: marginals([task]).call(), 1)
