"""A robot in a room, whose pose is known to a grid of cells: two sightings of beacons a step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pgm
from benchmarks.work.robots import Robots
from models import motion, networks, sensors

DT = 0.5
CELLS = (100, 67, 72)
ROOM = np.array([10.0, 6.7])  # [m], about the origin
START = (0.0, -1.6, 0.0)
MOTION_STD = (0.1, 0.1, 0.06)
SENSOR_STD = (0.3, 0.15)
SEEN = 2  # sightings a step


@dataclass(frozen=True)
class Kind:
    """Beacons (n, 2), and the mean and the standard deviations of the first pose that are told."""

    beacons: tuple[tuple[float, float], ...]
    start: tuple[float, float, float]
    start_std: tuple[float, float, float]


KINDS = {
    "": Kind(((-4.5, -3.0), (4.5, -3.0), (0.0, 3.2)), START, (0.5, 0.5, 0.3)),
    # Of one beacon alone the robot learns that it is somewhere on a ring, turned accordingly, until
    # its own motion tells where: a third of the cells are active at most steps, and not a fiftieth.
    "wide": Kind(((0.0, 0.0),), (0.0, 0.0, 0.0), (1.3, 0.9, 2.0)),
}


def draw(steps: int, kind: str = "", seed: int = 0) -> Robots:
    """One robot that drives about a circle of 1.6 m round the middle; see `KINDS`."""
    rng = np.random.default_rng(seed)
    controls = np.tile([0.8, 0.5], (steps, 1))
    places = np.array(KINDS[kind].beacons)
    beacons = places[np.arange(steps * SEEN) % len(places)].reshape(steps, SEEN, 2)
    drive = motion.Velocity(dt=DT)
    truth = np.empty((1, steps + 1, 3))
    truth[0, 0] = START
    for k, control in enumerate(controls):
        noise = np.array(MOTION_STD) * rng.standard_normal(3)
        truth[0, k + 1] = drive(truth[0, k], control) + noise
    exact = sensors.range_bearing(np.broadcast_to(truth[:, 1:, None], (1, steps, SEEN, 3)), beacons)
    readings = exact + np.array(SENSOR_STD) * rng.standard_normal(exact.shape)
    network = networks.range_bearing(
        DT,
        start=KINDS[kind].start,
        start_std=KINDS[kind].start_std,
        motion_std=MOTION_STD,
        sensor_std=SENSOR_STD,
    )
    return Robots(network, controls, beacons, readings, truth)


def grid() -> pgm.Grid:
    """Cells of 10 cm and 5 degrees."""
    (east, north), (columns, rows, headings) = ROOM / 2.0, CELLS
    return pgm.Grid(
        {"east": (-east, east, columns), "north": (-north, north, rows), "heading": headings}
    )
