"""A maze whose walls a robot feels, with a mistake at times."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import numpy.typing as npt

import pgm
from models.worlds.world import COMPASS, Array, World

MAZE = (
    "#############",
    "#...........#",
    "#.###.###.#.#",
    "#.#.......#.#",
    "#.#.##.####.#",
    "#.....#.....#",
    "#############",
)
# Readings: is there a wall in the north, east, south and west?
PATTERNS = tuple(product((False, True), repeat=4))


def maze(rows: Sequence[str] = MAZE, *, mistake: float = 0.2, fails: float = 0.1) -> World:
    """A robot in a maze that knows its heading and senses the walls of its cell.

    Of its four sensors one at most is mistaken, each as often as the others; a step that fails, or
    goes against a wall, leaves it where it is.

    Parameters
    ----------
    rows : sequence of str
        The maze from above, walls as #; all around it are walls.
    mistake : float
        Probability that one sensor is wrong.
    fails : float
        Probability that a step is not executed.

    Returns
    -------
    World
        Nothing is known of the first cell. Cells are named by row and column, as "3,1"; readings
        by the walls they tell of, as "NS", or "none".

    Raises
    ------
    ValueError
        If there is no cell to be in.

    Notes
    -----
    After the second example of the lecture that has the grid world, due to M. Pfeiffer; the maze is
    ours, since its picture is lost.
    """
    around = walls(rows)
    places = np.array([at for at, row in np.ndenumerate(_open(rows)) if row]) - 1
    right = 1.0 - mistake
    wrong = (np.array(PATTERNS) != around[:, None]).sum(axis=-1)
    return World(
        pgm.Discrete("x", tuple(f"{row},{column}" for row, column in places)),
        pgm.Discrete("u", tuple(COMPASS)),
        pgm.Discrete("z", tuple(named(pattern) for pattern in PATTERNS)),
        prior=np.full(len(places), 1.0 / len(places)),
        motion=_motion(places, around, fails),
        sensor=np.choose(np.minimum(wrong, 2), [right, mistake / 4.0, 0.0]),
        places=places,
    )


def walls(rows: Sequence[str] = MAZE) -> npt.NDArray[np.bool_]:
    """Whether each cell has a wall in the north, east, south and west, (K, 4)."""
    free = _open(rows)
    sides = [~np.roll(free, (-down, -right), axis=(0, 1)) for down, right in COMPASS.values()]
    found: npt.NDArray[np.bool_] = np.stack(sides, axis=-1)[free]
    if not len(found):
        raise ValueError("the maze has no cells to be in; draw them as .")
    return found


def named(pattern: Sequence[bool]) -> str:
    """The reading of walls in the north, east, south and west."""
    return "".join(letter for letter, wall in zip("NESW", pattern, strict=True) if wall) or "none"


def _open(rows: Sequence[str]) -> npt.NDArray[np.bool_]:
    """The cells without a wall, in a frame of walls."""
    width = max(map(len, rows))
    lines = [[letter != "#" for letter in row.ljust(width, "#")] for row in rows]
    return np.pad(np.array(lines, dtype=bool), 1)


def _motion(places: npt.NDArray[np.int_], around: npt.NDArray[np.bool_], fails: float) -> Array:
    """p(cell | cell before, direction), (K, 4, K)."""
    number = {tuple(place): k for k, place in enumerate(places.tolist())}
    moved = np.zeros((len(places), len(COMPASS), len(places)))
    for k, place in enumerate(places):
        for action, by in enumerate(COMPASS.values()):
            reached = k if around[k, action] else number[tuple((place + by).tolist())]
            moved[k, action, k] += fails
            moved[k, action, reached] += 1.0 - fails
    return moved
