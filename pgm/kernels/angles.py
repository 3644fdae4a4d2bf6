"""Angles in radians: wrapping to [−π, π), differences, and the branch nearest a reference."""

from __future__ import annotations

import numpy as np

from pgm.kernels import step
from pgm.kernels.arrays import Array, Index, Integers, Mask

TURN = step.TURN


def wrap(angle: Array) -> Array:
    """The angles, of any shape, moved by whole turns into [−π, π)."""
    wrapped = angle - TURN * np.floor((angle + np.pi) / TURN)  # a remainder takes thrice as long
    # Rounding can pass either end by a last digit.
    return np.where((wrapped < -np.pi) | (wrapped >= np.pi), -np.pi, wrapped)


def difference(a: Array, b: Array, angles: Mask) -> Array:
    """The difference a − b, (..., d), wrapped to [−π, π) in the components that are angles.

    `angles` (d,) marks these components.
    """
    delta = np.asarray(a - b)
    places = np.flatnonzero(angles)
    if places.size:
        of = _evenly(places)
        delta[..., of] = wrap(delta[..., of])
    return delta


def _evenly(places: Integers) -> Index:
    """Places as a slice, which takes a view, if they are evenly apart."""
    first, last = int(places[0]), int(places[-1])
    step = (last - first) // (places.size - 1) if places.size > 1 else 1
    even = places.size < 3 or bool((np.diff(places) == step).all())
    return slice(first, last + 1, step) if even else places


def nearest_branch(value: Array, reference: Array, angles: Mask) -> Array:
    """The vectors `value` (..., d), with angles moved by whole turns to within π of `reference`.

    `angles` (d,) marks the components that are angles; other components stay as they are. The
    reference is (..., d) and broadcasts with the value.
    """
    places = np.flatnonzero(angles)
    if not places.size:
        return value
    shape = value.shape
    if shape != reference.shape:  # which are broadcast in as long a time as all the rest takes
        shape = np.broadcast_shapes(shape, reference.shape)
    moved = np.empty_like(reference, shape=shape)  # in memory as the reference is
    moved[...] = value
    for k in places:
        moved[..., k] = step.nearest(moved[..., k], reference[..., k])
    return moved
