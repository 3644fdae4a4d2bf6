"""pgm with particles and a likelihood field: the graph is compiled beforehand."""

from __future__ import annotations

import pgm
from benchmarks.timing import Contender
from benchmarks.work.scans import STEPS, Array, Scans
from models.networks import pose


def filtering(work: Scans) -> Contender:
    """The mean at the last step; particles are drawn anew at every step, as the peer's are."""
    graph = pgm.compile(work.network, STEPS)
    belief = pgm.Particles(work.count, threshold=1.0)

    def call() -> Array:
        found = pgm.infer(graph, work.evidence, schedule=pgm.Filtering(), belief=belief)
        mean: Array = found[pose.at(STEPS)].mean
        return mean

    return Contender(call, work.units)
