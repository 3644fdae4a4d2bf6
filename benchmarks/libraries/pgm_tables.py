"""pgm on discrete networks: the junction tree is compiled beforehand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work.tables import Task


def marginals(tasks: Sequence[Task]) -> Contender:
    """Each set of evidence of one network, then all marginals."""
    graph = pgm.compile(tasks[0].network)
    asked = [(task.evidence, task.hidden) for task in tasks]

    def call() -> list[np.ndarray]:
        found = []
        for evidence, hidden in asked:
            posterior = pgm.infer(graph, evidence)
            found += [posterior[v].values for v in hidden]
        return found

    return Contender(call, len(tasks))
