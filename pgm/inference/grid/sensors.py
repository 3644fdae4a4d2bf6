"""Densities of measurements at the centres of a grid.

A sensor's function is called with the centres that tell: along axes on which it does not depend
with one of them. Where it is a function of the other axes plus one of those that are circles, as a
bearing less a heading is, with those of either, which is tested at every centre once, and at some
of them with each measurement.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.cpds import CPD, ConditionalGaussian
from pgm.cpds.mixture import UnidentifiedCPD
from pgm.inference.argument_checks import require_whole
from pgm.inference.grid.dependence import MEASURED, Reduced, blocks, centres, within
from pgm.inference.grid.lattice import Window
from pgm.inference.grid.measured import (
    BLOCK,
    Joint,
    Known,
    Level,
    MeasuredSensor,
    Residuals,
    Sharpness,
    Term,
    exponents,
)
from pgm.inference.grid.values import (
    at_a_time,
    covariance_of,
    deviations,
    gaussian_parts,
    log_density_at,
    mean_at,
    require_noise,
    root_of,
    settled,
)
from pgm.kernels.angles import wrap
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask

# Exponents below this are none: products of such numbers would be slow, denormal ones.
_LEAST = -600.0


class Weights(NamedTuple):
    """The weights of a step's measurements in a window.

    values: 1 at the most; None where nothing was measured.
    log_scale: The logarithm of their largest density.
    ceiling: The logarithm of the density where all residuals are zero.
    components: How many numbers were measured.
    """

    values: Array | None
    log_scale: float
    sharpest: Sharpness
    ceiling: float = 0.0
    components: int = 0


@dataclass(eq=False)
class GridSensor(MeasuredSensor):
    """A sensor of Gaussian noise."""

    @property
    def cpd(self) -> ConditionalGaussian:
        """The sensor's CPD."""
        cpd = self.reading.cpd
        assert isinstance(cpd, ConditionalGaussian)
        return cpd

    @cached_property
    def angles(self) -> Mask:
        """The components that are angles."""
        return self.cpd.child.angle_mask

    def values(self, points: Array, known: Known, step: int, run: int) -> Array:
        """The sensor's function at points (n, axes) of the lattice, (n, d)."""
        return mean_at(self.cpd, self.lattice.values(points), known, step, run)

    def terms(self, row: int, run: int, window: Window) -> tuple[list[Residuals], float]:
        """See `MeasuredSensor`."""
        step, reading = int(self.reading.step[row]), self.reading
        own = run if reading.values.shape[1] > 1 else 0
        taken = self.taken(row, run)
        if not taken.any():
            return [], 0.0
        known = self.known(row, run)
        cov = covariance_of(self.cpd, {**known}, step, run)[np.ix_(taken, taken)]
        lower = root_of(self.cpd, cov, step)
        require_noise(self.cpd, lower, step)
        pivots = np.diagonal(lower)
        constant = -float(np.log(pivots).sum()) - 0.5 * LOG_2PI * len(pivots)
        one, other = self._parts(known, step, run, window)
        one = reading.values[row, own] - one
        one, angles = one[..., taken], self.angles[taken]
        other = None if other is None else other[..., taken]
        if np.array_equal(lower, np.diag(pivots)):
            found: list[Residuals] = []
            for k, scale in enumerate((1.0 / pivots).tolist()):
                part = None if other is None else other[..., k]
                if part is not None and not part.any():
                    part = None
                found.append(Term(one[..., k], part, scale, bool(angles[k])))
            return found, constant
        residual = one if other is None else one - other
        for place in np.flatnonzero(angles):
            residual[..., place] = wrap(residual[..., place])
        whiten = np.linalg.solve(lower, np.eye(len(lower))).astype(np.float64)
        return [Joint(residual, whiten)], constant

    def _parts(
        self, known: Known, step: int, run: int, window: Window
    ) -> tuple[Array, Array | None]:
        """The function's values at the centres of a window, as those of axes plus those of circles.

        Each broadcasts to the window, with the components last.
        """
        some = within(self.lattice, window, MEASURED, 7 * step + 3)
        depended = self._depended(some, known, step, run)
        turning = self._turned(depended, some, known, step, run)
        one = self._on(depended - turning, window, known, step, run)
        if not turning:
            return one, None
        middle = self.values(self._middle(), known, step, run)[0]
        other = self._on(set(turning), window, known, step, run) - middle
        for k in np.flatnonzero(self.angles):
            other[..., k] = wrap(other[..., k])
        return one, other

    def _on(self, axes: set[int], window: Window, known: Known, step: int, run: int) -> Array:
        """The values on some axes of a window, the others at the middle of the lattice."""
        indices = self.lattice.indices(window)
        middle = np.array(self.lattice.shape) // 2
        each = [indices[k] if k in axes else middle[k : k + 1] for k in range(len(indices))]
        mesh = np.meshgrid(*each, indexing="ij")
        found = self.values(
            self.lattice.points([part.reshape(-1) for part in mesh]), known, step, run
        )
        return found.reshape(*mesh[0].shape, -1)

    def _middle(self) -> Array:
        return self.lattice.points([np.array([cells // 2]) for cells in self.lattice.shape])

    def _depended(self, some: Integers, known: Known, step: int, run: int) -> set[int]:
        def values(before: Array, after: Array) -> Array:
            return self.values(before, known, step, run)

        self.shape.depended.look(values, self._differ, frozenset(), 5 * step + 2, some)
        return set().union(*self.shape.depended.before)

    def _differ(self, one: Array, other: Array) -> Mask:
        gap = one - other
        for k in np.flatnonzero(self.angles):
            gap[:, k] = wrap(gap[:, k])
        size = np.maximum(np.abs(one).max(axis=0, initial=0.0), 1.0)
        different: Mask = np.abs(gap) > 1e-10 * size
        return different

    def _turned(
        self, depended: set[int], some: Integers, known: Known, step: int, run: int
    ) -> frozenset[int]:
        """The circles on which the function depends by a sum of two; none, if it is no such sum."""
        shape = self.shape
        if shape.turning is None:
            shape.turning = frozenset(depended.intersection(self.lattice.angles))
        if not shape.turning or not depended - shape.turning:
            return frozenset()

        def values(points: Array) -> Array:
            return self.values(points, known, step, run)

        if shape.tested:
            adds = self._adds(some, shape.turning, values)
        else:
            adds = self._adds_everywhere(shape.turning, values)
        shape.turning = shape.turning if adds else frozenset()
        shape.tested = True
        return shape.turning

    def _adds_everywhere(self, turning: frozenset[int], values: Callable[[Array], Array]) -> bool:
        others = set(range(len(self.lattice.axes))) - turning
        one, other = (Reduced(self.lattice, axes, values) for axes in (others, turning))
        middle = values(self._middle())
        return not any(
            self._differ(
                values(centres(self.lattice, cells)) - one.at(cells), other.at(cells) - middle
            ).any()
            for cells in blocks(self.lattice)
        )

    def _adds(
        self, cells: Integers, turning: frozenset[int], values: Callable[[Array], Array]
    ) -> bool:
        middle = np.array(self.lattice.shape) // 2
        turned = np.array([k in turning for k in range(len(middle))])
        each = [cells, np.where(turned, middle, cells), np.where(turned, cells, middle)]
        points = np.concatenate([centres(self.lattice, c) for c in each] + [self._middle()])
        found = values(points)
        count = len(cells)
        whole, one, other = found[:count], found[count : 2 * count], found[2 * count : -1]
        return not self._differ(whole - one, other - found[-1]).any()

    def sharpness(self, row: int, run: int, cell: Integers) -> float:
        """See `MeasuredSensor`."""
        step, known = int(self.reading.step[row]), self.known(row, run)
        found = self.values(centres(self.lattice, self.around(cell)), known, step, run)
        gaps = found[1 : 1 + len(cell)] - found[0]
        return deviations(self.cpd, gaps, self.taken(row, run), known, step, run)


def likelihood(sensors: Sequence[MeasuredSensor], step: int, run: int, window: Window) -> Weights:
    """The weights of a step's measurements in a window."""
    terms, scale, read = list[Residuals](), 0.0, list[tuple[MeasuredSensor, int]]()
    for sensor in sensors:
        for row in sensor.rows(step):
            found, constant = sensor.terms(row, run, window)
            if found:
                terms += found
                scale += constant
                read.append((sensor, row))
    sharpest = Sharpness(0.0, None, step)
    if not terms:
        return Weights(None, 0.0, sharpest)
    shape = tuple(span.length for span in window)
    exponent = exponents(terms, shape)
    largest = float(exponent.max())
    if not np.isfinite(largest):  # no cell explains them
        return Weights(np.zeros(shape), 0.0, sharpest)
    place = np.unravel_index(int(exponent.argmax()), shape)
    length = max(BLOCK * shape[0] // max(exponent.size, 1), 1)
    for first in range(0, shape[0], length):
        part = exponent[first : first + length]
        part -= largest
        low = part < _LEAST
        np.exp(part, out=part)
        if low.any():
            part[low] = 0.0
    for sensor, row in read:
        cells = [index[p] for index, p in zip(sensor.lattice.indices(window), place, strict=True)]
        sharp = sensor.sharpness(row, run, np.array(cells, dtype=np.intp))
        if sharp > sharpest.cells:
            sharpest = Sharpness(sharp, sensor.reading.cpd.child, step)
    count = sum(int(sensor.taken(row, run).sum()) for sensor, row in read)
    return Weights(exponent, scale + largest, sharpest, scale, count)


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
        """By how many deviations a CPD's Gaussian parts differ from the first cell, at most.

        Of an open sighting those are of the candidate with the fewest.
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
