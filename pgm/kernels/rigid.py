"""Rigid motions: poses (x, y, heading), motions (forward, left, turn) in the plane; quaternions.

A steady motion, with twist τ = (v, w, φ) over its whole time, has after the share s of it made

    [forward; left] = s sinc(s φ / 2) R(s φ / 2) [v; w],    turn = s φ,

where sinc a = sin a / a and R is a rotation. Unit quaternions (x, y, z, w) of rotations and their
angles, roll, pitch and yaw, stand on the last axis: about x, then y, then z, axes that stay where
they are, so that R = R_z(yaw) R_y(pitch) R_x(roll).
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import TURN, Array, Integers, wrap


def mounted(poses: Array, mount: Array) -> Array:
    """The poses (..., 3) of what is mounted on bodies, at a pose (3,) in their frame."""
    return _stacked(turned(mount[:2], poses[..., 2]) + poses[..., :2], poses[..., 2] + mount[2])


def points_from(frame: Array, points: Array) -> Array:
    """Points (..., 2) in the frame of a pose (3,)."""
    away = points - frame[:2]
    return away if frame[2] == 0.0 else turned(away, -frame[2])


def points_out_of(frame: Array, points: Array) -> Array:
    """Points (..., 2), given in the frame of a pose (3,), in the frame of that pose."""
    along = points if frame[2] == 0.0 else turned(points, frame[2])
    return along + frame[:2]


def turned(points: Array, angle: Array | float) -> Array:
    """Points (..., 2), turned about the origin by angles (...)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def directions(angles: Array) -> Array:
    """The unit vectors of angles (...), (..., 2)."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def _stacked(points: Array, headings: Array) -> Array:
    return np.concatenate([points, headings[..., None]], axis=-1)


# Whole turns have no arc that ends elsewhere; of turns nearer to one it would be huge.
WHOLE = TURN * (1.0 - 1e-6)


def motions(twists: Array, share: Array | float = 1.0) -> Array:
    """The motions (..., 3) that shares of steady ones, with twists (..., 3), are."""
    half = 0.5 * share * twists[..., 2]
    chord = turned(twists[..., :2], half) * (share * _sinc(half))[..., None]
    return np.concatenate([chord, np.asarray(share * twists[..., 2])[..., None]], axis=-1)


def twists(steady: Array) -> Array:
    """The twists (..., 3) of steady motions (..., 3) that turn by less than `WHOLE`."""
    half = 0.5 * steady[..., 2]
    chord = turned(steady[..., :2], -half) / _sinc(half)[..., None]
    return np.concatenate([chord, steady[..., 2:]], axis=-1)


def composed(parts: Array, first: Integers) -> Array:
    """The motions (m, 3) of rows of parts (n, 3), each beginning at its place in `first`."""
    after = np.cumsum(parts[:, 2])
    before = after - parts[:, 2]
    counts = np.diff(first, append=len(parts))
    facing = before - np.repeat(before[first], counts)
    steps = np.concatenate([turned(parts[:, :2], facing), parts[:, 2:]], axis=1)
    return np.add.reduceat(steps, first)


def path(start: Array, parts: Array) -> Array:
    """The poses (n + 1, 3) from a start (3,) on, motion (n, 3) after motion."""
    headings = start[2] + np.concatenate([[0.0], np.cumsum(parts[:, 2])])
    steps = np.cumsum(turned(parts[:, :2], headings[:-1]), axis=0)
    return np.column_stack([np.concatenate([start[None, :2], start[:2] + steps]), headings])


def between(poses: Array) -> Array:
    """The motions (n − 1, 3) from each pose (n, 3) to the next, turning by half a turn at most."""
    away = np.diff(poses, axis=0)
    return np.column_stack([turned(away[:, :2], -poses[:-1, 2]), wrap(away[:, 2])])


def inverse(motions: Array) -> tuple[Array, Array]:
    """The motions (n, 3) back, and their derivatives by those there, (n, 3, 3)."""
    ahead, left = turned(-motions[:, :2], -motions[:, 2]).T
    slope = np.zeros((len(motions), 3, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = -np.cos(motions[:, 2])
    slope[:, 1, 0] = np.sin(motions[:, 2])
    slope[:, 0, 1] = -slope[:, 1, 0]
    slope[:, 0, 2], slope[:, 1, 2], slope[:, 2, 2] = left, -ahead, -1.0
    return np.column_stack([ahead, left, -motions[:, 2]]), slope


def _sinc(angle: Array) -> Array:
    found: Array = np.sinc(angle / np.pi)
    return found


# The cosine of a pitch at which roll and yaw are about one axis, but for rounding.
_UPRIGHT = 1e-12


def of_angles(angles: Array) -> Array:
    """The quaternions of angles, (..., 4); w is not negative where roll and pitch are zero."""
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
    """Roll and yaw in [−π, π), pitch in [−π/2, π/2]; straight up or down roll is put into yaw."""
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    east, north = 1.0 - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y)  # of the body's x axis
    level = np.hypot(east, north)
    pitch = np.arctan2(2.0 * (w * y - x * z), level)
    upright = level < _UPRIGHT
    roll = np.where(upright, 0.0, np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)))
    yaw = np.where(upright, 2.0 * np.arctan2(z, w), np.arctan2(north, east))
    return np.stack([wrap(roll), pitch, wrap(yaw)], axis=-1)
