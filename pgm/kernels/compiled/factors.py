"""A CPD at one of its rows, linearised at a belief, in machine code.

A CPD is a row of a table of integers: its sizes, the addresses of its functions, and where its
numbers are. An array (rows, runs, ...) is told by four of them: its address, and how many floats
lie between rows, between runs, and between components; address 0 is that of no array.
"""

from __future__ import annotations

from math import isfinite, pi, sqrt

from pgm.kernels.compiled.algebra import add_symmetric, compiled, copy, root, times
from pgm.kernels.compiled.memory import call, numbers, past, places

# The columns of the table.
(KIND, SIZE, HEIGHT, PARENTS, WHOLE, CHILD, FUNCTION, VALUE, TURNING, TURNS) = range(10)
(ANGLES, BARE, UNSURE, POINTS, COUNT, CENTRED, LEAST, STEPS) = range(10, 18)
(INPUTS, MATRIX, OFFSET, NOISE, KEPT_NOISE, READINGS, MOVED) = range(20, 48, 4)
COLUMNS = 48
# How a CPD is linearised: it is affine, or was before; at its mean; on points.
AFFINE, TAYLOR, REGRESSION = range(3)

# As of `gaussian`, `regression` and `moments`, for the floats of one belief.
_REGULAR, _PLAIN, _ROUNDING = 1e-11, 1e-16, 1e-14
_TURN = 2.0 * pi


@compiled
def load(cpd, array, row, run, out, count):
    """Copy the floats of an array at a row and a run."""
    source = numbers(cpd[array])
    first, apart = row * cpd[array + 1] + run * cpd[array + 2], cpd[array + 3]
    for i in range(count):
        out[i] = source[first + i * apart]


@compiled
def save(cpd, array, row, run, values, count):
    """Put floats into an array, at a row and a run, if there is one."""
    if cpd[array]:
        target = numbers(cpd[array])
        first, apart = row * cpd[array + 1] + run * cpd[array + 2], cpd[array + 3]
        for i in range(count):
            target[first + i * apart] = values[i]


@compiled
def gather(cpd, mean, cov, width, x, spread):
    """The belief over a CPD's hidden parents, out of one of so many components."""
    size, where = cpd[SIZE], places(cpd[PARENTS])
    for i in range(size):
        x[i] = mean[where[i]]
        for j in range(size):
            spread[i * size + j] = cov[where[i] * width + where[j]]


@compiled
def linearise(cpd, row, run, x, cov, matrix, value, noise, work):
    """The F, F μ + b and noise of a CPD at a belief over its parents.

    Whether the noise has an error of the linearisation in it: 1 or 0; −1 if the belief has no root.
    """
    size, height = cpd[SIZE], cpd[HEIGHT]
    load(cpd, NOISE, row, run, noise, height * height)
    if cpd[KIND] == AFFINE:
        load(cpd, MATRIX, row, run, matrix, height * size)
        load(cpd, OFFSET, row, run, work, height)
        times(matrix, x, value, height, size)
        for i in range(height):
            value[i] += work[i]
        return 0
    inputs = past(numbers(cpd[INPUTS]), row * cpd[INPUTS + 1] + run * cpd[INPUTS + 2])
    if cpd[KIND] == TAYLOR:
        call(cpd[FUNCTION], x, inputs, value, matrix)
        return 0
    return _regress(cpd, inputs, x, cov, matrix, value, noise, work)


@compiled
def _regress(cpd, inputs, x, cov, matrix, value, noise, work):
    size, height, count = cpd[SIZE], cpd[HEIGHT], cpd[COUNT]
    points = numbers(cpd[POINTS])
    rows = past(points, count * size)
    signs = past(rows, count * count)
    lower, at, raw = work, past(work, size * size), past(work, size * size + size)
    found = past(raw, count * height)
    error = past(found, count * height)
    if not root(cov, lower, size, _REGULAR):
        return -1
    for p in range(count):
        for i in range(size):
            total = x[i]
            for k in range(i + 1):
                total += lower[i * size + k] * points[p * size + k]
            at[i] = total
        call(cpd[VALUE], at, inputs, past(raw, p * height), matrix)
    if cpd[ANGLES] and not cpd[CENTRED]:
        call(cpd[VALUE], x, inputs, value, matrix)
    else:
        copy(raw, value, height)
    for p in range(count):
        for i in range(height):
            raw[p * height + i] -= value[i]
    if cpd[ANGLES]:
        _about(cpd, inputs, x, lower, points, raw, found)
    for p in range(count):
        for i in range(height):
            total = 0.0
            for q in range(count):
                total += rows[p * count + q] * raw[q * height + i]
            found[p * height + i] = total
    left = past(found, (1 + size) * height)
    for i in range(height):
        for j in range(i + 1):
            total = 0.0
            for p in range(count - 1 - size):
                total += signs[p] * left[p * height + i] * left[p * height + j]
            error[i * height + j] = total
            error[j * height + i] = total
        # F L = J
        for j in range(size - 1, -1, -1):
            rest = found[(1 + j) * height + i]
            for k in range(j + 1, size):
                rest -= matrix[i * size + k] * lower[k * size + j]
            matrix[i * size + j] = rest / lower[j * size + j]
    for i in range(height):
        if not _is_rounding(cpd, i, x, matrix, value[i], raw, found, error):
            continue
        for j in range(height):
            error[i * height + j] = 0.0
            error[j * height + i] = 0.0
    for i in range(height):
        value[i] += found[i]
    for i in range(height * height):
        noise[i] += error[i]
    return 1


@compiled
def _about(cpd, inputs, x, lower, points, raw, work):
    """Offsets of angles of which some exceed half a turn, wrapped about their line."""
    size, height, count, steep = cpd[SIZE], cpd[HEIGHT], cpd[COUNT], False
    for i in range(height):
        wide = False
        if (cpd[ANGLES] >> i) & 1:
            for p in range(count):
                wide = wide or abs(raw[p * height + i]) > pi
        if not wide:
            continue
        slope = past(work, height)
        if not steep:
            call(cpd[FUNCTION], x, inputs, work, slope)
            steep = True
        for p in range(count):
            line = 0.0
            for j in range(size):
                moved = 0.0
                for k in range(j + 1):
                    moved += lower[j * size + k] * points[p * size + k]
                line += slope[i * size + j] * moved
            off = raw[p * height + i] - line
            raw[p * height + i] = off - _TURN * round(off / _TURN) + line


@compiled
def _is_rounding(cpd, i, x, matrix, reference, raw, found, error):
    """Whether the error of a component may be rounding of its values."""
    size, height = cpd[SIZE], cpd[HEIGHT]
    least = numbers(cpd[LEAST])  # of the own noise, then the rounding of the rule
    variance, square = error[i * height + i], reference * reference
    for j in range(size):
        square += found[(1 + j) * height + i] ** 2
    if variance + least[i] > _PLAIN * square:
        return False
    variance, summands = abs(variance), abs(reference)
    if not variance > (least[height] * summands) ** 2:
        return True
    for j in range(size):
        summands += abs(matrix[i * size + j] * x[j])
    farthest = 0.0
    for p in range(cpd[COUNT]):
        farthest = max(farthest, abs(raw[p * height + i]))
    return not variance > (least[height] * (summands + farthest)) ** 2


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
def predict(cpd, cov, matrix, noise, out, half):
    """F P Fᵀ + noise; whether zeros of components without noise need not be told from rounding."""
    size, height = cpd[SIZE], cpd[HEIGHT]
    for i in range(height):
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += matrix[i * size + k] * cov[k * size + j]
            half[i * size + j] = total
    copy(noise, out, height * height)
    add_symmetric(half, matrix, out, height, size)
    if cpd[BARE] and size:
        for i in range(height):
            if not (cpd[BARE] >> i) & 1:
                continue
            most = 0.0
            for k in range(size):
                most += abs(matrix[i * size + k]) * sqrt(max(cov[k * size + k], 0.0))
            if not out[i * height + i] > _ROUNDING * most * most:
                return False
    return not cpd[UNSURE] or root(out, half, height, 1e-13)


@compiled
def nearest(cpd, value, reading):
    """Move angles of a reading to the branch nearest the value."""
    for i in range(cpd[HEIGHT]):
        if (cpd[ANGLES] >> i) & 1:
            off = reading[i] - value[i]
            if abs(off) > pi and isfinite(off):
                reading[i] -= _TURN * round(off / _TURN)
