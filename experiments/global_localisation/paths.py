"""Paths through a house: from place to place, in the middle of its rooms and doors."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d, label
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

import pgm.maps
from pgm.errors import ModelError

Array = npt.NDArray[np.float64]

CLEARANCE = 0.25  # m, from the robot's centre to any wall
# Cells along a row or column from one node of the graph to the next.
STRIDE = 2
# How far off walls a path keeps where it has the room [m], and how long its bends are [m].
WISHED, BEND = 0.6, 0.3
TRIES = 100
_NEXT = ((0, 1), (1, 0), (1, 1), (1, -1))


class Paths:
    """The shortest paths between places of a map, walls being the dearer the nearer they are.

    Parameters
    ----------
    map : OccupancyMap
    indoors : ndarray of bool
        (rows, columns): where the robot may go.
    """

    def __init__(self, map: pgm.maps.OccupancyMap, indoors: npt.NDArray[np.bool_]) -> None:
        clear = (map.distances * indoors)[::STRIDE, ::STRIDE]
        parts, _ = label(clear > CLEARANCE, structure=np.ones((3, 3)))
        # The largest part: a cupboard has no way out.
        allowed = parts == 1 + np.bincount(parts[parts > 0]).argsort()[-1] - 1
        rows, columns = np.nonzero(allowed)
        number = np.full(allowed.shape, -1)
        number[rows, columns] = np.arange(len(rows))
        self.places = map.centres(rows * STRIDE, columns * STRIDE)
        self._graph: Any = _graph(number, np.minimum(clear, WISHED), STRIDE * map.resolution)

    def draw(self, length: float, rng: np.random.Generator) -> Array:
        """Points (n, 2) of a path between two random places, some cm apart, of a length or more.

        Parameters
        ----------
        length : float
            [m].
        rng : numpy.random.Generator

        Raises
        ------
        ModelError
            If the house has no room for it.
        """
        for _ in range(TRIES):
            first = int(rng.integers(len(self.places)))
            costs, befores = dijkstra(self._graph, indices=[first], return_predecessors=True)
            cost, before = costs[0], befores[0]
            # A path is no longer than it costs.
            far = np.flatnonzero(np.isfinite(cost) & (cost > length))
            for last in rng.permutation(far)[:10].tolist():
                points = self._smooth(_back(before, last))
                if np.linalg.norm(np.diff(points, axis=0), axis=1).sum() >= length:
                    return points
        raise ModelError(
            f"no path of {length:g} m was found in the house from {TRIES} places; ask for fewer "
            "steps"
        )

    def _smooth(self, nodes: list[int]) -> Array:
        points = self.places[nodes[::-1]]
        apart = np.linalg.norm(np.diff(points, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(apart)])
        spacing = 0.02
        even = np.arange(0.0, along[-1], spacing)
        each = [np.interp(even, along, points[:, k]) for k in (0, 1)]
        found: Array = gaussian_filter1d(np.stack(each, axis=1), BEND / spacing, 0, mode="nearest")
        return found


def along(points: Array, step: float, steps: int) -> Array:
    """Poses (T+1, 3) every so many metres of a path: east, north, and the course as the heading."""
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1)
    reached = np.concatenate([[0.0], np.cumsum(apart)])
    wanted = step * np.arange(steps + 1)
    slope = np.gradient(points, axis=0)
    course = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))
    return np.stack([np.interp(wanted, reached, v) for v in (*points.T, course)], axis=1)


def _graph(number: npt.NDArray[np.int_], clear: Array, spacing: float) -> csr_array:
    """The lengths of edges between neighbours, times how much dearer walls make them."""
    height, width = number.shape
    first, last, cost = [], [], []
    for down, right in _NEXT:
        one = slice(0, height - down), slice(max(-right, 0), width - max(right, 0))
        two = slice(down, height), slice(max(right, 0), width + min(right, 0))
        both = (number[one] >= 0) & (number[two] >= 0)
        near = np.minimum(clear[one], clear[two])[both]
        first.append(number[one][both])
        last.append(number[two][both])
        cost.append(spacing * np.hypot(down, right) * (WISHED / near) ** 2)
    ends = np.concatenate(first + last), np.concatenate(last + first)
    size = int(number.max()) + 1
    return csr_array((np.concatenate(cost + cost), ends), shape=(size, size))


def _back(before: npt.NDArray[np.int_], last: int) -> list[int]:
    """The nodes from the last one back to the first."""
    nodes = [last]
    while before[nodes[-1]] >= 0:
        nodes.append(int(before[nodes[-1]]))
    return nodes
