"""Occupancy grids from scans at known poses."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import expit, logit

from pgm.arguments import public
from pgm.boundary import as_floats, as_tuple, is_number, is_whole
from pgm.errors import ModelError
from pgm.kernels import rays, rigid
from pgm.kernels.arrays import Array, Mask
from pgm.maps.cells import as_angles, as_finite, as_pose, as_positive
from pgm.maps.occupancy import OccupancyMap
from pgm.resources import require_memory

# Beams that are traced at a time: the cells that they enter stay in a core's cache.
_BLOCK = 2**12


class _Beams(NamedTuple):
    """Beams in a frame of the map: where they begin and end (2, n), and whether they hit."""

    begins: Array
    ends: Array
    hits: Mask


@public
def log_odds_map(
    poses: npt.ArrayLike,
    scans: npt.ArrayLike,
    angles: npt.ArrayLike,
    *,
    resolution: float,
    most: float,
    hit: float = 0.7,
    miss: float = 0.4,
    prior: float = 0.5,
    mount: npt.ArrayLike = (0.0, 0.0, 0.0),
    origin: npt.ArrayLike | None = None,
    shape: tuple[int, int] | None = None,
) -> OccupancyMap:
    r"""An occupancy grid from scans at known poses.

    Cells are independent, and beams given the map: the log-odds of a cell are

    .. math:: \ln\frac{p}{1-p} = l_0 + n_{hit}\,(l_{hit} - l_0) + n_{miss}\,(l_{miss} - l_0),
        \quad l = \ln\frac{p}{1-p}\text{ of each,}

    with the number of beams that end in the cell, and of those that pass through it. Beams of
    `most` or more end nowhere, and clear the cells up to `most`; those that are NaN are left out.
    Cells that no beam has entered are NaN, unknown.

    Parameters
    ----------
    poses : array_like
        (n, 3): x, y [m] and heading [rad] of the robot at each scan.
    scans : array_like
        (n, B): ranges [m], 0 or more; infinite ones are beyond `most`.
    angles : array_like
        (B,): of the beams against the sensor's heading [rad].
    resolution : float
        The side of a cell [m].
    most : float
        The largest range [m].
    hit, miss : float
        The probability that a cell is occupied in which a beam ends, and through which one passes.
    prior : float
        The probability that a cell is occupied of which nothing is known, between these.
    mount : array_like
        (3,): the sensor's pose in the robot's frame.
    origin : array_like, optional
        (x, y, yaw) of the map's lower left corner; without, the map is not turned and just holds
        the beams, its corner at a multiple of the resolution.
    shape : (int, int), optional
        Rows and columns; without, as many as hold the beams. What lies outside is left out.

    Raises
    ------
    ModelError
        If an argument does not fit, no beam was measured, or the map would not fit into memory.

    References
    ----------
    H. Moravec, A. Elfes: High resolution maps from wide angle sonar, 1985. S. Thrun, W. Burgard,
    D. Fox: Probabilistic Robotics, 2005, section 9.2.

    Examples
    --------
    >>> corridor = log_odds_map([[0.5, 0.5, 0.0]], [[3.0]], [0.0], resolution=1.0, most=10.0)
    >>> corridor.occupied.round(2)
    array([[0.4, 0.4, 0.4, 0.7]])
    """
    resolution, most = as_positive(resolution, "resolution"), as_positive(most, "most")
    odds = _log_odds(hit, miss, prior)
    corner = None if origin is None else as_pose(origin, "the map's origin")
    limits = None if shape is None else _as_shape(shape)
    beams = _traced(poses, scans, angles, most, as_pose(mount, "mount"))
    frame = np.zeros(3) if corner is None else corner
    with np.errstate(over="ignore"):  # refused below
        begins, ends = (rigid.points_from(frame, each) / resolution for each in beams[:2])
    # All cells are counted, and then those that are wanted taken.
    low = np.floor(np.minimum(begins.min(axis=0), ends.min(axis=0)))
    high = np.floor(np.maximum(begins.max(axis=0), ends.max(axis=0)))
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise ModelError(f"poses are so far off that cells of {resolution} m cannot be counted")
    width, height = (high - low + 1.0).tolist()
    _require_room(height, width, "which holds all beams")
    counts = _counted(_Beams((begins - low).T, (ends - low).T, beams.hits), int(height), int(width))
    log_odds = odds[0] + counts[0] * (odds[1] - odds[0]) + counts[1] * (odds[2] - odds[0])
    occupied = np.where(counts.any(axis=0), expit(log_odds), np.nan)
    if corner is None:
        corner = np.array([*(low * resolution), 0.0])
        low, high = np.zeros(2), high - low
    if limits is None:
        columns, rows = np.maximum(high + 1.0, 0.0).tolist()
        limits = int(rows), int(columns)
    _require_room(*limits, "from its origin on")
    occupied = _placed(occupied, low, limits)
    if not occupied.size:
        raise ModelError("no beam enters the map, which lies elsewhere; give another origin")
    return OccupancyMap(occupied, resolution, corner)


def _log_odds(hit: float, miss: float, prior: float) -> Array:
    given = {"hit": hit, "miss": miss, "prior": prior}
    for name, value in given.items():
        if not is_number(value) or not 0.0 < value < 1.0:
            raise ModelError(f"{name} must be a probability between 0 and 1, not {value!r}")
    if not miss <= prior <= hit:
        raise ModelError(f"{given}: the prior must not be above hit nor below miss")
    return np.asarray(logit([prior, hit, miss]))


def _as_shape(shape: tuple[int, int]) -> tuple[int, int]:
    found = as_tuple(shape)
    if found is None or len(found) != 2 or not all(is_whole(n) and n > 0 for n in found):
        raise ModelError(f"shape is two whole numbers above 0, rows and columns, not {shape!r}")
    return int(found[0]), int(found[1])


def _traced(
    poses: npt.ArrayLike, scans: npt.ArrayLike, angles: npt.ArrayLike, most: float, mount: Array
) -> _Beams:
    """All measured beams, in metres, (n, 2)."""
    places = as_finite(poses, "poses", 3)
    turns = as_angles(angles, "the angles of beams")
    ranges = as_floats(scans, "scans", missing=True)
    if places.ndim != 2 or ranges.shape != (len(places), turns.size):
        raise ModelError(
            f"scans have shape {ranges.shape}, poses {places.shape} and angles {turns.shape}; "
            "(n, beams), (n, 3) and (beams,) were due"
        )
    if (ranges < 0.0).any():
        raise ModelError("scans have ranges below 0; a beam that was not measured is NaN")
    measured = ~np.isnan(ranges)
    if not measured.any():
        raise ModelError("scans have no beam that was measured; a map needs some")
    require_memory(ranges.size * 8, "the beams of all scans", "give some of the scans")
    sensors = rigid.mounted(places, mount)
    units = rigid.directions(sensors[:, None, 2] + turns)
    ends = sensors[:, None, :2] + units * np.minimum(ranges, most)[..., None]
    begins = np.broadcast_to(sensors[:, None, :2], ends.shape)
    return _Beams(begins[measured], ends[measured], (ranges < most)[measured])


def _counted(beams: _Beams, height: int, width: int) -> Array:
    """For each cell, how many beams end in it and how many pass through, (2, height, width)."""
    entered = np.zeros(height * width)
    for first in range(0, beams.begins.shape[1], _BLOCK):
        place = slice(first, first + _BLOCK)
        cells = rays.entered(beams.begins[:, place], beams.ends[:, place], width)
        least = int(cells.min())
        counts = np.bincount(cells - least)
        entered[least : least + counts.size] += counts
    columns, rows = np.floor(beams.ends[:, beams.hits]).astype(np.intp)
    ended = np.bincount(rows * width + columns, minlength=height * width).astype(np.float64)
    # Each beam enters the cell in which it ends once, but for rounding at a corner.
    passed = np.maximum(entered - ended, 0.0)
    return np.stack([ended, passed]).reshape(2, height, width)


def _placed(occupied: Array, low: Array, shape: tuple[int, int]) -> Array:
    """The cells of rows and columns from zero on, of ones that begin elsewhere; others unknown."""
    found = np.full(shape, np.nan)
    own, given = list[slice](), list[slice]()
    for first, count, due in zip(low[::-1].tolist(), occupied.shape, shape, strict=True):
        start, skipped = int(min(max(first, 0.0), due)), int(min(max(-first, 0.0), count))
        length = max(min(due - start, count - skipped), 0)
        own.append(slice(start, start + length))
        given.append(slice(skipped, skipped + length))
    found[tuple(own)] = occupied[tuple(given)]
    return found


def _require_room(height: float, width: float, which: str) -> None:
    require_memory(
        int(min(height * width, 1e300)) * 4,
        f"a map of {height:.0f} by {width:.0f} cells, {which},",
        "give a larger resolution, or look for poses that are far off",
    )
