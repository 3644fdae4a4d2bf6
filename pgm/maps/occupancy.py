"""Occupancy grids: where there are obstacles, where there are none, and where nothing is known."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from os import PathLike

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt, label

from pgm.arguments import public
from pgm.boundary import as_floats, is_whole
from pgm.display import InCode
from pgm.errors import FileError, ModelError
from pgm.kernels import rays, rigid
from pgm.kernels.arrays import Array, Mask, frozen
from pgm.maps import files
from pgm.maps.cells import CellGrid, as_angles, as_finite, as_mask, as_pose, as_positive, as_share
from pgm.maps.files import FREE, OCCUPIED
from pgm.maps.uniform import UniformPose
from pgm.resources import require_memory
from pgm.variables import Variable


@public
class OccupancyMap(InCode, CellGrid):
    r"""A grid of cells with the probability that each is occupied; an immutable value.

    The cell in row i and column j is the square from (j, i) to (j + 1, i + 1), times the
    resolution, in the map's own frame, which is turned by yaw and moved to (x, y):

    .. math:: p = \begin{pmatrix} x \\ y \end{pmatrix} + R(\mathrm{yaw})\, r
        \begin{pmatrix} j + ½ \\ i + ½ \end{pmatrix}\quad\text{is its centre.}

    Parameters
    ----------
    occupied : array_like
        (rows, columns): probabilities, row 0 at the lowest y; NaN where nothing is known.
    resolution : float
        r, the side of a cell [m].
    origin : array_like
        (x [m], y [m], yaw [rad]) of the lower left corner of the cell in row 0 and column 0.
    free_threshold, occupied_threshold : float
        Cells of a lower probability than the first are free, of a higher one than the second
        obstacles; the defaults are those of ROS.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns.

    Raises
    ------
    ModelError
        If an array has a wrong shape, or is no probability; the resolution is not above 0, the
        origin not finite, or the thresholds are not in order.

    References
    ----------
    H. Moravec, A. Elfes: High resolution maps from wide angle sonar, 1985.

    Examples
    --------
    >>> room = OccupancyMap([[1, 1, 1], [0, 0, 1], [np.nan, 0, 1]], resolution=0.5)
    >>> room.free.astype(int)
    array([[0, 0, 0],
           [1, 1, 0],
           [0, 1, 0]])
    >>> room.cast([0.25, 0.75, 0.0], angles=[0.0], most=5.0)
    array([0.75])
    """

    occupied: Array
    free_threshold: float
    occupied_threshold: float

    def __init__(
        self,
        occupied: npt.ArrayLike,
        resolution: float,
        origin: npt.ArrayLike = (0.0, 0.0, 0.0),
        *,
        free_threshold: float = FREE,
        occupied_threshold: float = OCCUPIED,
    ) -> None:
        array = as_floats(occupied, "the map's occupied", missing=True)
        if array.ndim != 2 or not array.size:
            raise ModelError(
                f"the map's occupied has shape {array.shape}; (rows, columns) was due, one or more"
            )
        wrong = ~(np.isnan(array) | ((array >= 0.0) & (array <= 1.0)))
        if wrong.any():
            row, column = np.argwhere(wrong)[0].tolist()
            raise ModelError(
                f"the map's occupied is {array[row, column]} in row {row}, column {column}; "
                "probabilities are from 0 to 1, and NaN where nothing is known"
            )
        free = as_share(free_threshold, "the map's free_threshold")
        above = as_share(occupied_threshold, "the map's occupied_threshold")
        if free > above:
            raise ModelError(
                f"the map's free_threshold, {free}, lies above its occupied_threshold, {above}; a "
                "cell would be both"
            )
        self._set(
            occupied=frozen(array.copy()),
            shape=array.shape,
            resolution=as_positive(resolution, "the map's resolution"),
            origin=as_pose(origin, "the map's origin"),
            free_threshold=free,
            occupied_threshold=above,
        )

    @classmethod
    def read(cls, path: str | PathLike[str]) -> OccupancyMap:
        """Read a map of ROS's map_server: a YAML file, and the image that it names.

        The keys are image, resolution, origin, negate, occupied_thresh and free_thresh, and mode
        if it is not trinary. A grey value g of 0 to 255 means p = 1 − g/255, or g/255 where
        `negate`. By mode:

        - trinary: p above occupied_thresh is 1, p below free_thresh 0, and NaN between.
        - scale: the same, but (p − free) / (occupied − free) between; transparent pixels are NaN.
        - raw: g itself in percent, 0 to 100; NaN above.

        Parameters
        ----------
        path : path
            Path of the YAML file, whose thresholds the map has. The image, PGM (P2 or P5) or PNG,
            is found from its folder.

        Raises
        ------
        FileError
            If a file is missing or cannot be read, a key is missing or wrong, or the image is in
            colour or of more than eight bits.
        """
        found = files.read(path)
        try:
            return cls(
                found.occupied,
                found.resolution,
                found.origin,
                free_threshold=found.free,
                occupied_threshold=found.above,
            )
        except ModelError as error:
            raise FileError(f"{path}: {error}", path=str(path)) from error

    @public
    def write(self, path: str | PathLike[str], *, image: str = ".pgm") -> None:
        """Write the map as YAML and image, which ROS's map_server and `read` take (trinary).

        Probabilities are lost: cells are free, obstacles or unknown, and what is read again is 0, 1
        or NaN. So are the thresholds, which are written as .196 and .65.

        Parameters
        ----------
        path : path
            Path of the YAML file; the image lies beside it, by the same name.
        image : str
            ".pgm" or ".png".

        Raises
        ------
        FileError
            If the image is to be of another kind, or a file cannot be written.
        """
        grey = np.full(self.shape, files.UNKNOWN_GREY, dtype=np.uint8)
        grey[self.free], grey[self.obstacles] = files.FREE_GREY, files.OCCUPIED_GREY
        files.write(path, grey, self.resolution, self.origin, image)

    @cached_property
    def free(self) -> Mask:
        """The mask of cells less likely occupied than `free_threshold`, (rows, columns)."""
        return _closed(self.occupied < self.free_threshold)

    @cached_property
    def obstacles(self) -> Mask:
        """The mask of cells likelier occupied than `occupied_threshold`, (rows, columns)."""
        return _closed(self.occupied > self.occupied_threshold)

    @cached_property
    def unknown(self) -> Mask:
        """The mask of cells that are neither free nor obstacles, (rows, columns)."""
        return _closed(~(self.free | self.obstacles))

    @cached_property
    def distances(self) -> Array:
        """The distance [m] from each cell's centre to the nearest obstacle's centre.

        Raises
        ------
        ModelError
            If the map has no obstacle.
        """
        self._require_obstacle()
        found: Array = distance_transform_edt(~self.obstacles, sampling=self.resolution)
        return frozen(found)

    @public
    def poses(self, spacing: float, headings: int, mask: npt.ArrayLike | None = None) -> Array:
        """A coarse grid of poses: places in free cells, each with all headings.

        Parameters
        ----------
        spacing : float
            Between places along both axes of the map's frame [m].
        headings : int
            How many, over the full turn from −π on.
        mask : array_like of bool, optional
            (rows, columns): which of the free cells are taken; all without.

        Returns
        -------
        ndarray
            (n, 3): x, y [m] and heading [rad], that of the places fastest.

        Raises
        ------
        ModelError
            If an argument does not fit, the poses would not fit into memory, or no place is free.
        """
        spacing = as_positive(spacing, "the spacing of poses")
        if not is_whole(headings) or headings < 1:
            raise ModelError(f"headings are a whole number, 1 or more, not {headings!r}")
        allowed = self._allowed(mask)
        places = self._places(spacing, allowed)
        if not len(places):
            raise ModelError(
                f"none of the places {spacing} m apart is in a free cell; set them closer"
            )
        require_memory(len(places) * int(headings) * 3, "poses", "set them further apart")
        turns = -np.pi + 2.0 * np.pi * np.arange(headings) / headings
        found = np.empty((len(places), len(turns), 3))
        found[..., :2], found[..., 2] = places[:, None], turns
        return found.reshape(-1, 3)

    def connected(self, point: npt.ArrayLike) -> Mask:
        """The mask (rows, columns) of free cells that a path over shared edges joins to a point.

        Around a mapped building much is free that a robot cannot get to; this mask tells.

        Parameters
        ----------
        point : array_like
            (2,): x and y [m].

        Raises
        ------
        ModelError
            If the point is not in a free cell.
        """
        point = as_finite(point, "the point's coordinates", 2)
        cell = self.at(point)
        if point.ndim != 1 or not cell.inside or not self.free[cell.rows, cell.columns]:
            raise ModelError(f"the point {point.tolist()} is not in a free cell of {self!r}")
        parts, _ = label(self.free)
        return np.asarray(parts == parts[cell.rows, cell.columns])

    @public
    def uniform(self, pose: Variable, mask: npt.ArrayLike | None = None) -> UniformPose:
        """The prior of a pose that may be anywhere in free cells, at any heading.

        Parameters
        ----------
        pose : Variable
            Its components are x, y and a heading, an angle.
        mask : array_like of bool, optional
            (rows, columns): which of the free cells are taken, as `connected` tells; all without.

        Raises
        ------
        ModelError
            If the variable or the mask does not fit, or no cell is left.
        """
        return UniformPose(pose, self, mask)

    @public
    def cast(
        self,
        poses: npt.ArrayLike,
        angles: npt.ArrayLike,
        most: float,
        *,
        through_unknown: bool = True,
    ) -> Array:
        r"""How far beams get from poses before they enter an obstacle's cell, (..., B) [m].

        The distances are exact for the grid, to rounding: 0 in an obstacle, and `most` where there
        is none up to there.

        Parameters
        ----------
        poses : array_like
            (..., 3): x, y [m], heading [rad]; they may lie outside of the map.
        angles : array_like
            (B,): of the beams, against the heading [rad].
        most : float
            The largest distance [m].
        through_unknown : bool
            Whether beams pass unknown cells, since nothing is known to be there; else these stop
            them as obstacles do, as in ROS's AMCL. The map's outside stops none.

        Raises
        ------
        ModelError
            If an argument does not fit.
        """
        array = as_finite(poses, "poses", 3)
        beams = as_angles(angles, "the angles of beams")
        most = as_positive(most, "the largest distance, most,")
        require_memory(
            array.size // 3 * beams.size * 8, "the beams of all poses", "cast fewer at a time"
        )
        found = self._cast(array.reshape(-1, 3), beams, most, through_unknown)
        return found.reshape(*array.shape[:-1], beams.size)

    def _cast(self, poses: Array, angles: Array, most: float, through_unknown: bool) -> Array:
        """The distances (n, B) of checked poses (n, 3)."""
        clear = self._clear if through_unknown else self._known_clear
        found = np.empty((len(poses), angles.size))
        for place in blocks(len(poses), angles.size):
            part = poses[place]
            points = np.repeat(self._to_cells(part[:, :2]), angles.size, axis=0).T
            turns = (part[:, 2] - self.origin[2])[:, None] + angles
            units = rigid.directions(turns.ravel()).T
            reach = rays.cast(clear, points, units, most / self.resolution)
            found[place] = np.minimum(reach * self.resolution, most).reshape(turns.shape)
        return found

    def _allowed(self, mask: npt.ArrayLike | None) -> Mask:
        allowed = self.free if mask is None else self.free & as_mask(mask, self.shape)
        if not allowed.any():
            found = "has no free cell" if mask is None else "has no free cell within the mask"
            raise ModelError(f"{self!r} {found}")
        return allowed

    def _require_obstacle(self) -> None:
        if not self.obstacles.any():
            raise ModelError(
                f"{self!r} has no obstacle: no cell is likelier than {self.occupied_threshold}, "
                "and there is nothing to be at a distance of"
            )

    @cached_property
    def _clear(self) -> rays.Cells:
        return rays.clearances(self.obstacles)

    @cached_property
    def _known_clear(self) -> rays.Cells:
        return rays.clearances(~self.free)

    def __repr__(self) -> str:
        rows, columns = self.shape
        x, y, yaw = self.origin.tolist()
        turned = f", yaw {yaw:g}" if yaw else ""
        return (
            f"OccupancyMap({rows} rows, {columns} columns of {self.resolution:g} m from "
            f"({x:g}, {y:g}){turned})"
        )


def blocks(count: int, beams: int) -> Iterator[slice]:
    """Poses that are worked on together, so that their rays' arrays stay in a core's cache."""
    size = max(rays.RAYS // beams, 1)
    for first in range(0, count, size):
        yield slice(first, min(first + size, count))


def _closed(mask: Mask) -> Mask:
    mask.flags.writeable = False
    return mask
