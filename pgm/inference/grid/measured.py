"""A sensor's measurements on a grid, and how sharp the sensor is for its cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pgm.errors import ModelError
from pgm.evidence import Reading
from pgm.inference.grid.dependence import Dependence
from pgm.inference.grid.lattice import Lattice, Window
from pgm.inference.grid.residuals import Residuals
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Variable

# Values (d,) of a sensor's observed parents.
Known = Mapping[Variable, Array]


class Sharpness(NamedTuple):
    """The sensor whose density is narrowest in units of the cells.

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
        """Refuse a sensor whose parents the grid does not cover."""
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
        """The values of the sensor's observed parents."""
        inputs = self.reading.inputs
        return {v: a[row, run if a.shape[1] > 1 else 0] for v, a in inputs.items()}

    def taken(self, row: int, run: int) -> Mask:
        """The mask of measured components, (d,)."""
        found: Mask = self.reading.taken[row, run if self.reading.taken.shape[1] > 1 else 0]
        return found

    def around(self, cell: Integers) -> Integers:
        """A cell and its neighbours along each axis, for second differences."""
        found = np.repeat(cell[None], 2 * len(cell) + 1, axis=0)
        for k, axis in enumerate(self.lattice.axes):
            for row, step in ((k + 1, 1), (k + 1 + len(cell), -1)):
                inside = axis.angle or 0 <= cell[k] + step < axis.cells
                found[row, k] += step if inside else -step
                found[row, k] %= axis.cells
        return found

    def terms(self, row: int, run: int, window: Window) -> tuple[list[Residuals], float]:
        """The residuals of one measurement, and the log-density at zero residual."""
        raise NotImplementedError

    def sharpness(self, row: int, run: int, cell: Integers) -> float:
        """The deviations between the values at a cell and the next, along the sharpest axis."""
        raise NotImplementedError
