"""pyAgrum on discrete networks."""

from __future__ import annotations

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


def marginals(task: Task) -> Contender:
    """New evidence, then all marginals, by its own default engine."""
    engine = pyagrum.LazyPropagation(filled(task.network))
    evidence = {v.name: index for v, index in task.evidence.items()}
    names = [v.name for v in task.hidden]

    def call() -> list[np.ndarray]:
        engine.setEvidence(evidence)
        engine.makeInference()
        return [engine.posterior(name).toarray() for name in names]

    return Contender(call, 1)
