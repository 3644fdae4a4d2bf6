"""Straight lines between points, on arrays."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array


def distances(points: Array, start: Array, end: Array) -> Array:
    """Distances of points (P, 2) from segments (E, 2) to (E, 2), as (E, P)."""
    along = (end - start)[:, None]
    offset = points - start[:, None]
    square = np.maximum((along * along).sum(axis=-1), 1e-12)
    part = np.clip((offset * along).sum(axis=-1) / square, 0.0, 1.0)
    distance: Array = np.linalg.norm(offset - part[..., None] * along, axis=-1)
    return distance


def crossings(start: Array, end: Array) -> int:
    """The number of pairs of segments that cross; a shared end is no crossing."""

    def side(point: Array) -> Array:
        """On which side of each segment points lie, (E, E)."""
        along, offset = (end - start)[:, None], point - start[:, None]
        turn: Array = along[..., 0] * offset[..., 1] - along[..., 1] * offset[..., 0]
        return np.sign(np.round(turn, 6))

    apart = side(start) * side(end) < 0
    return int((apart & apart.T).sum()) // 2
