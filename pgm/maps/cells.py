"""Grids of square cells in the plane: where cells are, and what lies in which."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats
from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.kernels import rigid
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.maps.given import as_finite
from pgm.resources import require_memory


class Cells(NamedTuple):
    """Cells of a map.

    Attributes
    ----------
    rows, columns : ndarray of int
        (...): also of points outside, where they are none of the map's.
    inside : ndarray of bool
        (...): whether the map has them.

    Examples
    --------
    >>> room = pgm.maps.OccupancyMap([[0, 0, 1], [0, 0, 1]], resolution=0.5)
    >>> found = room.at([[0.2, 0.7], [1.2, 5.0]])
    >>> found.rows, found.columns
    (array([ 1, 10]), array([0, 2]))
    >>> found.inside
    array([ True, False])
    """

    rows: Integers
    columns: Integers
    inside: Mask


class CellGrid(Immutable):
    """Base of maps of square cells.

    shape: Rows and columns.
    resolution: The side of a cell [m].
    origin: (3,): x, y [m] and yaw [rad] of the lower left corner of the cell in row 0 and column 0.
    """

    shape: tuple[int, int]
    resolution: float
    origin: Array

    def at(self, points: npt.ArrayLike) -> Cells:
        """The cells that points lie in.

        Parameters
        ----------
        points : array_like
            (..., 2): x and y [m].

        Returns
        -------
        Cells
            Rows, columns, and whether the map has them, (...).

        Raises
        ------
        ModelError
            If points have another shape, or are not finite.
        """
        place = np.floor(self._to_cells(as_finite(points, "points", 2)))
        columns, rows = np.moveaxis(np.clip(place, -(2.0**62), 2.0**62).astype(np.intp), -1, 0)
        height, width = self.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        return Cells(rows, columns, inside)

    def centres(self, rows: npt.ArrayLike, columns: npt.ArrayLike) -> Array:
        """The centres of cells [m], (..., 2).

        Parameters
        ----------
        rows, columns : array_like
            (...).

        Returns
        -------
        ndarray
            (..., 2).

        Raises
        ------
        ModelError
            If they are no numbers, or their shapes do not broadcast.
        """
        given = as_floats(rows, "rows of cells"), as_floats(columns, "columns of cells")
        try:
            row, column = np.broadcast_arrays(*given)
        except ValueError:
            raise ModelError(
                f"rows have shape {given[0].shape} and columns {given[1].shape}; equal ones were "
                "due"
            ) from None
        place = np.stack([column, row], axis=-1)
        return rigid.points_out_of(self.origin, (place + 0.5) * self.resolution)

    def _places(self, spacing: float, mask: Mask) -> Array:
        """Places a spacing apart along both axes, in cells of a mask, (n, 2)."""
        height, width = self.shape
        sides = (side * self.resolution / spacing for side in (width, height))
        counts = [max(int(min(side, 1e300)), 1) for side in sides]
        require_memory(counts[0] * counts[1], "places of poses", "set them further apart")
        axes = [(np.arange(n) + 0.5) * spacing for n in counts]
        local = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        columns, rows = np.floor(local / self.resolution).astype(np.intp).T
        inside = (rows < height) & (columns < width)
        local, rows, columns = local[inside], rows[inside], columns[inside]
        found: Array = rigid.points_out_of(self.origin, local[mask[rows, columns]])
        return found

    def _to_cells(self, points: Array) -> Array:
        """Points (..., 2) as columns and rows, with fractions."""
        found: Array = rigid.points_from(self.origin, points) / self.resolution
        return found
