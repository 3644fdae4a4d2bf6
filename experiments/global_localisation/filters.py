"""Filters that follow many drives at once: particles and grids."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.global_localisation import places
from experiments.global_localisation.world import Drives, moved, scan
from models.networks import pose

Array = npt.NDArray[np.float64]


Way = tuple[pgm.DynamicBayesianNetwork, pgm.Particles | pgm.Grid]


@dataclass(frozen=True, eq=False)
class Followed:
    """Estimates of drives.

    Attributes
    ----------
    poses : ndarray
        (runs, T+1, 3): the mean of the heaviest mode, given the scans up to each step.
    number, injected : ndarray of int
        (runs, T+1): of particles, and of those put elsewhere; zeros of a grid.
    seconds : float
        Of a processor.
    """

    poses: Array
    number: npt.NDArray[np.int_]
    injected: npt.NDArray[np.int_]
    seconds: float


def online(way: Way) -> pgm.OnlineFilter:
    """The online filter of a way."""
    network, belief = way
    return pgm.OnlineFilter(network, belief=belief)


@contextmanager
def unwarned() -> Iterator[None]:
    """Say nothing of few particles or wide cells: how well these do is the question."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pgm.ParticleWarning)
        warnings.simplefilter("ignore", pgm.GridWarning)
        yield


def beliefs(robot: Any, first: Any, drives: Drives) -> Iterator[Any]:
    """The beliefs of all drives step by step, of which all at once would fill the memory.

    Parameters
    ----------
    robot : OnlineFilter
    first : OnlineBelief
        The robot's ``initial()``, which takes a while on a grid.
    drives : Drives
    """
    held = first
    for t in range(drives.steps + 1):
        if t:
            held = robot.predict(held, {moved: drives.odometry[:, t - 1]})
        held = robot.update(held, {scan: drives.scans[:, t]})
        yield held


def follow(way: Way, drives: Drives) -> Followed:
    """Follow drives; a grid does so one drive at a time."""
    began = time.process_time()
    shape = drives.scans.shape[:2]
    poses = np.empty((*shape, 3))
    number, injected = np.zeros(shape, dtype=int), np.zeros(shape, dtype=int)
    robot = online(way)
    first = robot.initial()
    with unwarned():
        if isinstance(robot.belief, pgm.Grid):
            for run in range(shape[0]):
                alone = drives.some(slice(run, run + 1))
                for t, held in enumerate(beliefs(robot, first, alone)):
                    poses[run, t] = places.of_grid(held[pose][0])
        else:
            for t, held in enumerate(beliefs(robot, first, drives)):
                poses[:, t] = places.of_particles(held[pose])
                number[:, t] = held[pose].number
                injected[:, t] = held.status.injected[:, -1]
    return Followed(poses, number, injected, time.process_time() - began)
