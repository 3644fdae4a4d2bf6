"""pgm on a discrete network just read: compile, the first evidence, all marginals."""

from __future__ import annotations

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work.tables import Task


def marginals(task: Task) -> Contender:
    """Each time of a network that nothing has been asked of."""
    evidence, hidden = task.evidence, task.hidden

    def call(network: pgm.BayesianNetwork = task.network) -> list[np.ndarray]:
        posterior = pgm.infer(pgm.compile(network), evidence)
        return [posterior[v].values for v in hidden]

    return Contender(call, 1, fresh=lambda: pgm.BayesianNetwork(task.network.cpds))
