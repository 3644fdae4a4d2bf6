"""pyAgrum on a discrete network just read: an engine, the first evidence, all marginals."""

from __future__ import annotations

import numpy as np
import pyagrum

from benchmarks.libraries.pyagrum_tables import filled
from benchmarks.timing import Contender
from benchmarks.work.tables import Task

ENGINES = {
    "lazy_propagation": pyagrum.LazyPropagation,  # its default
    "shafer_shenoy": pyagrum.ShaferShenoyInference,
}


def marginals(engine: str, task: Task) -> Contender:
    """Each time of a network that nothing has been asked of."""
    network, make = filled(task.network), ENGINES[engine]
    evidence = {v.name: index for v, index in task.evidence.items()}
    hidden = [v.name for v in task.hidden]

    def call(network: pyagrum.BayesNet = network) -> list[np.ndarray]:
        inference = make(network)
        inference.setEvidence(evidence)
        inference.makeInference()
        return [inference.posterior(name).toarray() for name in hidden]

    return Contender(call, 1, fresh=lambda: pyagrum.BayesNet(network))
