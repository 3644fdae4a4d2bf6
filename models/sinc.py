"""sin a / a and its slope, with all their digits near a = 0."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def sinc(a: Array) -> Array:
    """Return sin a / a, 1 at a = 0."""
    size = np.maximum(np.abs(a), 1e-20)  # not 0, and so small that sin a / a rounds to 1
    quotient: Array = np.sin(size) / size
    return quotient


def sinc_slope(a: Array) -> Array:
    """Return the derivative of sin a / a: its series below 1/4, where the quotient cancels."""
    near = np.abs(a) < 0.25
    small, large = np.where(near, a, 0.0), np.where(near, 1.0, a)
    s = small * small
    series = -small / 3 * (1 - s / 10 * (1 - s / 28 * (1 - s / 54 * (1 - s / 88))))
    return np.where(near, series, (np.cos(large) - np.sin(large) / large) / large)
