"""pgm on linear networks: a balanced cluster tree, or the chain of slices."""

from __future__ import annotations

import pgm
from benchmarks.timing import Contender, compiled_or_not
from benchmarks.work.targets import Array, Tracking

METHODS = {"balanced": pgm.Balanced(), "sequential": None}


def smoothing(method: str, work: Tracking, *, compiled: bool = False) -> Contender:
    """Means (T, n) and covariances."""
    graph = pgm.compile(work.network, work.steps, method=METHODS[method], compiled=compiled)

    def call() -> tuple[Array, Array]:
        belief = pgm.infer(graph, work.evidence, schedule=pgm.Smoothing())[work.state]
        return belief.mean[1:], belief.cov[1:]

    return compiled_or_not(call, work.steps, compiled)
