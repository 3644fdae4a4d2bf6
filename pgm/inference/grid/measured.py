"""A sensor's measurements on a grid: residuals in a window, and the exponents they add up to."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pgm.errors import ModelError
from pgm.evidence import Reading
from pgm.inference.grid.dependence import Dependence
from pgm.inference.grid.lattice import Lattice, Window
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Variable

# Values (d,) of a sensor's observed parents.
Known = Mapping[Variable, Array]


class Sharpness(NamedTuple):
    """The sensor that is the sharpest for the cells.

    cells: By how many of its deviations a measurement differs from one cell to the next, where it
        is the likeliest.
    """

    cells: float
    variable: Variable | None
    step: int


@dataclass(eq=False)
class Shape:
    """The shape of a sensor's function, as far as it has been tested.

    turning: The circles by which it is a sum of two; None as long as that has not been asked.
    tested: Whether that has been tested at every centre.
    highest: Of a density, by how many components were taken, its largest logarithm found at a
        centre.
    """

    depended: Dependence
    turning: frozenset[int] | None = None
    tested: bool = False
    highest: dict[int, float] = field(default_factory=dict)


@dataclass(eq=False)
class MeasuredSensor:
    """A sensor's measurements, and the shape of its function."""

    lattice: Lattice
    reading: Reading
    shape: Shape

    def require_covered(self) -> None:
        """Refuse a sensor of what the grid has not."""
        cpd = self.reading.cpd
        for parent in cpd.given:
            if parent not in self.lattice.of and parent not in self.reading.inputs:
                raise ModelError(
                    f"{cpd!r} measures {parent!r}, a hidden control, which no grid covers; "
                    "make it a state, with a prior",
                    variable=cpd.child,
                    cpd=cpd,
                )

    def rows(self, step: int) -> range:
        """The rows of the measurements of a step."""
        low, high = np.searchsorted(self.reading.step, [step, step + 1])
        return range(int(low), int(high))

    def known(self, row: int, run: int) -> Known:
        """The values of its observed parents."""
        inputs = self.reading.inputs
        return {v: a[row, run if a.shape[1] > 1 else 0] for v, a in inputs.items()}

    def taken(self, row: int, run: int) -> Mask:
        """The components of a measurement that were taken, (d,)."""
        found: Mask = self.reading.taken[row, run if self.reading.taken.shape[1] > 1 else 0]
        return found

    def around(self, cell: Integers) -> Integers:
        """A cell, the next along each axis, or the one before at an end, and that before."""
        found = np.repeat(cell[None], 2 * len(cell) + 1, axis=0)
        for k, axis in enumerate(self.lattice.axes):
            for row, step in ((k + 1, 1), (k + 1 + len(cell), -1)):
                inside = axis.angle or 0 <= cell[k] + step < axis.cells
                found[row, k] += step if inside else -step
                found[row, k] %= axis.cells
        return found

    def terms(self, row: int, run: int, window: Window) -> tuple[list[Residuals], float]:
        """The residuals of one measurement, and the log-density where these are zero."""
        raise NotImplementedError

    def sharpness(self, row: int, run: int, cell: Integers) -> float:
        """By how many deviations a measurement differs from a cell to the next, along any axis."""
        raise NotImplementedError


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
