"""A sensor's measurements on a grid, and how sharp the sensor is for its cells.

A measurement is given by its row in the sensor's `Reading`, where rows are sorted by step, and by
its run. h(c) is the sensor's function, the expected measurement, at the centre of cell c; R is the
covariance of its noise. A window is a span of cells along each axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pgm.beliefs.grid.dependence import Dependence
from pgm.beliefs.grid.lattice import Lattice, Window
from pgm.beliefs.grid.residuals import Residuals
from pgm.errors import ModelError
from pgm.evidence import Reading
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Variable

# Values (d,) of a sensor's observed parents.
Known = Mapping[Variable, Array]


class Sharpness(NamedTuple):
    """The sensor that is the sharpest for the cells so far, and the step of its measurement.

    cells: How far the expected measurement moves from a cell to the next, in standard deviations of
        the noise, at the likeliest cell of the measurements; see `MeasuredSensor.sharpness`.
    variable: The sensor; None if nothing was measured.
    """

    cells: float
    variable: Variable | None
    step: int


@dataclass(eq=False)
class Shape:
    """The shape of a sensor's function h as tests have found it, so that h is called less often.

    depended: The axes on which each component of h depends.
    turning: The indices of the circles for which h is a sum, h(x) = f(other axes) + g(circles);
        empty if h is no such sum. None before h is first called; until `tested`, all circles on
        which h depends.
    tested: Whether a test at every centre has shown if h is such a sum.
    highest: The largest log-density that measurements have had at a centre so far, by the number of
        their components that were measured; only for a sensor given by its density.
    """

    depended: Dependence
    turning: frozenset[int] | None = None
    tested: bool = False
    highest: dict[int, float] = field(default_factory=dict)


@dataclass(eq=False)
class MeasuredSensor:
    """A sensor on a lattice, with its measurements; base of sensors by their kind of noise.

    reading: The sensor's CPD and its measurements in all runs, sorted by step.
    shape: What tests have found of the sensor's function; later tests add to it.
    """

    lattice: Lattice
    reading: Reading
    shape: Shape

    def require_covered(self) -> None:
        """Refuse, by a ModelError, a sensor with a hidden parent that is no state of the grid."""
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
        """The rows of the reading that are measurements of a step."""
        low, high = np.searchsorted(self.reading.step, [step, step + 1])
        return range(int(low), int(high))

    def known(self, row: int, run: int) -> Known:
        """The values (d,) of the sensor's observed parents at one measurement, by variable."""
        inputs = self.reading.inputs
        return {v: a[row, run if a.shape[1] > 1 else 0] for v, a in inputs.items()}

    def taken(self, row: int, run: int) -> Mask:
        """The mask of the components of a measurement that were measured, (d,)."""
        found: Mask = self.reading.taken[row, run if self.reading.taken.shape[1] > 1 else 0]
        return found

    def around(self, cell: Integers) -> Integers:
        """A cell (axes,) and its neighbours, (1 + 2 axes, axes).

        The cell comes first, then the next one along each axis, then the one before along each. At
        an end of an interval the neighbour inside stands for the one outside as well.
        """
        found = np.repeat(cell[None], 2 * len(cell) + 1, axis=0)
        for k, axis in enumerate(self.lattice.axes):
            for row, step in ((k + 1, 1), (k + 1 + len(cell), -1)):
                inside = axis.angle or 0 <= cell[k] + step < axis.cells
                found[row, k] += step if inside else -step
                found[row, k] %= axis.cells
        return found

    def terms(self, row: int, run: int, window: Window) -> tuple[list[Residuals], float]:
        """One measurement z over a window: a list of residuals, and a constant.

        At the centre x of each cell, ln p(z | x) is the constant less the sum, over the list, of
        what the method `squared` of a residual gives. With Gaussian noise, `squared` gives half the
        squared whitened residual of one component, or of all together, and the constant is the
        log-density at zero residual. For a sensor given by its density, `squared` gives how far the
        log-density lies below the constant, which is the largest log-density found. If no component
        was measured, the list is empty and the constant 0.
        """
        raise NotImplementedError

    def sharpness(self, row: int, run: int, cell: Integers) -> float:
        """How far the expected measurement moves by one cell, in standard deviations of the noise.

        It is the largest ‖R^(−1/2) (h(c + e_k) − h(c))‖ over the axes k, of the components that
        were measured: c is the `cell` (axes,), e_k one cell along axis k.
        """
        raise NotImplementedError
