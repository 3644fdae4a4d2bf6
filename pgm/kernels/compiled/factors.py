"""A CPD at one of its rows, linearised at a belief, in machine code.

A CPD is a row of a table of integers: its sizes, the addresses of its functions, and where its
numbers are. An array (rows, runs, ...) is told by four of them: its address, and how many floats
lie between rows, between runs, and between components; address 0 is that of no array.
"""

from __future__ import annotations

from math import isfinite, pi, sqrt

from pgm.kernels.compiled.algebra import (
    add,
    clear,
    compiled,
    copy,
    mirror,
    padded,
    product,
    root,
    transpose,
    unwhiten,
)
from pgm.kernels.compiled.memory import call, numbers, past, places

# The columns of the table.
(KIND, SIZE, HEIGHT, PARENTS, WHOLE, CHILD, FUNCTION, VALUE, TURNING, TURNS) = range(10)
(ANGLES, BARE, UNSURE, POINTS, COUNT, CENTRED, LEAST, STEPS, SHARP) = range(10, 19)
(INPUTS, MATRIX, OFFSET, NOISE, KEPT_NOISE, READINGS, MOVED) = range(20, 48, 4)
COLUMNS = 48
# How a CPD is linearised: it is affine, or was before; at its mean; on points.
AFFINE, TAYLOR, REGRESSION = range(3)

# As of `gaussian`, `regression` and `moments`, for the floats of one belief.
_REGULAR, _PLAIN, _ROUNDING = 1e-11, 1e-16, 1e-14
_TURN = 2.0 * pi


@compiled
def load(cpd, array, row, run, out, rows, columns):
    """Copy the matrix of an array at a row and a run; a vector is a matrix of one row."""
    source, wide = numbers(cpd[array]), padded(columns)
    here, apart = row * cpd[array + 1] + run * cpd[array + 2], cpd[array + 3]
    for i in range(rows):
        for j in range(columns):
            out[i * wide + j] = source[here]
            here += apart
        for j in range(columns, wide):
            out[i * wide + j] = 0.0


@compiled
def save(cpd, array, row, run, values, rows, columns):
    """Put a matrix into an array at a row and a run, if there is one."""
    if cpd[array]:
        target, wide = numbers(cpd[array]), padded(columns)
        here, apart = row * cpd[array + 1] + run * cpd[array + 2], cpd[array + 3]
        for i in range(rows):
            for j in range(columns):
                target[here] = values[i * wide + j]
                here += apart


@compiled
def gather(where, size, mean, cov, wide, x, spread):
    """Some components of a belief, whose covariance has rows of so many floats."""
    own = padded(size)
    clear(spread, size * own)
    for i in range(size):
        x[i] = mean[where[i]]
        for j in range(size):
            spread[i * own + j] = cov[where[i] * wide + where[j]]


@compiled
def linearise(cpd, row, run, x, cov, matrix, value, noise, work):
    """The F, F μ + b and noise of a CPD at a belief over its parents.

    Whether the noise has an error of the linearisation in it: 1 or 0; −1 if the belief has no root.
    """
    size, height, kind = cpd[SIZE], cpd[HEIGHT], cpd[KIND]
    load(cpd, NOISE, row, run, noise, height, height)
    if kind == AFFINE:
        load(cpd, MATRIX, row, run, matrix, height, size)
        load(cpd, OFFSET, row, run, value, 1, height)
        wide = padded(size)
        for i in range(height):
            for k in range(size):
                value[i] += matrix[i * wide + k] * x[k]
        return 0
    inputs = past(numbers(cpd[INPUTS]), row * cpd[INPUTS + 1] + run * cpd[INPUTS + 2])
    if kind == TAYLOR:
        call(cpd[FUNCTION], x, inputs, value, matrix)
        return 0
    return _regress(cpd, inputs, x, cov, matrix, value, noise, work)


@compiled
def _regress(cpd, inputs, x, cov, matrix, value, noise, work):
    size, height, count = cpd[SIZE], cpd[HEIGHT], cpd[COUNT]
    wide, tall = padded(size), padded(height)
    points = numbers(cpd[POINTS])
    rows, signs = past(points, count * size), past(points, count * (size + count))
    upper, inverse = work, past(work, size * wide)
    at, raw = past(inverse, wide), past(inverse, wide * (count + 1))
    found, error = past(raw, count * tall), past(raw, 2 * count * tall)
    if root(cov, upper, inverse, size, _REGULAR) == 0.0:
        return -1
    for p in range(count):
        copy(x, past(at, p * wide), wide)
    add(1.0, points, size, 1, upper, at, count, size, wide)
    clear(raw, count * tall)
    for p in range(count):
        call(cpd[VALUE], past(at, p * wide), inputs, past(raw, p * tall), matrix)
    if cpd[ANGLES] and not cpd[CENTRED]:
        call(cpd[VALUE], x, inputs, value, matrix)
    else:
        copy(raw, value, tall)
    for p in range(count):
        for i in range(height):
            raw[p * tall + i] -= value[i]
    if cpd[ANGLES]:
        _about(cpd, inputs, x, at, raw, found)
    product(rows, count, 1, raw, found, count, count, tall)
    slope, left = past(found, tall), past(found, (1 + size) * tall)
    clear(error, height * tall)
    for p in range(count - 1 - size):
        add(signs[p], past(left, p * tall), 1, 1, past(left, p * tall), error, height, 1, tall)
    for i in range(height):  # the sizes of slopes, beside which rounding is told
        matrix[i] = value[i] * value[i]
        for j in range(size):
            matrix[i] += slope[j * tall + i] ** 2
    doubtful = False
    least = numbers(cpd[LEAST])  # of the own noise, then the rounding of the rule
    for i in range(height):
        doubtful = doubtful or not error[i * tall + i] + least[i] > _PLAIN * matrix[i]
    sizes = past(error, height * tall)
    copy(matrix, sizes, height)
    unwhiten(upper, inverse, slope, size, tall)  # F L = J
    transpose(slope, matrix, size, height)
    if doubtful:
        _clear_rounding(cpd, x, matrix, value, raw, error, sizes)
    for i in range(height):
        value[i] += found[i]
    for i in range(height * tall):
        noise[i] += error[i]
    mirror(noise, height)
    return 1


@compiled
def _about(cpd, inputs, x, at, raw, work):
    """Offsets of angles of which some exceed half a turn, wrapped about their line."""
    size, height, count, steep = cpd[SIZE], cpd[HEIGHT], cpd[COUNT], False
    wide, tall = padded(size), padded(height)
    slope = past(work, tall)
    for i in range(height):
        far = False
        if (cpd[ANGLES] >> i) & 1:
            for p in range(count):
                far = far or abs(raw[p * tall + i]) > pi
        if not far:
            continue
        if not steep:
            call(cpd[FUNCTION], x, inputs, work, slope)
            steep = True
        for p in range(count):
            line = 0.0
            for j in range(size):
                line += slope[i * wide + j] * (at[p * wide + j] - x[j])
            off = raw[p * tall + i] - line
            raw[p * tall + i] = off - _TURN * round(off / _TURN) + line


@compiled
def _clear_rounding(cpd, x, matrix, reference, raw, error, sizes):
    """Make the error zero in components in which it may be rounding of the values."""
    size, height = cpd[SIZE], cpd[HEIGHT]
    wide, tall = padded(size), padded(height)
    least = numbers(cpd[LEAST])
    for i in range(height):
        variance, summands = error[i * tall + i], abs(reference[i])
        if variance + least[i] > _PLAIN * sizes[i]:
            continue
        variance = abs(variance)
        if variance > (least[height] * summands) ** 2:
            farthest = 0.0
            for j in range(size):
                summands += abs(matrix[i * wide + j] * x[j])
            for p in range(cpd[COUNT]):
                farthest = max(farthest, abs(raw[p * tall + i]))
            if variance > (least[height] * (summands + farthest)) ** 2:
                continue
        for j in range(height):
            error[i * tall + j] = 0.0
            error[j * tall + i] = 0.0


@compiled
def to_chart(cpd, row, run, before, x, value, work):
    """Take off the whole turns by which a function wraps angles, counted from the step before.

    One that wraps gives the same for angles a whole turn on; another turns too.
    """
    size, height = cpd[SIZE], cpd[HEIGHT]
    pairs, far = places(cpd[TURNING]), False
    for k in range(cpd[TURNS]):
        far = far or abs(value[pairs[3 * k]] - before[pairs[3 * k + 1]]) > pi
    if not far:
        return
    inputs = past(numbers(cpd[INPUTS]), row * cpd[INPUTS + 1] + run * cpd[INPUTS + 2])
    at, ends, slope = work, past(work, size), past(work, size + 2 * height)
    copy(x, at, size)
    call(cpd[VALUE], at, inputs, ends, slope)
    for k in range(cpd[TURNS]):
        at[pairs[3 * k + 2]] += _TURN
    call(cpd[VALUE], at, inputs, past(ends, height), slope)
    for k in range(cpd[TURNS]):
        new = pairs[3 * k]
        if abs(ends[height + new] - ends[new]) < pi:
            value[new] -= _TURN * round((value[new] - before[pairs[3 * k + 1]]) / _TURN)


@compiled
def predict(cpd, cov, matrix, noise, out, work):
    """F P Fᵀ + noise; whether zeros of components without noise need not be told from rounding."""
    size, height = cpd[SIZE], cpd[HEIGHT]
    wide, tall = padded(size), padded(height)
    half, turned = work, past(work, height * wide)
    product(matrix, wide, 1, cov, half, height, size, wide)
    transpose(matrix, turned, height, size)
    copy(noise, out, height * tall)
    add(1.0, half, wide, 1, turned, out, height, size, tall)
    mirror(out, height)
    if cpd[BARE] and size:
        for i in range(height):
            if not (cpd[BARE] >> i) & 1:
                continue
            most = 0.0
            for k in range(size):
                most += abs(matrix[i * wide + k]) * sqrt(max(cov[k * wide + k], 0.0))
            if not out[i * tall + i] > _ROUNDING * most * most:
                return False
    return not cpd[UNSURE] or root(out, work, past(work, height * tall), height, 1e-13) > 0.0


@compiled
def nearest(cpd, value, reading):
    """Move angles of a reading to the branch nearest the value."""
    for i in range(cpd[HEIGHT]):
        if (cpd[ANGLES] >> i) & 1:
            off = reading[i] - value[i]
            if abs(off) > pi and isfinite(off):
                reading[i] -= _TURN * round(off / _TURN)
