"""pgm with particles: the graph is compiled beforehand, evidence goes in with the call."""

from __future__ import annotations

from typing import Any

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work.clouds import Clouds
from benchmarks.work.robots import Array, pose


def filtering(functions: str, dtype: str, work: Clouds) -> Contender:
    """The mean and covariance at the last step, by the bootstrap filter."""
    network = work.plain() if functions == "plain" else work.robots.network
    graph = pgm.compile(network, work.robots.steps)
    belief = pgm.Particles(work.count, dtype=getattr(np, dtype))

    def call() -> tuple[Array, Array]:
        given = work.robots.evidence(0)
        found = pgm.infer(graph, given, schedule=pgm.Filtering(), belief=belief)
        last = found[pose][-1]
        return last.mean, last.cov

    return Contender(call, work.units)


def smoothing(way: str, work: Clouds) -> Contender:
    """Means and covariances at all steps, of trajectories drawn backwards."""
    graph = pgm.compile(work.robots.network, work.robots.steps)
    belief: Any = pgm.Particles(work.count, smoothing=way, trajectories=work.count)

    def call() -> tuple[Array, Array]:
        found = pgm.infer(graph, work.robots.evidence(0), belief=belief)[pose]
        return found.mean, found.cov

    return Contender(call, work.units)
