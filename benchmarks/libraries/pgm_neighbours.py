"""pgm's part of the rows of neighbours: calls of any schedule, and loops with any settings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import pgm
from benchmarks.libraries.pgm_robots import in_loop
from benchmarks.timing import Contender, compiled_or_not
from benchmarks.work.robots import Array, Robots, pose

POINTS = 7
Work = Callable[[Robots], Robots]


def unchanged(work: Robots) -> Robots:
    """The model of range and bearing itself."""
    return work


def swept(
    work: Robots,
    schedule: Any,
    change: Work = unchanged,
    lineariser: pgm.Lineariser | None = None,
    *,
    compiled: bool = True,
) -> Contender:
    """One run in one call: means (T, 3) and covariances."""
    work, rule = change(work), lineariser or pgm.Taylor()
    graph = pgm.compile(work.network, work.steps, compiled=compiled)
    evidence = work.evidence(0)

    def call() -> tuple[Array, Array]:
        belief = pgm.infer(graph, evidence, schedule=schedule, lineariser=rule)[pose]
        return belief.mean[1:], belief.cov[1:]

    return compiled_or_not(call, work.steps, compiled)


def looped(work: Robots, *, compiled: bool = True, **settings: Any) -> Contender:
    """One robot in its loop, with settings of `OnlineFilter`: means (T, 3) and covariances."""
    robot = pgm.OnlineFilter(work.network, compiled=compiled, **settings)
    return compiled_or_not(in_loop(robot, work), work.steps, compiled)


def asked(work: Robots, function: Callable[[Array, Array], Array], inputs: Array) -> Contender:
    """A function alone, at as many points a step as differences by three components take."""
    points = np.repeat(work.truth[0, 1:, None], POINTS, axis=1)
    given = np.repeat(inputs[:, None], POINTS, axis=1)

    def call() -> None:
        for x, value in zip(points, given, strict=True):
            function(x, value)

    return Contender(call, work.steps)
