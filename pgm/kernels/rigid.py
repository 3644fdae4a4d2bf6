"""Poses (x, y, heading) in the plane, headings in radians, and points in their frames.

The frame of a pose has its origin at the pose and its first axis along the heading.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array


def mounted(poses: Array, mount: Array) -> Array:
    """The poses (..., 3) of a sensor that each body, at `poses` (..., 3), carries.

    `mount` (3,) is the sensor's pose in the frame of a body.
    """
    return _stacked(turned(mount[:2], poses[..., 2]) + poses[..., :2], poses[..., 2] + mount[2])


def points_from(frame: Array, points: Array) -> Array:
    """The coordinates in the frame of a pose (3,) of points (..., 2) given in the world."""
    away = points - frame[:2]
    return away if frame[2] == 0.0 else turned(away, -frame[2])


def points_out_of(frame: Array, points: Array) -> Array:
    """Points (..., 2) in the world, from their coordinates (..., 2) in the frame of a pose (3,)."""
    along = points if frame[2] == 0.0 else turned(points, frame[2])
    return along + frame[:2]


def turned(points: Array, angle: Array | float) -> Array:
    """Points (..., 2), turned about the origin by angles (...)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def directions(angles: Array) -> Array:
    """The unit vectors (cos, sin) of angles (...), (..., 2)."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def _stacked(points: Array, headings: Array) -> Array:
    """Poses (..., 3) of points (..., 2) and headings (...)."""
    return np.concatenate([points, headings[..., None]], axis=-1)
