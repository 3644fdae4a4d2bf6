"""pgm on static Gaussian networks of many variables: means and covariances of all, as arrays."""

from __future__ import annotations

import pgm
from benchmarks.timing import Contender
from benchmarks.work.asked import Asked, Beliefs, Work

# In deviations. By its own defaults gtsam stops about as far from its optimum.
TO_THE_OPTIMUM = pgm.Calibration(iterations=50, tolerance=1e-4)


def marginals(work: Work, *, compiled: bool = False) -> Contender:
    """The network declared and compiled beforehand, solved by NumPy alone or in machine code."""
    asked = work.asked()
    graph = pgm.compile(asked.network, compiled=compiled)
    return Contender(lambda: _solved(graph, asked), work.units)


def whole(work: Work, *, compiled: bool = False) -> Contender:
    """From numbers to marginals: declared, compiled and solved."""

    def call() -> list[Beliefs]:
        asked = work.asked()
        return _solved(pgm.compile(asked.network, compiled=compiled), asked)

    return Contender(call, work.units)


def declared(work: Work) -> Contender:
    """Declared and compiled, and nothing asked."""
    return Contender(lambda: pgm.compile(work.asked().network), 1)


def _solved(graph: pgm.ClusterGraph, asked: Asked) -> list[Beliefs]:
    start = asked.start or None
    posterior = pgm.infer(graph, asked.evidence, schedule=TO_THE_OPTIMUM, start=start)
    return [(posterior.means(kind), posterior.covs(kind)) for kind in asked.kinds]
