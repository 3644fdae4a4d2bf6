"""A step of one chain in machine code, its inputs and its beliefs in arrays: a filter's in a loop.

A step is a row of integers: the address of its chain, that of room to work in, whether all its
inputs come in one row, and its parts; of these a part is a given array that goes to one place, and
a shift the offset of an affine CPD, which inputs move.
"""

from __future__ import annotations

from math import isfinite, nan
from typing import Any

import numpy as np

from pgm.kernels.compiled import tables as t
from pgm.kernels.compiled.algebra import copy, least_open, padded
from pgm.kernels.compiled.measurements import once
from pgm.kernels.compiled.memory import STAMP, compiled, kept, numbers, past, places, ready
from pgm.kernels.compiled.sweeps import joined, moved

(CHAIN, MEMORY, PACKED, PARTS, PART_COUNT, SHIFTS, SHIFT_COUNT, STEP) = range(8)
# Which array, or where it begins in the row of all; its rows and columns; its place, the floats
# from row to row there, and how many rows to fill with it; whether its components may be missing.
(ORDER, ROWS, COLUMNS, TARGET, APART, FILLED, OPEN, PART) = range(8)
# Offset + B u, for each of so many rows.
(OFFSET, BASE, MATRIX, INPUTS, HEIGHT, SIZE, COUNT, SHIFT) = range(8)
# As of `beliefs.is_moderate`, and of `last_places.of_step`, which tells what has lost digits.
_REGULAR, _FAR = 1.0 / 2e7, (2e-6 / 2.0**-52) ** 2


@compiled
def _fill(head, first, second):
    """Put what is given where the chain reads it; whether it is finite, and of the due shapes."""
    packed = head[PACKED]
    for k in range(head[PART_COUNT]):
        part = past(places(head[PARTS]), k * PART)
        rows, columns, target = part[ROWS], part[COLUMNS], numbers(part[TARGET])
        array = second if part[ORDER] and not packed else first
        if not packed and (array.shape[0] != rows or array.shape[1] != columns):
            return False
        for i in range(part[FILLED]):
            row = i if rows > 1 else 0
            for j in range(columns):
                place = part[ORDER] + row * columns + j
                value = first[0, place] if packed else array[row, j]
                if not isfinite(value) and (value == value or not part[OPEN]):
                    return False
                target[i * part[APART] + j] = value
    for k in range(head[SHIFT_COUNT]):
        _shift(past(places(head[SHIFTS]), k * SHIFT))
    return True


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
def _predicted(fields, mean, cov, after, spread, work):
    if fields[t.SINGLE]:
        done = moved(fields, 0, 0, mean, cov, after, spread, work)
    else:
        done = joined(fields, 0, 0, mean, cov, after, spread, work)
    copy(spread, cov, fields[t.WIDTH] * padded(fields[t.WIDTH]))  # it is compared with itself
    return done, 0.0


@compiled
def _updated(fields, mean, cov, after, spread, work):
    return once(fields, 0, 0, mean, cov, mean, cov, after, spread, work)


def _through(kernel: Any) -> Any:
    """A kernel from a belief to the next; its log-density, NaN if that is not done.

    A belief is (n + 1, n): its mean, then its covariance. Kernels have rows of padded length.
    """

    @compiled
    def through(head, before, after):
        fields, mean = places(head[CHAIN]), numbers(head[MEMORY])
        size, wide = fields[t.WIDTH], padded(fields[t.WIDTH])
        cov, later = past(mean, wide), past(mean, (size + 1) * wide)
        spread, work = past(later, wide), past(later, (size + 1) * wide)
        for i in range(size + 1):
            for j in range(wide):
                mean[i * wide + j] = before[i * size + j] if j < size else 0.0
        done, density = kernel(fields, mean, cov, later, spread, work)
        if not (done and isfinite(density)):
            return nan
        for i in range(size):
            entry = spread[i * wide + i]
            if not (entry > _REGULAR * cov[i * wide + i] and later[i] * later[i] < _FAR * entry):
                return nan
        for i in range(size + 1):
            for j in range(size):
                after[i * size + j] = later[i * wide + j]
        return density if least_open(spread, work, size) > _REGULAR else nan

    return through


_moved_on, _taken_in = _through(_predicted), _through(_updated)


def _entries(stamp: int) -> tuple[Any, Any]:
    """The steps that Python calls, which close over the stamp."""

    def predict(step, before, after, given):
        row = given[np.newaxis, :]
        if stamp < 0 or not _fill(step, row, row):
            return nan
        return _moved_on(step, numbers(before.ctypes.data), numbers(after.ctypes.data))

    def update(step, before, after, first, second):
        if stamp < 0 or not _fill(step, first, second):
            return nan
        return _taken_in(step, numbers(before.ctypes.data), numbers(after.ctypes.data))

    return kept(predict, "predict", _nrt=False), kept(update, "update", _nrt=False)


predict, update = _entries(STAMP)
_KNOWN = "int64[::1],float64[:,::1],float64[:,::1]"
ready(predict, f"float64({_KNOWN},float64[:])")
ready(update, f"float64({_KNOWN},float64[:,:],float64[:,:])")
