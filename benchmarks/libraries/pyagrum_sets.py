"""pyAgrum on many sets of evidence, one by one."""

from __future__ import annotations

import numpy as np
import pyagrum

import pgm
from benchmarks.timing import Contender
from benchmarks.work.repository import Sets


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


def marginals(sets: Sets) -> Contender:
    """Each set of evidence, then all marginals, by its own default engine."""
    engine = pyagrum.LazyPropagation(filled(sets.network))
    rows = [
        {v.name: int(states[k]) for v, states in sets.evidence.items() if states[k] >= 0}
        for k in range(sets.count)
    ]
    names = [v.name for v in sets.hidden]

    def call() -> list[np.ndarray]:
        found = []
        for row in rows:
            engine.setEvidence(row)
            engine.makeInference()
            found.append([engine.posterior(name).toarray() for name in names])
        return [np.array(column) for column in zip(*found, strict=True)]

    return Contender(call, sets.count)
