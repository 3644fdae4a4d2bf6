"""Residuals of measurements in a window, and the exponents that they add up to."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array

# Numbers of a block of cells, which fit the cache.
BLOCK = 1 << 15


class Term(NamedTuple):
    """A component's residual in deviations: (one − other) / deviation, wrapped if it is an angle.

    one: Its value less the part of circles, broadcasting to the window.
    other: The part of circles, broadcasting to the window.
    """

    one: Array
    other: Array | None
    scale: float
    angle: bool

    def squared(self, first: slice) -> Array:
        """Half the squares of the residuals, of some of the places along the first axis."""
        found = _some(self.one, first)
        if self.other is not None:
            found = found - _some(self.other, first)
        if self.angle:
            found = found - TURN * np.rint(found / TURN)
        found = found * (self.scale * math.sqrt(0.5))
        found *= found
        return found


class Joint(NamedTuple):
    """Residuals of components whose noise is correlated, broadcasting to the window, (..., d).

    whiten: (d, d): the inverse of the root of their covariance.
    """

    residual: Array
    whiten: Array

    def squared(self, first: slice) -> Array:
        """Half the squares of the whitened residuals."""
        white = _some(self.residual, first) @ self.whiten.T
        found: Array = 0.5 * np.einsum("...i,...i->...", white, white)
        return found


class Level(NamedTuple):
    """The log-density of a measurement by itself, broadcasting to the window."""

    values: Array
    highest: float

    def squared(self, first: slice) -> Array:
        """How far it is below the highest."""
        return self.highest - _some(self.values, first)


Residuals = Term | Joint | Level


def _some(array: Array, first: slice) -> Array:
    """Some of the first axis of an array that broadcasts along it."""
    return array if len(array) == 1 else array[first]


def exponents(terms: list[Residuals], shape: tuple[int, ...]) -> Array:
    """The sum of the terms' exponents, over a window of a shape."""
    found = np.empty(shape)
    length = max(BLOCK * shape[0] // max(found.size, 1), 1)
    for first in range(0, shape[0], length):
        rows = slice(first, min(first + length, shape[0]))
        few: Array | None = None
        part = found[rows]
        part[...] = 0.0
        for term in terms:
            with np.errstate(over="ignore"):  # refused, where no cell is left
                squared = term.squared(rows)
            if squared.size < part.size:
                few = squared if few is None else few + squared
            else:
                part -= squared
        if few is not None:
            part -= few
    return found
