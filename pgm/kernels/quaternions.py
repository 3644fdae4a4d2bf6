"""Unit quaternions (x, y, z, w) of rotations in space, and their angles roll, pitch and yaw.

The components of a quaternion, and the three angles, are along the last axis of arrays. The angles
turn about x, then y, then z, axes that do not turn with the body, so that the rotation matrix is
R = R_z(yaw) R_y(pitch) R_x(roll).
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.angles import wrap
from pgm.kernels.arrays import Array

# The cosine of a pitch at which roll and yaw are about one axis, but for rounding.
_UPRIGHT = 1e-12


def of_angles(angles: Array) -> Array:
    """The quaternions (..., 4) of roll, pitch and yaw (..., 3), in radians.

    Of the two quaternions ±q of a rotation, the result is the one computed from the angles wrapped
    to [−π, π): its w is not negative where roll and pitch are zero.
    """
    a, b, c = np.moveaxis(np.sin(0.5 * wrap(angles)), -1, 0)
    u, v, w = np.moveaxis(np.cos(0.5 * wrap(angles)), -1, 0)
    return np.stack(
        [
            a * v * w - u * b * c,
            u * b * w + a * v * c,
            u * v * c - a * b * w,
            u * v * w + a * b * c,
        ],
        axis=-1,
    )


def angles(quaternion: Array) -> Array:
    """The roll, pitch and yaw (..., 3) of unit quaternions (..., 4), in radians.

    Roll and yaw are in [−π, π), pitch in [−π/2, π/2]. Where the body's x axis points straight up or
    down, only yaw − roll or yaw + roll is known: roll is then set to zero, and yaw to this angle.
    """
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    east, north = 1.0 - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y)  # of the body's x axis
    level = np.hypot(east, north)
    pitch = np.arctan2(2.0 * (w * y - x * z), level)
    upright = level < _UPRIGHT
    roll = np.where(upright, 0.0, np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)))
    yaw = np.where(upright, 2.0 * np.arctan2(z, w), np.arctan2(north, east))
    return np.stack([wrap(roll), pitch, wrap(yaw)], axis=-1)
