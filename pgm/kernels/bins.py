"""Bins of equal widths: the one that each point falls into, and the number of bins occupied."""

from __future__ import annotations

import math

import numpy as np

from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array, Integers, Mask

# Bins further from zero than this would not be told apart by float64.
_FARTHEST = 2.0**52


def keys(points: Array, widths: Array, angles: Mask) -> Integers | None:
    """The whole numbers (d, n) of the bins that n points (d, n) fall into along each of d axes.

    `widths` (d,) are the widths of the bins; on the axes that `angles` (d,) marks, they are changed
    so that a whole number of bins makes a turn. None if a point is 2⁵² bins or more from zero.
    """
    scaled = np.asarray(points, dtype=np.float64) / widths[:, None]
    for k in np.flatnonzero(angles):
        round_ = max(round(TURN / widths[k]), 1)
        scaled[k] = (points[k] % TURN) * (round_ / TURN)
        scaled[k] -= round_ * (scaled[k] >= round_)
    if not (np.abs(scaled) < _FARTHEST).all():
        return None
    return np.floor(scaled).astype(np.int64)


def occupied(bins: Integers) -> int:
    """The number of different bins among those of n draws, the columns of `bins` (d, n)."""
    low = bins.min(axis=1, keepdims=True)
    spans = [int(span) for span in (bins.max(axis=1) - low[:, 0] + 1)]
    if math.prod(spans) < 2**62:
        number = np.zeros(bins.shape[1], dtype=np.int64)
        for row, span in zip(bins - low, spans, strict=True):
            number = number * span + row
        return len(np.unique(number))
    return int(np.unique(bins, axis=1).shape[1])
