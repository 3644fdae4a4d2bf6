"""Checks of what maps and their sensors are given."""

from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats, is_number
from pgm.errors import ModelError, PgmError
from pgm.kernels.arrays import Array, Mask, frozen


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
