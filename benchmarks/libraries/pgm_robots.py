"""pgm's part of each row: graphs are compiled beforehand, evidence goes in with the call.

With `compiled` sweeps are in machine code, else NumPy's, whatever their length.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

import pgm
from benchmarks.timing import Contender, compiled_or_not
from benchmarks.work.changes import OwnTaylor, without_jacobians
from benchmarks.work.robots import Array, Robots, pose
from models.networks import landmark, sighting, velocity

Choice = bool | pgm.Compiled

RULES: dict[str, pgm.Lineariser] = {
    "taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "own": OwnTaylor(),
}
# Of two linearisations the second is made, and no more is asked of it.
ENOUGH = math.inf


def filtering(
    rule: str, work: Robots, iterations: int = 1, *, compiled: Choice = False
) -> Contender:
    """All runs in one call: means (runs, T, 3) and covariances."""
    graph = pgm.compile(work.network, work.steps, compiled=compiled)
    schedule = pgm.Filtering(iterations=iterations, tolerance=ENOUGH)

    def call() -> tuple[Array, Array]:
        posterior = pgm.infer(graph, work.evidence(), schedule=schedule, lineariser=RULES[rule])
        belief = posterior[pose]
        return belief.mean[:, 1:], belief.cov[:, 1:]

    return compiled_or_not(call, work.runs * work.steps, compiled)


def together(rule: str, work: Robots, iterations: int = 1) -> Contender:
    """As `filtering`, of which a step of all runs is the unit."""
    return Contender(filtering(rule, work, iterations).call, work.steps)


def smoothing(rule: str, work: Robots, *, compiled: Choice = False) -> Contender:
    """One run, forward and back: means (T, 3) and covariances."""
    graph = pgm.compile(work.network, work.steps, compiled=compiled)

    def call() -> tuple[Array, Array]:
        posterior = pgm.infer(
            graph, work.evidence(0), schedule=pgm.Smoothing(), lineariser=RULES[rule]
        )
        belief = posterior[pose]
        return belief.mean[1:], belief.cov[1:]

    return compiled_or_not(call, work.steps, compiled)


def prepared(rule: str, work: Robots, *, compiled: Choice = False) -> Contender:
    """As `smoothing`, of a call that was prepared."""
    graph = pgm.compile(work.network, work.steps, compiled=compiled)
    run = pgm.prepare(graph, work.evidence(0), lineariser=RULES[rule])

    def call() -> tuple[Array, Array]:
        belief = run(work.evidence(0))[pose]
        return belief.mean[1:], belief.cov[1:]

    return compiled_or_not(call, work.steps, compiled)


def no_jacobian(runs: str, derivatives: str, work: Robots) -> Contender:
    """A smoother of one run, or a filter of many, without Jacobians: traced, or by differences."""
    work = without_jacobians(work, traced=derivatives == "traced")
    return {"one": smoothing, "many": filtering}[runs]("taylor", work)


def in_loop(robot: pgm.OnlineFilter, work: Robots) -> Callable[[], tuple[Array, Array]]:
    """The loop of one robot, a belief after every step: means (T, 3) and covariances."""

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

    return call


def online(rule: str, work: Robots, iterations: int = 1, *, compiled: bool = False) -> Contender:
    """One robot in its loop: means (T, 3) and covariances."""
    schedule = pgm.Filtering(iterations=iterations, tolerance=ENOUGH)
    robot = pgm.OnlineFilter(work.network, RULES[rule], schedule, compiled=compiled)
    return compiled_or_not(in_loop(robot, work), work.steps, compiled)


def iterated(work: Robots, *, compiled: Choice = False) -> Contender:
    """One run, linearised anew until it converges from dead reckoning: (T, 3) and covariances.

    In machine code the sweeps go along the chain, else rounds up and down a balanced tree.
    """
    schedule = pgm.Smoothing(iterations=50, tolerance=1e-4)
    return _iterated(work, schedule, work.dead_reckoning(0), compiled)


def thrice(work: Robots) -> Contender:
    """One run, linearised three times from the truth: dead reckoning is too far off after hours."""
    return _iterated(work, pgm.Smoothing(iterations=3, tolerance=0.0), work.truth[0])


def _iterated(
    work: Robots, schedule: pgm.Smoothing, start: Array, compiled: Choice = False
) -> Contender:
    method = None if compiled else pgm.Balanced()
    graph = pgm.compile(work.network, work.steps, method=method, compiled=compiled)

    def call() -> tuple[Array, Array]:
        posterior = pgm.infer(graph, work.evidence(0), schedule=schedule, start={pose: start})
        belief = posterior[pose]
        return belief.mean[1:], belief.cov[1:]

    return compiled_or_not(call, work.steps, compiled)
