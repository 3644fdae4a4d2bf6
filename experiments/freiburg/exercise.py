"""The exercise's network: its start, its noise, and ranges without bearings."""

from __future__ import annotations

import numpy as np

import pgm
from models import networks

# Variances of the first pose, of a step's motion [m², m², rad²], and of a range [m²].
START, MOTION, SENSOR = (1.0, 1.0, 1.0), (0.2, 0.2, 0.02), 0.5
LINEARISERS: dict[str, pgm.Lineariser] = {
    "Taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "unscented, α = 0.001": pgm.Unscented(alpha=1e-3),
    "cubature": pgm.Cubature(),
    "Gauss–Hermite 7": pgm.GaussHermite(7),
}


def network(*, grouped: bool = False) -> pgm.DynamicBayesianNetwork:
    """The exercise as a network.

    Parameters
    ----------
    grouped : bool
        Whether sigma points see the ranges of a step as one vector, as a stacked filter does.
    """
    return networks.odometry_ranges(
        start_std=np.sqrt(START).tolist(),
        motion_std=np.sqrt(MOTION).tolist(),
        sensor_std=float(np.sqrt(SENSOR)),
        grouped=grouped,
    )
