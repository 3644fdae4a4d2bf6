"""Angles, in radians."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array, Mask

TURN = 2.0 * np.pi


def wrap(angle: Array) -> Array:
    """The equal angle in [−π, π)."""
    wrapped = (angle + np.pi) % TURN - np.pi
    # Just below −π the remainder rounds to a whole turn.
    return np.where(wrapped >= np.pi, -np.pi, wrapped)


def difference(a: Array, b: Array, angles: Mask) -> Array:
    """The difference a − b, (..., d), with the components that are angles wrapped to [−π, π)."""
    delta = np.asarray(a - b)
    if angles.any():
        delta[..., angles] = wrap(delta[..., angles])
    return delta


def nearest_branch(value: Array, reference: Array, angles: Mask) -> Array:
    """The value, (..., d), its angles moved by whole turns to within π of the reference's."""
    if not angles.any():
        return value
    moved = np.array(np.broadcast_to(value, np.broadcast_shapes(value.shape, reference.shape)))
    turns = np.round((reference[..., angles] - moved[..., angles]) / TURN)
    moved[..., angles] += TURN * turns
    return moved
