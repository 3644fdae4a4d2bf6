"""pgm on grids: the graph is compiled beforehand, evidence goes in with the call."""

from __future__ import annotations

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work import rooms
from benchmarks.work.robots import Array, Robots, pose
from pgm.schedules.schedule import Schedule

SCHEDULES: dict[str, Schedule] = {"filter": pgm.Filtering(), "smoother": pgm.Smoothing()}


def on_grid(schedule: str, work: Robots) -> Contender:
    """The probabilities of all cells at all steps: (T + 1, *cells)."""
    graph, grid = pgm.compile(work.network, work.steps), rooms.grid()

    def call() -> Array:
        posterior = pgm.infer(graph, work.evidence(0), schedule=SCHEDULES[schedule], belief=grid)
        belief = posterior[pose]
        assert isinstance(belief, pgm.results.GridBelief)
        return belief.values

    return Contender(call, work.steps * int(np.prod(rooms.CELLS)))
