"""The floor plan of a house, as a grid of cells: P. Corke's, of Robotics, Vision and Control.

The package rtb-data of his Robotics Toolbox for Python carries it (rtbdata/data/house.mat).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.io import loadmat
from scipy.ndimage import label

from experiments import packaged
from pgm.errors import FileError

Array = npt.NDArray[np.float64]

MISSING = packaged.RTB_MISSING.format("the floor plan")
SHAPE = (397, 596)  # rows, from the lowest up, and columns
# Neither the file nor the package's documentation says how large a cell is [m]. It is taken from
# what was drawn: the bath's alcove is 33 or 34 cells long, the garage door 119 wide, and 124 with
# its frame; baths of 5 feet (1.524 m) and double doors of 18 (5.486 m) make 4.4 to 4.6 cm.
RESOLUTION = 0.045
# The outer walls' outline, as rectangles of cells: first and last row, first and last column.
OUTLINE = ((8, 268, 8, 365), (268, 310, 270, 365), (208, 268, 365, 421), (8, 240, 345, 588))
OUTDOORS = ("patio", "garden", "driveway")


@dataclass(frozen=True, eq=False)
class House:
    """A floor plan.

    Attributes
    ----------
    occupied : ndarray
        (rows, columns): the probability that a cell is, 0 or 1; row 0 is the lowest.
    resolution : float
        The width of a cell [m].
    origin : tuple of float
        The lower left corner of cell [0, 0], (0, 0) [m].
    places : dict of str to tuple of float
        East and north by name [m].
    indoors : ndarray of bool
        (rows, columns): the cells that a point can reach from the rooms without leaving the house.
    """

    occupied: Array
    resolution: float
    origin: tuple[float, float]
    places: dict[str, tuple[float, float]]
    indoors: npt.NDArray[np.bool_]


def find() -> Path | None:
    """The file inside the package rtb-data; None where that is not installed."""
    return packaged.find(packaged.RTB, "data/house.mat")


def load(path: Path | None = None) -> House:
    """Read the floor plan.

    Parameters
    ----------
    path : Path, optional
        The .mat file; that of rtb-data, if not given.

    Raises
    ------
    FileError
        If there is none, or it is not the floor plan.
    """
    path = path or find()
    if path is None:
        raise FileError(MISSING)
    plan, cells = _tables(path)
    # A place is the middle of the cell of its column and row.
    places = {
        name: (RESOLUTION * (column + 0.5), RESOLUTION * (row + 0.5))
        for name, (column, row) in cells.items()
    }
    return House(plan, RESOLUTION, (0.0, 0.0), places, _indoors(plan, cells))


def _indoors(plan: Array, cells: dict[str, tuple[int, int]]) -> npt.NDArray[np.bool_]:
    """The free cells within the outline that hang together with a room's place."""
    within = np.zeros(plan.shape, dtype=bool)
    for low, high, left, right in OUTLINE:
        within[low : high + 1, left : right + 1] = True
    parts, _ = label(within & (plan == 0.0))
    rooms = {int(parts[row, c]) for name, (c, row) in cells.items() if name not in OUTDOORS}
    found: npt.NDArray[np.bool_] = np.isin(parts, sorted(rooms - {0}))
    return found


def _tables(path: Path) -> tuple[Array, dict[str, tuple[int, int]]]:
    """The plan, and columns and rows of the places, checked."""
    try:
        data = loadmat(path)
    except Exception as error:  # of many kinds, as the damage is
        raise FileError(
            f"{path} cannot be read as a .mat file ({type(error).__name__}: {error}); fetch it "
            "again",
            path=str(path),
        ) from error
    lost = [key for key in ("floorplan", "places") if key not in data]
    if lost:
        raise _refused(path, f"no tables {lost}")
    plan, places = data["floorplan"], data["places"]
    if plan.shape != SHAPE or plan.dtype.kind not in "uif" or not np.isin(plan, (0, 1)).all():
        raise _refused(path, f"a floorplan of shape {plan.shape}; 0 and 1 in {SHAPE} were due")
    cells = {}
    for name in places.dtype.names or ():
        where = np.asarray(places[name].item()).reshape(-1)
        if where.shape != (2,) or where.dtype.kind not in "uif":
            raise _refused(path, f"{where} for the place {name}; a column and a row were due")
        column, row = (int(number) for number in where)
        if not (0 <= row < SHAPE[0] and 0 <= column < SHAPE[1]):
            raise _refused(path, f"the place {name} outside of the plan, at {column}, {row}")
        cells[name] = (column, row)
    if not cells:
        raise _refused(path, "no named places")
    return plan.astype(float), cells


def _refused(path: Path, found: str) -> FileError:
    return FileError(f"{path}: found {found}; is it the house's floor plan?", path=str(path))
