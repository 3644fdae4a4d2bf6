"""Sensors of Gaussian noise: densities of their measurements at the centres of a grid.

A measurement is given by its row in the sensor's `Reading` and by its run; `known` are the values
(d,) of the sensor's observed parents there, by variable. A sensor's function h, the expected
measurement, is called with as few centres as its values need: along axes on which it does not
depend one centre stands for all. Where it is a sum h(x) = f(other axes) + g(circles), as a bearing
less a heading is, it is called for f and for g; whether it is such a sum is tested at every centre
once, and at some of them with each measurement. A window is a span of cells along each axis.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.beliefs.grid.dependence import MEASURED, Reduced, blocks, centres, within
from pgm.beliefs.grid.lattice import Window
from pgm.beliefs.grid.measured import Known, MeasuredSensor, Sharpness
from pgm.beliefs.grid.residuals import BLOCK, Joint, Residuals, Term, exponents
from pgm.beliefs.grid.values import (
    covariance_of,
    deviations,
    mean_at,
    require_noise,
    root_of,
)
from pgm.cpds import ConditionalGaussian
from pgm.kernels.angles import wrap
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask

# Exponents below this are none: products of such numbers would be slow, denormal ones.
_LEAST = -600.0


class Weights(NamedTuple):
    """The weights of a step's measurements in a window: their density is values · exp(log_scale).

    values: The weights of the window's cells, the largest being 1; None where nothing was measured,
        and all 0 where no cell explains the measurements.
    log_scale: The logarithm of the largest density of the measurements at a cell of the window.
    sharpest: The sensor that is sharpest for the cells, at the cell of the largest weight.
    ceiling: The logarithm of the density if all residuals were zero; a sensor given by its density
        counts with the largest density found.
    components: How many numbers were measured.
    """

    values: Array | None
    log_scale: float
    sharpest: Sharpness
    ceiling: float = 0.0
    components: int = 0


@dataclass(eq=False)
class GridSensor(MeasuredSensor):
    """A sensor of Gaussian noise, z = h(x) + n, n being drawn from N(0, R)."""

    @property
    def cpd(self) -> ConditionalGaussian:
        """The sensor's CPD, which is a conditional Gaussian."""
        cpd = self.reading.cpd
        assert isinstance(cpd, ConditionalGaussian)
        return cpd

    @cached_property
    def angles(self) -> Mask:
        """The mask of the sensor's components that are angles, (d,)."""
        return self.cpd.child.angle_mask

    def values(self, points: Array, known: Known, step: int, run: int) -> Array:
        """The sensor's function h at points (n, axes) of the lattice, (n, d)."""
        return mean_at(self.cpd, self.lattice.values(points), known, step, run)

    def terms(self, row: int, run: int, window: Window) -> tuple[list[Residuals], float]:
        """One measurement over a window: a list of residuals, and the log-density at zero residual.

        Where the noise of components is independent, there is a `Term` for each component that was
        measured, with its residuals; otherwise one `Joint`, with those of all such components. If
        none was measured, the list is empty and the log-density 0. Singular noise is refused by a
        ModelError.
        """
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
        """The function h over a window as a sum of two: f of some axes and g of circles, (f, g).

        Both are arrays that broadcast to (*lengths of the window, d), d being the components of the
        measurement. g is None where h is no such sum; f is then h.
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
        """The function h over some axes of a window, with the others at the lattice's middle.

        Its values are (*lengths of the window, d), with length 1 along the other axes.
        """
        indices = self.lattice.indices(window)
        middle = np.array(self.lattice.shape) // 2
        each = [indices[k] if k in axes else middle[k : k + 1] for k in range(len(indices))]
        mesh = np.meshgrid(*each, indexing="ij")
        found = self.values(
            self.lattice.points([part.reshape(-1) for part in mesh]), known, step, run
        )
        return found.reshape(*mesh[0].shape, -1)

    def _middle(self) -> Array:
        """The centre of the cell in the middle of the lattice, (1, axes)."""
        return self.lattice.points([np.array([cells // 2]) for cells in self.lattice.shape])

    def _depended(self, some: Integers, known: Known, step: int, run: int) -> set[int]:
        """The axes on which any component of h depends, as far as tests until now have shown.

        With each measurement h is tested at the cells `some`, (n, axes), and at random cells.
        """

        def values(before: Array, after: Array) -> Array:
            return self.values(before, known, step, run)

        self.shape.depended.look(values, self._differ, frozenset(), 5 * step + 2, some)
        return set().union(*self.shape.depended.before)

    def _differ(self, one: Array, other: Array) -> Mask:
        """The mask (n, d) of values, `one` and `other` (n, d), that differ by more than rounding.

        Differences of angles are taken the shorter way round.
        """
        gap = one - other
        for k in np.flatnonzero(self.angles):
            gap[:, k] = wrap(gap[:, k])
        size = np.maximum(np.abs(one).max(axis=0, initial=0.0), 1.0)
        different: Mask = np.abs(gap) > 1e-10 * size
        return different

    def _turned(
        self, depended: set[int], some: Integers, known: Known, step: int, run: int
    ) -> frozenset[int]:
        """The circles on which h depends by a sum, h(x) = f(other axes) + g(circles).

        The result is empty if h is no such sum, or depends on no axis but circles. That it is a sum
        is tested at every centre the first time, then at the cells `some` (n, axes). `depended` are
        all axes on which h depends.
        """
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
        """Whether h(o, t) = h(o, ·) + h(·, t) − h(·, ·) at every centre, to rounding.

        t are the places along the circles `turning`, o those along the other axes, and dots the
        middle of the lattice. `values` is the function h, from points (n, axes) to values (n, d).
        """
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
        """Whether h(o, t) = h(o, ·) + h(·, t) − h(·, ·) at some cells (n, axes), to rounding.

        t are the places along the circles `turning`, o those along the other axes, and dots the
        middle of the lattice. `values` is the function h, from points (n, axes) to values (n, d).
        """
        middle = np.array(self.lattice.shape) // 2
        turned = np.array([k in turning for k in range(len(middle))])
        each = [cells, np.where(turned, middle, cells), np.where(turned, cells, middle)]
        points = np.concatenate([centres(self.lattice, c) for c in each] + [self._middle()])
        found = values(points)
        count = len(cells)
        whole, one, other = found[:count], found[count : 2 * count], found[2 * count : -1]
        return not self._differ(whole - one, other - found[-1]).any()

    def sharpness(self, row: int, run: int, cell: Integers) -> float:
        """The furthest that h moves from a `cell` (axes,) to the next along an axis.

        It is counted in standard deviations of the noise; see `MeasuredSensor.sharpness`.
        """
        step, known = int(self.reading.step[row]), self.known(row, run)
        found = self.values(centres(self.lattice, self.around(cell)), known, step, run)
        gaps = found[1 : 1 + len(cell)] - found[0]
        return deviations(self.cpd, gaps, self.taken(row, run), known, step, run)


def likelihood(sensors: Sequence[MeasuredSensor], step: int, run: int, window: Window) -> Weights:
    """The density of all measurements of a step, in a run, at the cells of a window.

    The `Weights` have the densities divided by the largest of them, the logarithm of the largest,
    and which sensor is sharpest for the cells.
    """
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
