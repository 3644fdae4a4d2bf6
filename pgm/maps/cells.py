"""Grids of square cells in the plane, and checks of maps' and map sensors' arguments."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats, is_number
from pgm.errors import ModelError, PgmError
from pgm.immutable import Immutable
from pgm.kernels import rigid
from pgm.kernels.arrays import Array, Integers, Mask, frozen
from pgm.resources import require_memory


def as_pose(value: npt.ArrayLike, what: str, error: type[PgmError] = ModelError) -> Array:
    """One pose (x, y, heading), read-only."""
    array = as_floats(value, what, error)
    if array.shape != (3,):
        raise error(f"{what} has shape {array.shape}; (3,) was due: x, y and an angle")
    if not np.isfinite(array).all():
        raise error(f"{what} is {array.tolist()}; its three numbers must be finite")
    return frozen(array.copy())


def as_finite(value: npt.ArrayLike, what: str, last: int) -> Array:
    """An array (..., last) of finite numbers."""
    array = as_floats(value, what)
    if array.ndim == 0 or array.shape[-1] != last:
        raise ModelError(f"{what} have shape {array.shape}; their last axis has {last} numbers")
    if not np.isfinite(array).all():
        raise ModelError(f"{what} have entries that are NaN or infinite; leave these out")
    return array


def as_angles(value: npt.ArrayLike, what: str) -> Array:
    """The angles of beams, (B,), read-only."""
    array = as_floats(value, what)
    if array.ndim != 1 or not array.size:
        raise ModelError(f"{what} have shape {array.shape}; (beams,) was due, one or more")
    if not np.isfinite(array).all():
        raise ModelError(f"{what} are NaN or infinite at times; each beam needs its angle")
    return frozen(array.copy())


def as_positive(value: Any, what: str, error: type[PgmError] = ModelError) -> float:
    """A finite number above zero."""
    if not is_number(value) or not 0.0 < value < np.inf:
        raise error(f"{what} must be a number above 0, not {value!r}")
    return float(value)


def as_share(value: Any, what: str, *, least: bool = True) -> float:
    """A number of 0 to 1, zero itself where `least`."""
    if not is_number(value) or not 0.0 <= value <= 1.0 or (value == 0.0 and not least):
        lowest = "from 0" if least else "above 0"
        raise ModelError(f"{what} must be a number {lowest} to 1, not {value!r}")
    return float(value)


def as_mask(value: Any, shape: tuple[int, ...]) -> Mask:
    """A mask of cells."""
    array = np.asarray(value)
    if array.dtype != np.bool_ or array.shape != shape:
        raise ModelError(
            f"a mask of cells is an array of bools of shape {shape}, not of {array.dtype} and "
            f"shape {array.shape}"
        )
    return array


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
        """The cells that points lie in, (...).

        Parameters
        ----------
        points : array_like
            (..., 2): x and y [m].

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
        """The centres [m], (..., 2), of cells by their rows and columns, (...).

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
