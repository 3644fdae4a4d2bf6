"""Degrees recognised where radians are due, as far as numbers tell."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array

# A wrapped angle is less than a turn, up to the decimals that it was printed with.
_WRAPPED = 1.01 * TURN
_CIRCLE, _HALF = 361.0, 180.0
# Three turns a second [rad/s], more than robots and sensors in hands turn.
_FASTEST = 3.0 * TURN


def seem_degrees(angles: Array) -> bool:
    """Whether angles (..., n), in the order of time along the last axis, can hardly be radians.

    Radians are wrapped, and then within a turn, or follow each other without jumps. Degrees go
    beyond, but within 360, and where they are wrapped jump by more than 180 between rows, which is
    28 turns in radians.
    """
    if angles.shape[-1] < 2 or not angles.size:
        return False
    low, high = np.fmin.reduce(angles, axis=None), np.fmax.reduce(angles, axis=None)
    if not (max(high, -low) <= _CIRCLE and high - low > _HALF):
        return False
    if angles.ndim == 1:
        angles = angles[np.isfinite(angles)]
    return bool(np.fmax.reduce(np.abs(np.diff(angles)), axis=None) > _HALF)


def in_degrees(table: Array, names: Sequence[str], angles: Collection[str]) -> str | None:
    """The fault of the first angle among columns (..., n, d) that `seem_degrees`, in words."""
    for k, name in enumerate(names):
        if name in angles and seem_degrees(column := table[..., k]):
            most = np.nanmax(np.abs(column))
            return (
                f"the angle {name!r} goes to {most:.4g} rad and jumps; it seems to be in degrees: "
                "np.radians(degrees) makes radians"
            )
    return None


def beyond_a_turn(angles: Array) -> bool:
    """Whether angles (n,) go beyond a turn."""
    return bool((np.abs(angles) > _WRAPPED).any())


def too_fast(rates: Array) -> bool:
    """Whether turn rates (n,) [rad/s] go beyond three turns a second."""
    return bool((np.abs(rates) > _FASTEST).any())


def seem_headings_in_degrees(stamps: Array, headings: Array) -> bool:
    """Whether headings (n,) go beyond a turn though they begin there, or turn `too_fast`.

    Headings in radians that are not wrapped begin within a turn, and go on steadily from there.
    """
    known = np.isfinite(headings)
    order = np.argsort(stamps[known], kind="stable")
    when, found = stamps[known][order], headings[known][order]
    if not beyond_a_turn(found):
        return False
    turned, lasted = np.abs(np.diff(found)), np.diff(when)
    turned = np.minimum(turned, np.abs(turned - TURN))  # of a heading that is wrapped after all
    rates = turned[lasted > 0.0] / lasted[lasted > 0.0]
    return beyond_a_turn(found[:1]) or too_fast(rates)
