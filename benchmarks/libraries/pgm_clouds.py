"""pgm with particles: models are made beforehand, evidence goes in with the call."""

from __future__ import annotations

from typing import Any

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work.clouds import Clouds
from benchmarks.work.robots import Array, pose
from models.networks import landmark, sighting, velocity


def filtering(functions: str, dtype: str, work: Clouds) -> Contender:
    """The mean and covariance at the last step, by the bootstrap filter, one step at a time.

    As the package particles does, it holds one step's particles; `pgm.filter` keeps all.
    """
    network = work.plain() if functions == "plain" else work.robots.network
    belief = pgm.Particles(work.count, dtype=getattr(np, dtype))
    robot, run = pgm.OnlineFilter(network, belief=belief), work.robots

    def call() -> tuple[Array, Array]:
        now = robot.initial()
        for control, marks, readings in zip(
            run.controls, run.landmarks, run.readings[0], strict=True
        ):
            now = robot.predict(now, {velocity: control})
            now = robot.update(now, {sighting: pgm.sightings(readings, given={landmark: marks})})
        last = now[pose]
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
