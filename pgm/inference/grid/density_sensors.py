"""Sensors by their density, which is asked for at the centres of a window, some at a time."""

import math

import numpy as np

from pgm.cpds import CPD
from pgm.cpds.mixture import UnidentifiedCPD
from pgm.inference.argument_checks import require_whole
from pgm.inference.grid.dependence import centres
from pgm.inference.grid.lattice import Window
from pgm.inference.grid.measured import Known, MeasuredSensor
from pgm.inference.grid.residuals import Level, Residuals
from pgm.inference.grid.values import (
    at_a_time,
    deviations,
    gaussian_parts,
    log_density_at,
    mean_at,
    require_noise,
    settled,
)
from pgm.kernels.arrays import Array, Integers

# Cells of all the lattice at which a density is looked at, that it may be higher elsewhere.
_ELSEWHERE = 4096


class DensitySensor(MeasuredSensor):
    """A sensor of any density."""

    def terms(self, row: int, run: int, window: Window) -> tuple[list[Residuals], float]:
        """The log-densities of one measurement, and about their largest at any centre."""
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
        """See `MeasuredSensor`; that of the normal density with the same second difference.

        Of a mixture it is that of its Gaussian parts, which may be so sharp that no centre meets
        them.
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
        """The most deviations between a CPD's Gaussian parts at a cell and at the first one."""
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
        """The axes of a CPD's parents."""
        of = self.lattice.of
        return sorted(k for parent in cpd.parents if parent in of for k in of[parent])

    def _bound(self, row: int, run: int) -> tuple[CPD, Array, Known]:
        """The CPD at a row, its measurement, NaN where not taken, and the observed parents."""
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
        """The log-densities (n,) at cells (n, axes)."""
        points = self.lattice.values(centres(self.lattice, cells))
        step = int(self.reading.step[row])
        found = log_density_at(cpd, value, points, known, step, run)
        return np.broadcast_to(found, len(cells))
