"""pgm's part of each row: graphs are compiled beforehand, evidence goes in with the call."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work.changes import OwnTaylor
from benchmarks.work.robots import Array, Robots, pose
from models.networks import landmark, sighting, velocity

RULES: dict[str, pgm.Lineariser] = {
    "taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "own": OwnTaylor(),
}


def filtering(rule: str, work: Robots, iterations: int = 1) -> Contender:
    """All runs in one call: means (runs, T, 3) and covariances."""
    graph = pgm.compile(work.network, work.steps)
    schedule = pgm.Filtering(iterations=iterations)

    def call() -> tuple[Array, Array]:
        posterior = pgm.infer(graph, work.evidence(), schedule=schedule, lineariser=RULES[rule])
        belief = posterior[pose]
        return belief.mean[:, 1:], belief.cov[:, 1:]

    return Contender(call, work.runs * work.steps)


def together(rule: str, work: Robots, iterations: int = 1) -> Contender:
    """As `filtering`, of which a step of all runs is the unit."""
    return Contender(filtering(rule, work, iterations).call, work.steps)


def smoothing(rule: str, work: Robots) -> Contender:
    """One run, forward and back: means (T, 3) and covariances."""
    graph = pgm.compile(work.network, work.steps)

    def call() -> tuple[Array, Array]:
        posterior = pgm.infer(
            graph, work.evidence(0), schedule=pgm.Smoothing(), lineariser=RULES[rule]
        )
        belief = posterior[pose]
        return belief.mean[1:], belief.cov[1:]

    return Contender(call, work.steps)


def online(rule: str, work: Robots, iterations: int = 1) -> Contender:
    """One robot in its loop: means (T, 3) and covariances."""
    schedule = pgm.Filtering(iterations=iterations)
    compiled = find_spec("numba") is not None
    robot = pgm.OnlineFilter(work.network, RULES[rule], schedule, compiled=compiled)

    def call() -> tuple[Array, Array]:
        means, covs = np.empty((work.steps, 3)), np.empty((work.steps, 3, 3))
        belief = robot.initial()
        for k in range(work.steps):
            belief = robot.predict(belief, {velocity: work.controls[k]})
            seen = pgm.sightings(work.readings[0, k], given={landmark: work.landmarks[k]})
            belief = robot.update(belief, {sighting: seen})
            here = belief[pose]
            means[k], covs[k] = here.mean, here.cov
        return means, covs

    return Contender(call, work.steps)


def iterated(work: Robots) -> Contender:
    """One run, linearised anew until it converges from dead reckoning: (T, 3) and covariances."""
    return _iterated(work, pgm.Smoothing(iterations=50, tolerance=1e-4), work.dead_reckoning(0))


def thrice(work: Robots) -> Contender:
    """One run, linearised three times from the truth: dead reckoning is too far off after hours."""
    return _iterated(work, pgm.Smoothing(iterations=3, tolerance=1e-12), work.truth[0])


def _iterated(work: Robots, schedule: pgm.Smoothing, start: Array) -> Contender:
    graph = pgm.compile(work.network, work.steps, method=pgm.Balanced())

    def call() -> tuple[Array, Array]:
        posterior = pgm.infer(graph, work.evidence(0), schedule=schedule, start={pose: start})
        belief = posterior[pose]
        return belief.mean[1:], belief.cov[1:]

    return Contender(call, work.steps)
