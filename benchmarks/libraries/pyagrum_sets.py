"""pyAgrum on many sets of evidence, one by one."""

from __future__ import annotations

import numpy as np
import pyagrum

from benchmarks.libraries.pyagrum_tables import filled
from benchmarks.timing import Contender
from benchmarks.work.repository import Sets


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
