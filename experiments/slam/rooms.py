"""A house of rooms around a corridor: its walls, places on them, and a way through all rooms.

The corridor is a square ring around a court. Rooms stand along its four outer sides, each behind a
door in its middle; outside of the rooms there is nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

ROOM = 4.0  # m, the side of a room
CORRIDOR = 2.0  # m, the width of the corridor
DOOR = 1.0  # m
# How far landmarks stand before the wall that they hang on, so that it does not hide them [m].
BEFORE_WALL = 0.02
# How far the way through a room keeps from its walls, and turns from the door's middle [m].
CLEARANCE = 1.0


@dataclass(frozen=True, eq=False)
class Rooms:
    """The house.

    Attributes
    ----------
    side : int
        The number of rooms along each side.
    walls : ndarray
        (W, 2, 2): the ends of each wall, east and north [m].
    faces : ndarray
        (F, 2, 2): the sides of walls that a robot indoors can see.
    way : ndarray
        (P, 2): the corners of a way from a corner of the corridor through all rooms, back to that
        corner and along the first side once more.
    """

    side: int
    walls: Array
    faces: Array
    way: Array

    def places(self, count: int, rng: np.random.Generator) -> Array:
        """Places (count, 2) spread over the walls, one drawn in each of as many equal lengths."""
        lengths = np.linalg.norm(self.faces[:, 1] - self.faces[:, 0], axis=-1)
        ends = np.concatenate([[0.0], np.cumsum(lengths)])
        at = (np.arange(count) + rng.uniform(size=count)) * ends[-1] / count
        face = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, len(lengths) - 1)
        part = ((at - ends[face]) / lengths[face])[:, None]
        found: Array = self.faces[face, 0] + part * (self.faces[face, 1] - self.faces[face, 0])
        return found

    def seen(self, eye: Array, places: Array, reach: float) -> npt.NDArray[np.bool_]:
        """The places (L, 2) that are within reach of each point (N, 2) and behind no wall, (N, L).

        A line of sight crosses a wall where the ends of each lie on both sides of the other.
        """
        near: npt.NDArray[np.bool_] = np.linalg.norm(places - eye[:, None], axis=-1) <= reach
        row, column = np.nonzero(near)
        one, other = eye[row, None], places[column, None]
        begin, end = self.walls[:, 0], self.walls[:, 1]
        crossed = (_turn(one, other, begin) * _turn(one, other, end) < 0.0) & (
            _turn(begin, end, one) * _turn(begin, end, other) < 0.0
        )
        near[row, column] = ~crossed.any(axis=-1)
        return near


def rooms(side: int) -> Rooms:
    """A house with some rooms along each of four sides.

    Parameters
    ----------
    side : int
        The number of rooms along a side, at least 1.
    """
    half = 0.5 * side * ROOM
    outer = half + CORRIDOR
    middle = half + 0.5 * CORRIDOR
    south = -outer - ROOM
    walls, faces, way = [], [], []
    # The south side with its corner; the others are the same, turned.
    walls.append(((-half, -half), (half, -half)))
    faces.append(((-half, -half - BEFORE_WALL), (half, -half - BEFORE_WALL)))
    way.append((-middle, -middle))
    for end in (-1.0, 1.0):
        walls.append(((end * half, -outer), (end * outer, -outer)))
        faces.append(((end * half, -outer + BEFORE_WALL), (end * outer, -outer + BEFORE_WALL)))
    walls.append(((-half, south), (half, south)))
    for k in range(side):
        west, east = -half + k * ROOM, -half + (k + 1) * ROOM
        door = 0.5 * (west + east)
        walls.append(((west, south), (west, -outer)))
        for a, b in ((west, door - 0.5 * DOOR), (door + 0.5 * DOOR, east)):
            walls.append(((a, -outer), (b, -outer)))
            for before in (BEFORE_WALL, -BEFORE_WALL):
                faces.append(((a, -outer + before), (b, -outer + before)))
        faces.append(((west + BEFORE_WALL, south), (west + BEFORE_WALL, -outer)))
        faces.append(((east - BEFORE_WALL, south), (east - BEFORE_WALL, -outer)))
        faces.append(((west, south + BEFORE_WALL), (east, south + BEFORE_WALL)))
        near, far = -outer - CLEARANCE, south + CLEARANCE
        left, right = west + CLEARANCE, east - CLEARANCE
        way += [(door, -middle), (door, near), (left, near), (left, far), (right, far)]
        way += [(right, near), (door, near), (door, -middle)]
    walls.append(((half, south), (half, -outer)))
    quarter = np.array([[0.0, 1.0], [-1.0, 0.0]])  # of row vectors, to the left
    turns = [np.linalg.matrix_power(quarter, k) for k in range(4)]
    back = np.array([(-middle, -middle), (middle, -middle)])
    return Rooms(
        side,
        np.concatenate([np.array(walls) @ turn for turn in turns]),
        np.concatenate([np.array(faces) @ turn for turn in turns]),
        np.concatenate([*(np.array(way) @ turn for turn in turns), back]),
    )


def _turn(a: Array, b: Array, c: Array) -> Array:
    """Twice the area of the triangles a, b, c, positive where they turn to the left."""
    found: Array = (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (
        c[..., 0] - a[..., 0]
    )
    return found
