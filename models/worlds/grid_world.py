"""The grid world of two rows and three columns by which a lecture explains the Bayes filter."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import pgm
from models.worlds.world import COMPASS, Array, World

SHAPE = (2, 3)
# A step goes ahead, stays, or goes ahead and to the right at once.
AHEAD, STAYS, ASIDE = 0.6, 0.3, 0.1
# A column is read as it is, or as each of the others.
RIGHT, WRONG = 0.8, 0.1


def grid_world() -> World:
    """A robot among six cells, a b c above d e f, that reads its column.

    A step south goes ahead with .6, stays with .3, and goes to the lower left with .1; the other
    directions are turned alike. At a wall the robot moves along it.

    Returns
    -------
    World
        Known to be in the top row: p(x₀) = (.25, .5, .25).

    Notes
    -----
    Bestmann, Görner & Zhang, Intelligent Robotics (University of Hamburg, 2019), state estimation.
    The lecture's pictures of the motion and of the sensor are lost: these numbers are one reading
    that gives its beliefs, (1, 16, 1)/18 over the top row after the column 0 was read, and after a
    step south (.0167, .2667, .0167) above (.1278, .5389, .0333). Its .0504 is a misprint, and
    nothing needs normalising after a motion.
    """
    places = np.moveaxis(np.indices(SHAPE), 0, -1).reshape(-1, 2)
    return World(
        pgm.Discrete("x", tuple("abcdef")),
        pgm.Discrete("u", tuple(COMPASS)),
        pgm.Discrete("z", ("-1", "0", "1")),
        prior=np.array([0.25, 0.5, 0.25, 0.0, 0.0, 0.0]),
        motion=_motion(places),
        sensor=np.where(places[:, 1, None] == np.arange(SHAPE[1]), RIGHT, WRONG),
        places=places,
    )


def _motion(places: npt.NDArray[np.int_]) -> Array:
    """p(cell | cell before, direction), (6, 4, 6)."""
    offsets = np.array(list(COMPASS.values()))
    aside = offsets + np.roll(offsets, -1, axis=0)
    moved = np.zeros((len(places), len(COMPASS), len(places)))
    cells, directions = np.indices(moved.shape[:2])
    for probability, by in ((AHEAD, offsets), (STAYS, 0 * offsets), (ASIDE, aside)):
        # Each axis by itself, so that what a wall leaves of a step goes along it.
        row, column = np.moveaxis(places[:, None] + by, -1, 0)
        row, column = np.clip(row, 0, SHAPE[0] - 1), np.clip(column, 0, SHAPE[1] - 1)
        np.add.at(moved, (cells, directions, row * SHAPE[1] + column), probability)
    return moved
