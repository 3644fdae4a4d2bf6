"""A corridor with doors that look alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import pgm
from models.worlds.world import World

CELLS = 30
DOORS = (5, 11, 23)


def hallway(
    cells: int = CELLS,
    doors: Sequence[int] = DOORS,
    *,
    steps: Sequence[float] = (0.1, 0.8, 0.1),
    seen: float = 0.9,
) -> World:
    """A robot in a corridor of cells, some with a door, that tells doors, walls and the end apart.

    Parameters
    ----------
    cells : int
        How many.
    doors : sequence of int
        The cells that have one.
    steps : sequence of float
        Probabilities of going 0, 1, 2, ... cells when told to go ahead; told to wait it stays. The
        last cell is the end.
    seen : float
        Probability that a cell is read as what it is; the others are read as often as each other.

    Returns
    -------
    World
        Nothing is known of the first cell.

    Raises
    ------
    ValueError
        If a door is in no cell, or at the end.

    Notes
    -----
    Thrun, Burgard & Fox, Probabilistic Robotics (2005), section 1.1.
    """
    places = np.stack([np.zeros(cells, dtype=int), np.arange(cells)], axis=-1)
    lost = [door for door in doors if door not in range(cells - 1)]
    if lost:
        raise ValueError(f"doors in the cells {lost}; they may be in cells 0 to {cells - 2}")
    motion = np.zeros((cells, 2, cells))
    motion[:, 0] = np.eye(cells)
    for step, probability in enumerate(steps):
        reached = np.minimum(np.arange(cells) + step, cells - 1)
        motion[np.arange(cells), 1, reached] += probability
    kind = np.ones(cells, dtype=int)
    kind[list(doors)], kind[-1] = 0, 2
    return World(
        pgm.Discrete("x", tuple(str(cell) for cell in range(cells))),
        pgm.Discrete("u", ("wait", "ahead")),
        pgm.Discrete("z", ("door", "wall", "end")),
        prior=np.full(cells, 1.0 / cells),
        motion=motion,
        sensor=np.where(kind[:, None] == np.arange(3), seen, (1.0 - seen) / 2.0),
        places=places,
    )
