"""pgm on discrete networks: the junction tree is compiled beforehand."""

from __future__ import annotations

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work.tables import Task


def marginals(task: Task) -> Contender:
    """New evidence, then all marginals."""
    graph, hidden = pgm.compile(task.network), task.hidden
    if graph.width > 8:
        raise RuntimeError(f"the network's junction tree has width {graph.width}; 8 was meant")

    def call() -> list[np.ndarray]:
        posterior = pgm.infer(graph, task.evidence)
        return [posterior[v].values for v in hidden]

    return Contender(call, 1)
