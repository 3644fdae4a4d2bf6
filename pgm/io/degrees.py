"""Degrees recognised where radians are due, as far as numbers tell."""

from __future__ import annotations

import numpy as np

from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array

# A wrapped angle is less than a turn, up to the decimals that it was printed with.
_WRAPPED = 1.01 * TURN
_CIRCLE, _HALF = 361.0, 180.0
# Three turns a second [rad/s], more than robots and sensors in hands turn.
_FASTEST = 3.0 * TURN


def seem_degrees(angles: Array) -> bool:
    """Whether angles (n,), in the order of time, can hardly be radians.

    Radians are wrapped, and then within a turn, or follow each other without jumps. Degrees go
    beyond, but within 360, and where they are wrapped jump by more than 180 between rows, which is
    28 turns in radians.
    """
    known = angles[np.isfinite(angles)]
    jump = np.abs(np.diff(known)).max(initial=0.0)
    return beyond_a_turn(known) and bool(np.abs(known).max() <= _CIRCLE and jump > _HALF)


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
