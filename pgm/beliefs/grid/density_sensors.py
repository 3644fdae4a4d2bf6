"""Sensors given by their density, which is evaluated at the centres of a window, some at a time.

A measurement z is a row of the sensor's `Reading`, in a run; its density at a centre x is p(z | x).
A window is a span of cells along each axis; cells (n, axes) are given by their places on the axes.
"""

import math

import numpy as np

from pgm.beliefs.grid.dependence import centres
from pgm.beliefs.grid.lattice import Window
from pgm.beliefs.grid.measured import Known, MeasuredSensor
from pgm.beliefs.grid.residuals import Level, Residuals
from pgm.beliefs.grid.values import (
    at_a_time,
    deviations,
    gaussian_parts,
    log_density_at,
    mean_at,
    require_noise,
    settled,
)
from pgm.cpds import CPD
from pgm.cpds.mixture import UnidentifiedCPD
from pgm.kernels.arrays import Array, Integers
from pgm.schedules.argument_checks import require_whole

# Cells of all the lattice at which a density is looked at, that it may be higher elsewhere.
_ELSEWHERE = 4096


class DensitySensor(MeasuredSensor):
    """A sensor of any density, such as a mixture or a scan, weighed by ln p(z | x) at centres."""

    def terms(self, row: int, run: int, window: Window) -> tuple[list[Residuals], float]:
        """One measurement over a window: a list with its log-densities, and the highest found.

        The one item of the list is a `Level`: the log-densities at the window's centres, an array
        that broadcasts to the window, and the highest once more. The highest is the largest found
        so far: of this measurement in the window and at some 4096 cells spread over all the
        lattice, and of earlier measurements that have as many measured components. It is 0 if all
        are −∞. If no component was measured, the list is empty and the highest 0.
        """
        count = int(self.taken(row, run).sum())
        if not count:
            return [], 0.0
        bound = self._bound(row, run)
        axes = self._axes(bound[0])
        indices, middle = self.lattice.indices(window), np.array(self.lattice.shape) // 2
        lengths = [window[k].length for k in axes]
        level, length = np.empty(math.prod(lengths)), at_a_time(bound[0])
        for first in range(0, level.size, length):
            flat = np.arange(first, min(first + length, level.size))
            cells = np.repeat(middle[None], len(flat), axis=0)
            if axes:
                for k, place in zip(axes, np.unravel_index(flat, lengths), strict=True):
                    cells[:, k] = indices[k][place]
            level[flat] = self._at(cells, row, run, *bound)
        shape = [window[k].length if k in axes else 1 for k in range(len(window))]
        flat = np.arange(0, self.lattice.size, max(self.lattice.size // _ELSEWHERE, 1))
        cells = np.stack(np.unravel_index(flat, self.lattice.shape), axis=-1)
        parts = np.split(cells, range(length, len(cells), length))
        elsewhere = max(float(self._at(part, row, run, *bound).max()) for part in parts)
        highest = max(self.shape.highest.get(count, -np.inf), float(level.max()), elsewhere)
        self.shape.highest[count] = highest
        highest = highest if np.isfinite(highest) else 0.0
        return [Level(level.reshape(shape), highest)], highest

    def sharpness(self, row: int, run: int, cell: Integers) -> float:
        """How sharp the density is at a cell, in standard deviations of the noise per cell.

        It is the largest √(2 l(c) − l(c + e) − l(c − e)) along an axis, l being the log-density, c
        the `cell` (axes,) and e one cell: for a normal density that is how far the expected
        measurement moves by a cell, in standard deviations of the noise. It is infinite where both
        neighbours are impossible. If the mean of a Gaussian part of a mixture moves further, its
        move is returned: the part may be so narrow that no centre meets it.
        """
        bound, cells = self._bound(row, run), self.around(cell)
        found = self._apart(bound[0], cells, bound[2], row, run)
        here, *others = self._at(cells, row, run, *bound).tolist()
        for one, other in zip(others[: len(cell)], others[len(cell) :], strict=True):
            near = [level for level in (one, other) if level > -math.inf]
            if not near:
                return math.inf
            found = max(found, math.sqrt(max(2.0 * here - near[0] - near[-1], 0.0)))
        return found

    def _apart(self, cpd: CPD, cells: Integers, known: Known, row: int, run: int) -> float:
        """The furthest that the mean of a Gaussian part moves from the first of some cells.

        It is max ‖R^(−1/2) (h(c) − h(c_0))‖ over the Gaussian parts of the CPD and the other
        `cells` c, (n, axes), c_0 being the first, h the mean of a part and R its noise covariance.
        Of an unidentified sensor it is the least over its candidates; 0 of a CPD without Gaussian
        parts. `known` has the values (d,) of the observed parents, by variable; the measurement, a
        `row` and a `run`, says which of its components count.
        """
        if isinstance(cpd, UnidentifiedCPD):
            each = ({**known, cpd.parent: candidate} for candidate in cpd.candidates)
            return min(self._apart(cpd.sensor, cells, own, row, run) for own in each)
        points, step = (
            self.lattice.values(centres(self.lattice, cells)),
            int(self.reading.step[row]),
        )
        found = 0.0
        for part in gaussian_parts(cpd):
            means = mean_at(part, points, known, step, run)
            own = deviations(part, means[1:] - means[0], self.taken(row, run), known, step, run)
            found = max(found, own)
        return found

    def _axes(self, cpd: CPD) -> list[int]:
        """The indices of the axes of a CPD's hidden parents, ascending."""
        of = self.lattice.of
        return sorted(k for parent in cpd.parents if parent in of for k in of[parent])

    def _bound(self, row: int, run: int) -> tuple[CPD, Array, Known]:
        """A measurement as a triple: the sensor's CPD, the measured values, the observed parents.

        The CPD has its noise evaluated for the step and the run. The values are (d,), with NaN for
        missing components. The observed parents are given by their values (d,), by variable.
        Missing components that the density cannot leave out are refused by an EvidenceError, and
        singular noise of a Gaussian part by a ModelError.
        """
        step, known, cpd = int(self.reading.step[row]), self.known(row, run), self.reading.cpd
        taken = self.taken(row, run)
        require_whole(cpd, taken, step)
        values = self.reading.values
        value = np.where(taken, values[row, run if values.shape[1] > 1 else 0], np.nan)
        cpd = settled(cpd, known, step, run)
        for part in gaussian_parts(cpd):
            require_noise(part, part._lower, step)
        return cpd, value, known

    def _at(
        self, cells: Integers, row: int, run: int, cpd: CPD, value: Array, known: Known
    ) -> Array:
        """The log-densities ln p(z | x), (n,), at the centres of cells (n, axes).

        `cpd` is the sensor's CPD with its noise evaluated, `value` the measurement (d,), NaN where
        a component is missing, and `known` has the values of the observed parents.
        """
        points = self.lattice.values(centres(self.lattice, cells))
        step = int(self.reading.step[row])
        found = log_density_at(cpd, value, points, known, step, run)
        return np.broadcast_to(found, len(cells))
