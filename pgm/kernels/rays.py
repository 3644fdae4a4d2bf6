r"""Rays through a grid of cells: how far they get, the cells that they enter, sums at their ends.

Cell (row, column) is the square [column, column + 1) × [row, row + 1): coordinates are in cells, x
along a row and y along a column. A *stop* is a cell that ends rays, such as an obstacle; the other
cells are free. The *clearances* (rows + 2, columns + 2) are the distances of all cells to the
nearest stop in the maximum norm, with a ring of further stops laid around the grid.

A ray from p along the unit vector u leaves an axis-parallel box at the least t of the crossings
(edge − p) / u of its axes. Going from the box of one cell to that of the next, it visits all cells
on its way (Amanatides & Woo, 1987). Where the nearest stop is c cells away in the maximum norm, all
cells less than c away are free, and the ray leaves the box that they form in one step, which gives
exactly the same hits (as Cohen & Sheffer, 1994).

In `summed` the ends of beams are computed in float32, to some ten thousandths of a cell on maps of
some thousand cells a side: an end that near to an edge may count as in the next cell.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_cdt

from pgm.kernels.arrays import Array, Integers, Mask

Cells = npt.NDArray[np.int32]
# Rays that are followed at a time: their arrays stay in a core's cache.
RAYS = 2**14
# In place of a component of a direction that is zero, so that its crossings are far away.
_TINY = 1e-200


def clearances(stops: Mask) -> Cells:
    """The distance of each cell to the nearest stop in the maximum norm, (rows + 2, columns + 2).

    `stops` (rows, columns) marks the stops, whose distance is zero. A ring of further stops is laid
    around the grid, so that rays end there; hence the two rows and columns more.
    """
    ring = np.zeros((stops.shape[0] + 2, stops.shape[1] + 2), dtype=bool)
    ring[1:-1, 1:-1] = ~stops
    found: Cells = distance_transform_cdt(ring, metric="chessboard").astype(np.int32)
    return found


def cast(clear: Cells, points: Array, units: Array, most: float) -> Array:
    """The distances (n,) in cells at which rays enter a stop; infinite if none is within `most`.

    `clear` are the clearances of the stops. Rays begin at `points` (2, n), x and y in cells of the
    grid without its ring, and go along the unit vectors `units` (2, n). To enter the ring, and so
    to leave the grid, is no hit.
    """
    found = np.full(points.shape[1], np.inf)
    for first in range(0, points.shape[1], RAYS):
        place = slice(first, first + RAYS)
        _follow(clear, points[:, place], units[:, place], most, found[place])
    return found


def _follow(clear: Cells, points: Array, units: Array, most: float, found: Array) -> None:
    """Put the distances at which rays enter a stop, within `most` cells, into `found` (n,).

    The entries of all other rays stay. `clear` are the clearances of the stops; rays begin at
    `points` (2, n), x and y in cells of the grid without its ring, and go along the unit vectors
    `units` (2, n). Each ray is followed in a frame of its own, mirrored so that both its
    coordinates increase, from the edge of one box of free cells to that of the next.
    """
    height, width = clear.shape
    sizes, strides = np.array([[width], [height]]), np.array([[1.0], [width]])
    points = points + 1.0  # of the ring
    behind = units < 0.0
    points = np.where(behind, sizes - points, points)
    units = np.maximum(np.abs(units), _TINY)
    inverse = 1.0 / units
    # The part of each ray within the grid, which may begin outside.
    distance = np.maximum(((1.0 - points) * inverse).max(axis=0), 0.0)
    end = np.minimum(((sizes - 1.0 - points) * inverse).min(axis=0), most)
    cells = np.floor(points + distance * units)
    cells = np.minimum(np.maximum(cells, 1.0), sizes - 2.0)
    base = np.where(behind, strides * (sizes - 1.0), 0.0).sum(axis=0)
    rays = np.concatenate(
        [points, units, inverse, np.where(behind, -strides, strides), cells, [base, distance, end]]
    )
    which = np.flatnonzero(distance < end)
    rays, flat = rays[:, which], clear.ravel()
    while which.size:
        right, up, column, row, base, distance, end = rays[6:]
        step = np.take(flat, (column * right + row * up + base).astype(np.intp))
        going = np.flatnonzero((step > 0) & (distance < end))
        if going.size < which.size:
            # A ray ends in the ring no earlier than where it leaves the grid.
            hit = np.flatnonzero((step == 0) & (distance < end))
            found[which[hit]] = distance[hit]
            which, step = which[going], step[going]
            rays = np.take(rays, going, axis=1)
        _advance(rays, step.astype(np.float64))


def _advance(rays: Array, step: Array) -> None:
    """Move rays, in place, to where they leave the square of free cells around their cells.

    `rays` (13, n) has a ray in each column, in a frame mirrored so that both its coordinates
    increase. Its rows are, for x and y each, where the ray begins, its direction, the reciprocal of
    the direction, the change of a cell's flat index from one cell to the next, and the cell; then
    the flat index of cell (0, 0), the distance so far and the distance at which the ray ends. The
    distance so far and the cell are changed.

    The square's edge ahead along each axis is `step` (n,) cells from the near edge of the ray's
    cell; the ray goes to the first of these two edges that it reaches.
    """
    x, y, across, along, by_across, by_along, _, _, column, row, _, distance, _ = rays
    edge, other = column + step, row + step
    first, second = (edge - x) * by_across, (other - y) * by_along
    by_x = first < second
    np.minimum(first, second, out=distance)
    # The cell entered is the one behind the edge crossed; along the other axis rounding is kept
    # from leaving the box.
    rays[8] = np.where(by_x, edge, _between(column, x + distance * across, edge))
    rays[9] = np.where(by_x, _between(row, y + distance * along, other), other)


def _between(low: Array, place: Array, edge: Array) -> Array:
    """The cell indices ⌊place⌋ (n,), clipped to `low` ≤ cell < `edge` against rounding.

    `place` (n,) is where each of n rays is along an axis, in cells, and is overwritten. `low` and
    `edge` (n,) are whole numbers, the first cell allowed for each ray and the one after the last.
    """
    cells = np.floor(place, out=place)
    np.maximum(cells, low, out=cells)
    np.minimum(cells, edge - 1.0, out=cells)
    return cells


def entered(points: Array, ends: Array, width: int) -> Integers:
    """The flat indices row · width + column of all cells that n line segments enter, as one array.

    Segments lead from `points` to `ends`, (2, n), x and y in cells, none negative; their first
    cells are included. The crossings of all segments with the lines of the grid are found at once,
    each leading into one cell; a cell that several segments enter occurs once for each of them.
    """
    first, last = np.floor(points).astype(np.intp), np.floor(ends).astype(np.intp)
    count = np.abs(last - first)
    sign = np.where(last < first, -1, 1)
    # Each segment in a frame of its own, its first cell at zero and both axes ahead.
    part = np.where(sign > 0, points - first, first + 1 - points)
    length = np.abs(ends - points)
    base = first[1] * width + first[0]
    strides = sign * np.array([[1], [width]])
    found = [base]
    for along, other in ((0, 1), (1, 0)):
        slope = length[other] / np.maximum(length[along], _TINY)
        offset = part[other] - part[along] * slope
        times = count[along]
        line = _counted(times)
        # Through a corner the segment goes by the cell beside it, once: first along x, then y.
        place = np.repeat(offset, times) + line * np.repeat(slope, times)
        cell = np.ceil(place) - 1.0 if along == 0 else np.floor(place)
        cell = np.minimum(np.maximum(cell, 0.0), np.repeat(count[other], times))
        index = line * np.repeat(strides[along], times)
        index += np.repeat(base, times)
        index += cell.astype(np.intp) * np.repeat(strides[other], times)
        found.append(index)
    return np.concatenate(found)


def _counted(times: Integers) -> npt.NDArray[Any]:
    """The numbers 1 to n for each n of `times`: (3, 2) gives 1, 2, 3, 1, 2."""
    before = np.cumsum(times) - times
    return np.arange(1, times.sum() + 1) - np.repeat(before, times)


Single = npt.NDArray[np.float32]
# Ends that are worked on at a time: their arrays stay in a core's cache.
ENDS = 2**15
# More cells than an int32 counts.
_MANY = 2**31


def summed(table: Single, poses: Array, units: Array, ranges: Array, seen: Mask) -> Array:
    """The sum of a table's entries at the cells in which the beams of each pose end, (m,).

    `table` (rows, columns) is contiguous; ends beyond its edge count as in the cell on the edge.
    `poses` (m, 3) are column and row in cells and heading in radians; `units` (2, beams) are the
    beams' directions in the frame of the pose. `ranges`, in cells, and `seen`, which marks the
    beams whose ends are summed over, are (m, beams), or (1, beams) where all poses share one scan.
    """
    shared = len(ranges) == 1
    if shared:
        units = (units * ranges[0])[:, seen[0]]
    beams = units.shape[1]
    size = max(min(len(poses), ENDS // max(beams, 1)), 1)
    work = _Work(table, (size, beams))
    # Columns and rows are products of (cos, sin, place) with these, or sums of their parts.
    x, y = units
    rest = np.full(beams, 1.0 if shared else 0.0)
    to_column = np.stack([x, -y, rest]).astype(np.float32)
    to_row = np.stack([y, x, rest]).astype(np.float32)
    ones = np.ones(beams, dtype=np.float32)
    found = np.empty(len(poses))
    for first in range(0, len(poses), size):
        place = slice(first, min(first + size, len(poses)))
        ahead = np.empty((place.stop - first, 3), dtype=np.float32)
        column, row, heading = poses[place].T
        ahead[:, 0], ahead[:, 1] = np.cos(heading), np.sin(heading)
        work.cut(len(ahead))
        for position, matrix, out in ((column, to_column, work.column), (row, to_row, work.row)):
            ahead[:, 2] = position
            np.matmul(ahead, matrix, out=out)
        if not shared:
            own = ranges[place].astype(np.float32)
            for position, out in ((column, work.column), (row, work.row)):
                np.multiply(out, own, out=out)
                np.add(out, position.astype(np.float32)[:, None], out=out)
        values = work.taken()
        if not shared:
            np.multiply(values, seen[place], out=values)
        found[place] = values @ ones
    return found


class _Work:
    """Work space of `summed`: arrays for the ends of beams, and for the table's entries there.

    The caller fills `column` and `row` (poses, beams), the coordinates of ends in cells, and
    `taken` reads the table there. `shape` is the largest number of poses, and that of beams.
    """

    def __init__(self, table: Single, shape: tuple[int, int]) -> None:
        self.table, self.flat = table, table.ravel()
        self._floats = np.empty((2, *shape), dtype=np.float32)
        kind = np.int32 if table.size < _MANY else np.int64
        self._indices = np.empty((2, *shape), dtype=kind)
        self.cut(shape[0])

    def cut(self, size: int) -> None:
        """Cut the work space to `size` poses, at most as many as it was made for.

        `column`, `row` and the arrays of indices become views of its first `size` rows.
        """
        self.column, self.row = self._floats[:, :size]
        self._index, self._other = self._indices[:, :size]

    def taken(self) -> Single:
        """The entries of the table at `column` and `row`, (poses, beams); both are overwritten."""
        height, width = self.table.shape
        np.clip(self.column, np.float32(0.0), np.float32(width - 1), out=self.column)
        np.clip(self.row, np.float32(0.0), np.float32(height - 1), out=self.row)
        np.copyto(self._index, self.column, casting="unsafe")
        np.copyto(self._other, self.row, casting="unsafe")
        np.multiply(self._other, width, out=self._other)
        np.add(self._index, self._other, out=self._index)
        found: Single = np.take(self.flat, self._index, out=self.column, mode="clip")
        return found
