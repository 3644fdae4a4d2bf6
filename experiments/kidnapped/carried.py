"""Drives in whose middle the robot is carried elsewhere, and does not notice."""

from __future__ import annotations

import numpy as np

from experiments.global_localisation.paths import along
from experiments.global_localisation.world import STEP, Drives, World, odometry

FAR = 3.0  # m, at least, that it is carried


def carried(world: World, runs: int, before: int, after: int, rng: np.random.Generator) -> Drives:
    """Drives of `before` and `after` steps.

    At step `before` the robot is where the second part begins, while the odometer tells of a step
    like any other.
    """

    def path(steps: int) -> np.ndarray:
        return along(world.paths.draw(STEP * steps, rng), STEP, steps)

    first = np.stack([path(before) for _ in range(runs)])
    second = np.empty((runs, after + 1, 3))
    for run, last in enumerate(first[:, -1, :2]):
        second[run] = path(after)
        while np.linalg.norm(second[run, 0, :2] - last) < FAR:
            second[run] = path(after)
    told = np.concatenate([odometry(first, rng), odometry(second, rng)], axis=1)
    truth = np.concatenate([first[:, :-1], second], axis=1)
    return world.measured(truth, told, rng)
