"""Streams of random numbers: one for each run, step and purpose of its draws."""

from __future__ import annotations

import numpy as np

# The purposes of streams, which are independent of each other.
FORWARD, RESTARTED, BACKWARD, STARTED, INJECTED = range(5)


def stream(
    seed: int, run: int, step: int, purpose: int = FORWARD, *more: int
) -> np.random.Generator:
    """The generator of a run's draws at a step for one purpose, independent of all the others.

    purpose: The number of what is drawn: FORWARD the particles of a filter, RESTARTED those of a
        run that begins anew from the prior, BACKWARD the trajectories of a smoother, STARTED and
        INJECTED states from a proposal over cells. A fixed-lag smoother draws the belief of a step
        t by trajectories of its own; at step t + k it draws them with the purpose BACKWARD + k.
    more: Numbers that tell draws of one purpose apart, as those of several calls.
    """
    key = np.random.SeedSequence(seed, spawn_key=(run, step, purpose, *more))
    return np.random.Generator(np.random.SFC64(key))
