"""Residuals of measurements over a window of cells, and the exponents that they add up to.

A window is a span of cells along each axis. z is a measurement, h the expected measurement at a
cell, and R the covariance of the noise. There are three kinds of terms: a `Term` has the residual
of one component, a `Joint` those of all components, and a `Level` the log-density of a sensor whose
noise is not Gaussian. The method `squared` of the first two gives half the square of the whitened
residual, ½ (z − h)ᵀ R⁻¹ (z − h); that of a `Level` gives how far the log-density lies below its
highest. The argument `first` of `squared` is a slice of the window's first axis; the result has the
values at the cells in it, as an array that broadcasts to these cells. The exponent of the
measurements' density is minus the sum of `squared` over all terms.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import Array
from pgm.kernels.step import turns

# Numbers of a block of cells, which fit the cache.
BLOCK = 1 << 15


class Term(NamedTuple):
    """The residual of a component with independent noise, (one − other) / σ, an angle's wrapped.

    one: The measured value z less the expected one; or, where the expected value is a sum f + g
        with g a function of angles alone, z less f. It broadcasts to the window.
    other: g; None, which counts as zero, where the expected value is no such sum.
    scale: 1/σ, σ being the standard deviation of the noise.
    angle: Whether the component is an angle.
    """

    one: Array
    other: Array | None
    scale: float
    angle: bool

    def squared(self, first: slice) -> Array:
        """Half the squares of the whitened residuals, at the cells in a slice of the first axis."""
        found = _some(self.one, first)
        if self.other is not None:
            found = found - _some(self.other, first)
        if self.angle:
            found = found - turns(found)
        found = found * (self.scale * math.sqrt(0.5))
        found *= found
        return found


class Joint(NamedTuple):
    """The residuals of the d components of a measurement whose noise is correlated.

    residual: z − h, which broadcasts to (*window, d), angles wrapped.
    whiten: L⁻¹ (d, d), where R = L Lᵀ is the covariance of the noise.
    """

    residual: Array
    whiten: Array

    def squared(self, first: slice) -> Array:
        """Half the squares of the whitened residuals, at the cells in a slice of the first axis."""
        white = _some(self.residual, first) @ self.whiten.T
        found: Array = 0.5 * np.einsum("...i,...i->...", white, white)
        return found


class Level(NamedTuple):
    """The log-densities of a measurement at the cells of a window.

    values: The log-densities, which broadcast to the window.
    highest: The log-density from which `squared` counts down: the largest that was found.
    """

    values: Array
    highest: float

    def squared(self, first: slice) -> Array:
        """How far the log-density lies below `highest`, at cells in a slice of the first axis."""
        return self.highest - _some(self.values, first)


Residuals = Term | Joint | Level


def _some(array: Array, first: slice) -> Array:
    """The entries in a slice of the first axis; all, of an array that broadcasts along it."""
    return array if len(array) == 1 else array[first]


def exponents(terms: list[Residuals], shape: tuple[int, ...]) -> Array:
    """Minus the sum of the terms' `squared` at all cells of a window, (*shape).

    These are the exponents of the joint density of the measurements. `shape` has the lengths of the
    window along its axes; without terms all exponents are zero.
    """
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
