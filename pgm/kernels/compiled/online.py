"""A step of one chain in machine code, its inputs and its beliefs in arrays: a filter's in a loop.

A step is a row of integers: the address of its chain, that of room to work in, whether all its
inputs come in one row, and its parts; of these a part is a given array that goes to one place, and
a shift the offset of an affine CPD, which inputs move.
"""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import Any

import numpy as np
from numba import njit

from pgm.kernels.compiled import tables as t
from pgm.kernels.compiled.algebra import least_open, padded
from pgm.kernels.compiled.measurements import once
from pgm.kernels.compiled.memory import STAMP, compiled, numbers, past, places, ready
from pgm.kernels.compiled.sweeps import joined, moved

(CHAIN, MEMORY, PACKED, PARTS, PART_COUNT, SHIFTS, SHIFT_COUNT, STEP) = range(8)
# Which array, or where it begins in the row of all; its rows and columns; its place, the floats
# from row to row there, and how many rows to fill with it; whether its components may be missing.
(ORDER, ROWS, COLUMNS, TARGET, APART, FILLED, OPEN, PART) = range(8)
# Offset + B u, for each of so many rows.
(OFFSET, BASE, MATRIX, INPUTS, HEIGHT, SIZE, COUNT, SHIFT) = range(8)
DONE, NO, OTHER = 0, 1, 2
# As of `beliefs.is_moderate`.
_REGULAR, _FAR = 1.0 / 2e7, (1e-5 / 2.0**-52) ** 2


@compiled
def _fill(head, first, second):
    """Put what is given where the chain reads it, if it is of the shapes that are due."""
    packed = head[PACKED]
    for k in range(head[PART_COUNT]):
        part = past(places(head[PARTS]), k * PART)
        rows, columns, target = part[ROWS], part[COLUMNS], numbers(part[TARGET])
        array = second if part[ORDER] and not packed else first
        if not packed and (array.shape[0] != rows or array.shape[1] != columns):
            return OTHER
        for i in range(part[FILLED]):
            row = i if rows > 1 else 0
            for j in range(columns):
                place = part[ORDER] + row * columns + j
                value = first[0, place] if packed else array[row, j]
                if not isfinite(value) and (value == value or not part[OPEN]):
                    return NO
                target[i * part[APART] + j] = value
    for k in range(head[SHIFT_COUNT]):
        _shift(past(places(head[SHIFTS]), k * SHIFT))
    return DONE


@compiled
def _shift(shift):
    height, size = shift[HEIGHT], shift[SIZE]
    offset, base, matrix = numbers(shift[OFFSET]), numbers(shift[BASE]), numbers(shift[MATRIX])
    for row in range(shift[COUNT]):
        inputs = past(numbers(shift[INPUTS]), row * size)
        for i in range(height):
            total = base[i]
            for j in range(size):
                total += matrix[i * size + j] * inputs[j]
            offset[row * height + i] = total


@compiled
def _unpacked(belief, size, mean, cov):
    """The mean and the covariance of a belief, in rows of padded length."""
    wide, source = padded(size), numbers(belief.ctypes.data)
    for j in range(wide):
        mean[j] = source[j] if j < size else 0.0
    for i in range(size):
        for j in range(wide):
            cov[i * wide + j] = source[(i + 1) * size + j] if j < size else 0.0


@compiled
def _settled(mean, cov, before, out, size, work):
    """Whether a belief is moderate, beside the covariance before, and if so, put into `out`."""
    wide, target = padded(size), numbers(out.ctypes.data)
    for i in range(size):
        entry = cov[i * wide + i]
        if not (entry > _REGULAR * before[i * wide + i] and mean[i] * mean[i] < _FAR * entry):
            return False
        target[i] = mean[i]
        for j in range(size):
            target[(i + 1) * size + j] = cov[i * wide + j]
    return least_open(cov, work, size) > _REGULAR


_kept: Any = njit(error_model="numpy", cache=True)


def _entries(stamp: int) -> tuple[Any, Any]:
    """The steps that Python calls; of the stamp as those of `sweeps`."""

    @_kept
    def predict(step, belief, given, out):
        # The slice after a step; whether that is done (0), or arrays are of other shapes (2).
        # A belief is (n + 1, n): its mean, then its covariance.
        if stamp < 0:
            return NO
        head, row = places(step), given[np.newaxis, :]
        told = _fill(head, row, row)
        if told != DONE:
            return told
        fields, known = places(head[CHAIN]), numbers(head[MEMORY])
        size = fields[t.WIDTH]
        wide = padded(size)
        before, mean = past(known, wide), past(known, wide + size * wide)
        cov, work = past(mean, wide), past(mean, wide + size * wide)
        _unpacked(belief, size, known, before)
        if fields[t.SINGLE]:
            done = moved(fields, 0, 0, known, before, mean, cov, work)
        else:
            done = joined(fields, 0, 0, known, before, mean, cov, work)
        return DONE if done and _settled(mean, cov, cov, out, size, work) else NO

    @_kept
    def update(step, belief, first, second, out):
        # The belief given measurements, and their log-density; ∞ for other shapes, NaN if not done.
        if stamp < 0:
            return nan
        head = places(step)
        told = _fill(head, first, second)
        if told != DONE:
            return inf if told == OTHER else nan
        fields, known = places(head[CHAIN]), numbers(head[MEMORY])
        size = fields[t.WIDTH]
        wide = padded(size)
        before, mean = past(known, wide), past(known, wide + size * wide)
        cov, work = past(mean, wide), past(mean, wide + size * wide)
        _unpacked(belief, size, known, before)
        done, density = once(fields, 0, 0, known, before, known, before, mean, cov, work)
        if done and isfinite(density) and _settled(mean, cov, before, out, size, work):
            return density
        return nan

    return predict, update


predict, update = _entries(STAMP)
ready(predict, "int64(int64,float64[:,::1],float64[:],float64[:,::1])")
ready(update, "float64(int64,float64[:,::1],float64[:,:],float64[:,:],float64[:,::1])")
