"""pgm on many sets of evidence at once: the junction tree is compiled beforehand."""

from __future__ import annotations

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work.repository import Sets


def marginals(sets: Sets) -> Contender:
    """All sets at once, then all marginals, (sets, states) each."""
    graph, hidden = pgm.compile(sets.network), sets.hidden

    def call() -> list[np.ndarray]:
        posterior = pgm.infer(graph, sets.evidence)
        return [posterior[v].values for v in hidden]

    return Contender(call, sets.count)
