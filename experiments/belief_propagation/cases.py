"""The networks with loops on which exact inference and loopy messages are compared."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

import pgm
from experiments.belief_propagation.loops import Case, Numbers, sweep
from models.discrete import sprinkler, wet
from models.networks import velocity
from models.rings import discrete_ring, gaussian_ring
from models.unknown_landmarks import landmark_clusters, reading, unknown_landmarks

GUESSES = ((2.5, -1.5), (4.0, 2.5), (0.0, 2.0))  # prior means of the landmarks [m]
GUESS_STD = 0.5  # m
MOTION_STD = (0.3, 0.3, 0.15)  # m, m, rad a step
CONTROL = (1.0, 0.5)  # m/s, rad/s

SPINS = tuple(np.linspace(-1.5, 1.5, 13).tolist())
PRECISIONS = tuple((2.0 ** np.arange(-3.0, 3.0)).tolist())
LIMITS = {"discrete": 1000, "gaussian": 300}  # iterations


def wet_grass() -> Case:
    """Sprinkler, the grass being wet."""
    return Case.of(sprinkler(), {wet: "yes"})


def spins(coupling: float) -> Case:
    """Four spins in a ring."""
    return Case.of(*discrete_ring(coupling))


def places(precision: float) -> Case:
    """Four places in a ring."""
    return Case.of(*gaussian_ring(precision))


def sums_of_three(precision: float) -> Case:
    """The same with readings of three places."""
    return Case.of(*gaussian_ring(precision, span=3))


def robot(seed: int, steps: int) -> tuple[Case, dict[pgm.Variable, Any]]:
    """A robot that sees a landmark at each pose, one after the other, and the truth drawn."""
    count = len(GUESSES)
    seen = [(step, -step % count) for step in range(steps + 1)]
    network = unknown_landmarks(steps, seen, GUESSES, motion_std=MOTION_STD, guess_std=GUESS_STD)
    controls = {velocity.at(step): np.array(CONTROL) for step in range(1, steps + 1)}
    truth = network.sample(inputs=controls, rng=seed)
    evidence = controls | {(z := reading(step, k)): truth[z] for step, k in seen}
    graphs = {f"carrying_{n}": landmark_clusters(network, range(n)) for n in range(1, count)}
    return Case.of(network, evidence, **graphs), truth


def discrete_sweep(couplings: Sequence[float] = SPINS) -> dict[str, dict[str, list[Numbers]]]:
    """Spins in a ring, and the same with diagonals."""
    schedules = _damped(LIMITS["discrete"])
    return {
        "ring": sweep(discrete_ring, couplings, schedules),
        "with diagonals": sweep(partial(discrete_ring, diagonals=True), couplings, schedules),
    }


def gaussian_sweep(
    precisions: Sequence[float] = PRECISIONS,
) -> dict[str, dict[str, list[Numbers]]]:
    """Places in a ring, of which each reading adds up two or three."""
    schedules = _damped(LIMITS["gaussian"])
    return {
        "sums of two": sweep(gaussian_ring, precisions, schedules),
        "sums of three": sweep(partial(gaussian_ring, span=3), precisions, schedules),
    }


def _damped(limit: int) -> dict[str, pgm.Flooding]:
    return {
        "flooding": pgm.Flooding(iterations=limit),
        "damped": pgm.Flooding(damping=0.5, iterations=limit),
    }
