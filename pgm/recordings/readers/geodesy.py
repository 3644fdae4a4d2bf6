"""Latitudes and longitudes on the ellipsoid of WGS 84, as metres in the plane of the first."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array

# Semi-major axis [m] and flattening of WGS 84.
RADIUS, FLATTENING = 6_378_137.0, 1.0 / 298.257223563
_SQUARED = FLATTENING * (2.0 - FLATTENING)  # of the eccentricity


def local(world: Array, height: Array) -> Array:
    """East, north and up, (n, 3) [m], from the first of latitudes and longitudes, (n, 2) [rad]."""
    sin, cos = np.sin(world), np.cos(world)
    away = _cartesian(sin, cos, height)
    away -= away[0]
    (sin_lat, sin_lon), (cos_lat, cos_lon) = sin[0], cos[0]
    axes = np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )
    found: Array = away @ axes.T
    return found


def _cartesian(sin: Array, cos: Array, height: Array) -> Array:
    """Coordinates that turn with the earth, of sines and cosines of latitude and longitude."""
    normal = RADIUS / np.sqrt(1.0 - _SQUARED * sin[:, 0] ** 2)
    level = (normal + height) * cos[:, 0]
    up = (normal * (1.0 - _SQUARED) + height) * sin[:, 0]
    return np.column_stack([level * cos[:, 1], level * sin[:, 1], up])
