"""Whether the cells resolve a belief given measurements: the error of sums over centres.

Let b be the predicted density of the states at a step, and l the density of the step's measurements
given the states. The evidence of the step is the integral of b l, for which a grid takes the sum
over the centres of its cells. Let c_i be the centre of cell i, h the widths of the cells along the
axes, and δ a shift of all centres, in shares of a cell along each axis. The sums of b l, and of b
alone, over the shifted centres are

    I(δ) = Σ_i b(c_i + δ h) l(c_i + δ h),        B(δ) = Σ_i b(c_i + δ h).

Up to the volume of a cell, the mean of I over δ is the integral. If b l is a normal density with a
standard deviation of s cells, ln I varies by ±2e^(−2π²s²) as δ varies. The expected square of a
step's error is the variance of ln I over some shifts, less the variance of ln B, which is due to
earlier measurements. Errors of several steps add up as independent ones; but the errors of a belief
that only narrows count once in all, since ln B of the next step takes off what was counted.

l is evaluated at the shifted centres; b is interpolated between the logarithms of its values at the
cells, by parabolas along each axis. Axes along which b itself fills only a cell or two are not
shifted. A density l that is not normal may have a peak between all shifted centres; this counts as
an error of one nat. The width of a peak is judged by its curvature, minus the second difference of
logarithms from cell to cell: a curvature of c is a standard deviation of 1/√c cells. The error of a
step counts as zero if the curvatures of b l along all axes sum to less than 3.5, and the expected
measurement of no sensor moves by √3.5 standard deviations of its noise, or more, from a cell to the
next.

(Sloan & Joe, Lattice Methods for Multiple Integration, 1994, have shifted rules; McKay, Beckman &
Conover, 1979, Latin hypercubes.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pgm.beliefs.grid.density_sensors import DensitySensor
from pgm.beliefs.grid.lattice import Lattice, Window
from pgm.beliefs.grid.measured import MeasuredSensor
from pgm.beliefs.grid.sensors import Weights, likelihood
from pgm.kernels.arrays import Array, Integers, Mask

# How many shifts of the centres there are, the first being zero, and the seed of their draws.
SHIFTS, _CHOSEN = 8, 154
# A sum of the curvatures along all axes below which errors are less than .7 % of the evidence.
_WIDE = 3.5
# Curvature of a predicted belief above which nothing can be interpolated through its cells: its
# standard deviation is .2 of one.
_POINT = 25.0
# Standard deviations from a cell to the next above which a peak may stand between all shifted
# centres, and the square of the error that is then counted.
_BETWEEN, _MISSED = 15.0, 1.0
# An error in nats, beyond which no more is counted.
ENOUGH = 10.0
# What stands for the logarithm of zero.
_NONE = -700.0


def error(
    sensors: Sequence[MeasuredSensor],
    predicted: Array,
    found: Weights,
    window: Window,
    step: int,
    run: int,
) -> float:
    """The expected square of the error, in nats, of the log-evidence of a step's measurements.

    predicted: The predicted probabilities of the window's cells, an axis of the array for each axis
        of the lattice.
    found: The weights of the step's measurements in this window.
    window: The cells in use, a span along each axis.

    It is zero where nothing was measured, where the belief given the measurements is wide for the
    cells, or where no axis can be shifted.
    """
    if found.values is None:
        return 0.0
    lattice = sensors[0].lattice
    turns = _turns(lattice, window)
    with np.errstate(divide="ignore"):
        before, after = np.log(predicted), np.log(predicted * found.values)
    peak = _curvatures(after, turns)
    if peak.sum() < _WIDE and found.sharpest.cells**2 < _WIDE:
        return 0.0
    shifted = _curvatures(before, turns) < _POINT
    if not shifted.any():
        return 0.0
    levels = []
    for shift in _shifts(len(lattice.axes)) * shifted:
        belief = _drawn(before, shift, turns)
        level = found
        if shift.any():
            moved = _moved(lattice, shift)
            own = [replace(sensor, lattice=moved) for sensor in sensors]
            level = likelihood(own, step, run, window)
        assert level.values is not None
        total = float(belief.sum())
        joint = float(np.vdot(belief, level.values))
        levels.append((max(_log(joint) + level.log_scale, found.log_scale + _NONE), _log(total)))
    joint, alone = np.var(levels, axis=0)
    missed = _MISSED if _is_missed(sensors, found) else 0.0
    return max(float(joint - alone), 0.0) + missed


def _is_missed(sensors: Sequence[MeasuredSensor], found: Weights) -> bool:
    """Whether a density that is not normal may have a peak between all shifted centres.

    It may if the sensor that is sharpest for the cells is given by its density, and its sharpness
    is above 15. (A normal density that is missed shows by its slope at the centres.) `found` are
    the weights of the step's measurements.
    """
    sharp = found.sharpest
    return sharp.cells > _BETWEEN and any(
        isinstance(sensor, DensitySensor) and sensor.reading.cpd.child == sharp.variable
        for sensor in sensors
    )


def _log(value: float) -> float:
    """The logarithm of a number; −700 of zero."""
    return float(np.log(value)) if value > 0.0 else _NONE


def _shifts(axes: int) -> Array:
    """Eight shifts of the centres, (8, axes), in shares of a cell from −½ to ½: a Latin hypercube.

    The first one is zero. The seed of their draws was chosen among many, for small means over the
    shifts δ of exp(2πi k·δ): these are .56 at the most in absolute value, for all vectors k ≠ 0 of
    the numbers 0, 1 and −1 along up to four axes.
    """
    rng = np.random.default_rng(_CHOSEN)
    each = [[0, *(1 + rng.permutation(SHIFTS - 1))] for _ in range(axes)]
    return (np.transpose(each) / SHIFTS + 0.5) % 1.0 - 0.5


def _turns(lattice: Lattice, window: Window) -> Mask:
    """The mask (axes,) of the axes that are circles of which the window has all cells."""
    return np.array(
        [
            axis.angle and span.length == axis.cells
            for axis, span in zip(lattice.axes, window, strict=True)
        ]
    )


def _curvatures(level: Array, turns: Mask) -> Array:
    """A belief's curvature along each axis, (axes,), at its most probable cell.

    level: The logarithms of the probabilities of a window's cells.
    turns: The mask of axes that go round a whole circle.

    The curvature is minus the second difference of the logarithms. At an end of the window the
    difference to the neighbour inside counts twice. The curvature is infinite where a neighbour
    within the window has probability zero, or where there is no neighbour.
    """
    place = np.array(np.unravel_index(int(level.argmax()), level.shape), dtype=np.intp)
    here, found = float(level[tuple(place)]), np.full(level.ndim, np.inf)
    for k in range(level.ndim):
        near = [_neighbour(level, place, k, step, turns[k]) for step in (1, -1)]
        if min(near) > -np.inf:
            found[k] = 2.0 * here - sum(near)
        elif not turns[k] and max(near) > -np.inf and place[k] in (0, level.shape[k] - 1):
            found[k] = 2.0 * (here - max(near))  # at an end, of which the belief goes on inside
    return found


def _neighbour(level: Array, place: Integers, axis: int, step: int, turns: bool) -> float:
    """The logarithm at a cell's neighbour, one `step` (1 or −1) along an axis; −∞ beyond an end.

    level: The logarithms of the probabilities of a window's cells.
    place: The cell, (axes,).
    turns: Whether the axis goes round a whole circle.
    """
    other = place.copy()
    other[axis] += step
    if turns:
        other[axis] %= level.shape[axis]
    elif not 0 <= other[axis] < level.shape[axis]:
        return -np.inf
    return float(level[tuple(other)])


def _moved(lattice: Lattice, shift: Array) -> Lattice:
    """The same lattice with its centres shifted by shares (axes,) of a cell."""
    axes = tuple(
        replace(axis, low=axis.low + float(share) * axis.width)
        for axis, share in zip(lattice.axes, shift, strict=True)
    )
    return replace(lattice, axes=axes)


def _drawn(level: Array, shift: Array, turns: Mask) -> Array:
    """A belief at centres shifted by shares of a cell, interpolated through its logarithms.

    level: The logarithms of the probabilities of a window's cells; the belief returned has the
        probabilities themselves.
    shift: The shares, (axes,).
    turns: The mask of axes that go round a whole circle.

    Between two cells the logarithm follows a parabola through both. Its curvature is the smaller in
    size of those at the two cells, and zero if these differ in sign. At an edge, and beside a cell
    of probability zero, a cell keeps its own logarithm.
    """
    for axis, share in enumerate(shift):
        if not share:
            continue
        step = 1 if share > 0.0 else -1
        here = np.moveaxis(level, axis, 0)
        after, further, back = (_rolled(here, k * step, bool(turns[axis])) for k in (1, 2, -1))
        part = abs(float(share))
        with np.errstate(invalid="ignore"):
            bends = here - 2.0 * after + further, back - 2.0 * here + after
            one, other = (np.where(np.isfinite(bend), bend, 0.0) for bend in bends)
            bend = np.where(one * other > 0.0, np.sign(one) * np.minimum(abs(one), abs(other)), 0.0)
            line = (1.0 - part) * here + part * after - 0.5 * part * (1.0 - part) * bend
        moved = np.where(np.isfinite(line), line, here)
        level = np.moveaxis(moved, 0, axis)
    found: Array = np.exp(level)
    return found


def _rolled(level: Array, step: int, turns: bool) -> Array:
    """The values of `level` at the cells `step` further along its first axis; −∞ beyond an end.

    `level` has the logarithms of probabilities. With `turns` the axis goes round a whole circle and
    has no end.
    """
    found = np.roll(level, -step, axis=0)
    if not turns:
        found[slice(-step, None) if step > 0 else slice(None, -step)] = -np.inf
    return found
