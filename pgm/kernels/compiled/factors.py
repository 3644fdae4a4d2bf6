"""A CPD at one of its rows, linearised at a belief, in machine code."""

from __future__ import annotations

from math import pi, sqrt

from pgm.kernels.compiled import tables as t
from pgm.kernels.compiled.algebra import (
    add,
    clear,
    copy,
    mirror,
    product,
    root,
    transpose,
    unwhiten,
    width,
)
from pgm.kernels.compiled.memory import (
    call,
    compiled,
    every,
    give,
    numbers,
    past,
    places,
    some,
    take,
)
from pgm.kernels.compiled.packs import where, whole

# As of `gaussian`, `regression` and `moments`, for the floats of one belief.
_REGULAR, _PLAIN, _SURELY, _ROUNDING = 1e-11, 1e-16, 1.0 / 64.0, 1e-14
_TURN = 2.0 * pi


@compiled
def load(cpd, array, row, run, out, rows, columns):
    """Copy the matrix of an array at a row and a run; a vector is a matrix of one row."""
    source, wide = numbers(cpd[array]), width(columns, out)
    apart = cpd[array + 2]
    here = row * cpd[array + 1] + run * apart
    for i in range(rows):
        for j in range(columns):
            out[i * wide + j] = take(source, here, apart, out)
            here += cpd[array + 3]
        for j in range(columns, wide):
            out[i * wide + j] = 0.0


@compiled
def save(cpd, array, row, run, values, rows, columns):
    """Put a matrix into an array at a row and a run, if there is one."""
    if cpd[array]:
        target, wide = numbers(cpd[array]), width(columns, values)
        apart = cpd[array + 2]
        here = row * cpd[array + 1] + run * apart
        for i in range(rows):
            for j in range(columns):
                give(target, here, apart, values[i * wide + j], values)
                here += cpd[array + 3]


@compiled
def keep(cpd, row, run, x, value, matrix, noise, work):
    """Keep a linearisation, where that is asked for."""
    if cpd[t.KIND] == t.AFFINE or not cpd[t.MATRIX]:
        return
    size, height = cpd[t.SIZE], cpd[t.HEIGHT]
    wide = width(size, x)
    save(cpd, t.MATRIX, row, run, matrix, height, size)
    for i in range(height):
        work[i] = value[i]
        for k in range(size):
            work[i] -= matrix[i * wide + k] * x[k]
    save(cpd, t.OFFSET, row, run, work, 1, height)
    if cpd[t.KIND] == t.REGRESSION:
        save(cpd, t.KEPT_NOISE, row, run, noise, height, height)


@compiled
def gather(chosen, size, mean, cov, wide, x, spread):
    """Some components of a belief, whose covariance has rows of so many."""
    own = width(size, spread)
    clear(spread, size * own)
    for i in range(size):
        x[i] = mean[chosen[i]]
        for j in range(size):
            spread[i * own + j] = cov[chosen[i] * wide + chosen[j]]


@compiled
def evaluate(cpd, function, row, run, x, value, slope):
    """Call a function of a CPD, `VALUE` or `FUNCTION`."""
    apart = cpd[t.INPUTS + 2]
    inputs = past(numbers(cpd[t.INPUTS]), row * cpd[t.INPUTS + 1] + run * apart)
    call(cpd[function], x, inputs, apart, value, slope)


@compiled
def linearise(cpd, row, run, x, cov, matrix, value, noise, work):
    """The F, F μ + b and noise of a CPD at a belief over its parents; whether that has a root."""
    size, height, kind = cpd[t.SIZE], cpd[t.HEIGHT], cpd[t.KIND]
    load(cpd, t.NOISE, row, run, noise, height, height)
    if kind == t.REGRESSION:
        return _regress(cpd, row, run, x, cov, matrix, value, noise, work)
    if kind == t.TAYLOR:
        evaluate(cpd, t.FUNCTION, row, run, x, value, matrix)
    else:
        load(cpd, t.MATRIX, row, run, matrix, height, size)
        load(cpd, t.OFFSET, row, run, value, 1, height)
        wide = width(size, matrix)
        for i in range(height):
            for k in range(size):
                value[i] += matrix[i * wide + k] * x[k]
    return True


@compiled
def _regress(cpd, row, run, x, cov, matrix, value, noise, work):
    size, height, count = cpd[t.SIZE], cpd[t.HEIGHT], cpd[t.COUNT]
    wide, tall = width(size, x), width(height, x)
    points = numbers(cpd[t.POINTS])
    rows, signs = past(points, count * size), past(points, count * (size + count))
    upper, inverse = work, past(work, size * wide)
    at, raw = past(inverse, wide), past(inverse, wide * (count + 1))
    found, error = past(raw, count * tall), past(raw, 2 * count * tall)
    ok = root(cov, upper, inverse, size, _REGULAR) > 0.0
    if not some(ok):
        return ok
    for p in range(count):
        copy(x, past(at, p * wide), wide)
    add(1.0, points, size, 1, upper, at, count, size, wide)
    clear(raw, count * tall)
    for p in range(count):
        evaluate(cpd, t.VALUE, row, run, past(at, p * wide), past(raw, p * tall), matrix)
    if cpd[t.ANGLES] and not cpd[t.CENTRED]:
        evaluate(cpd, t.VALUE, row, run, x, value, matrix)
    else:
        copy(raw, value, tall)
    for p in range(count):
        for i in range(height):
            raw[p * tall + i] -= value[i]
    if cpd[t.ANGLES]:
        _about(cpd, row, run, x, at, raw, found)
    product(rows, count, 1, raw, found, count, count, tall)
    slope, left = past(found, tall), past(found, (1 + size) * tall)
    clear(error, height * tall)
    for p in range(count - 1 - size):
        add(signs[p], past(left, p * tall), 1, 1, past(left, p * tall), error, height, 1, tall)
    for i in range(height):  # the sizes of slopes, beside which rounding is told
        matrix[i] = value[i] * value[i]
        for j in range(size):
            matrix[i] += slope[j * tall + i] * slope[j * tall + i]
    sound = True
    least = numbers(cpd[t.LEAST])  # of the own noise, then the rounding of the rule
    plain = max(_PLAIN, _SURELY * least[height] * least[height])
    for i in range(height):
        sound = sound & (error[i * tall + i] + least[i] > plain * matrix[i])
    sizes = past(error, height * tall)
    copy(matrix, sizes, height)
    unwhiten(upper, inverse, slope, size, tall)  # F L = J
    transpose(slope, matrix, size, height)
    if not every(sound):
        _clear_rounding(cpd, x, matrix, value, raw, error, sizes)
    for i in range(height):
        value[i] += found[i]
    for i in range(height * tall):
        noise[i] += error[i]
    mirror(noise, height)
    return ok


@compiled
def _about(cpd, row, run, x, at, raw, work):
    """Offsets of angles of which some exceed half a turn, wrapped about their line."""
    size, height, count, steep = cpd[t.SIZE], cpd[t.HEIGHT], cpd[t.COUNT], False
    wide, tall = width(size, x), width(height, x)
    slope = past(work, tall)
    for i in range(height):
        if not (cpd[t.ANGLES] >> i) & 1:
            continue
        far = abs(raw[i]) > pi
        for p in range(1, count):
            far = far | (abs(raw[p * tall + i]) > pi)
        if not some(far):
            continue
        if not steep:
            evaluate(cpd, t.FUNCTION, row, run, x, work, slope)
            steep = True
        for p in range(count):
            line = 0.0
            for j in range(size):
                line += slope[i * wide + j] * (at[p * wide + j] - x[j])
            off = raw[p * tall + i] - line
            turned = off - _TURN * whole(off / _TURN) + line
            raw[p * tall + i] = where(far, turned, raw[p * tall + i])


@compiled
def _clear_rounding(cpd, x, matrix, reference, raw, error, sizes):
    """Make the error zero in components in which it may be rounding of the values."""
    size, height = cpd[t.SIZE], cpd[t.HEIGHT]
    wide, tall = width(size, x), width(height, x)
    least = numbers(cpd[t.LEAST])
    plain = max(_PLAIN, _SURELY * least[height] * least[height])
    for i in range(height):
        variance, summands, farthest = error[i * tall + i], abs(reference[i]), 0.0
        for j in range(size):
            summands += abs(matrix[i * wide + j] * x[j])
        for p in range(cpd[t.COUNT]):
            far = abs(raw[p * tall + i])
            farthest = where(far > farthest, far, farthest)
        most = least[height] * (summands + farthest)
        sound = (variance + least[i] > plain * sizes[i]) | (abs(variance) > most * most)
        for j in range(height):
            error[i * tall + j] = where(sound, error[i * tall + j], 0.0)
            error[j * tall + i] = where(sound, error[j * tall + i], 0.0)


@compiled
def to_chart(cpd, row, run, before, x, value, work):
    """Take off the whole turns by which a function wraps angles, counted from the step before.

    One that wraps gives the same for angles a whole turn on; another turns too.
    """
    size, height = cpd[t.SIZE], cpd[t.HEIGHT]
    pairs, near = places(cpd[t.TURNING]), True
    for k in range(cpd[t.TURNS]):
        near = near & (abs(value[pairs[3 * k]] - before[pairs[3 * k + 1]]) <= pi)
    if every(near):
        return
    at, ends, slope = work, past(work, size), past(work, size + 2 * height)
    copy(x, at, size)
    evaluate(cpd, t.VALUE, row, run, at, ends, slope)
    for k in range(cpd[t.TURNS]):
        at[pairs[3 * k + 2]] += _TURN
    evaluate(cpd, t.VALUE, row, run, at, past(ends, height), slope)
    for k in range(cpd[t.TURNS]):
        new = pairs[3 * k]
        turns = whole((value[new] - before[pairs[3 * k + 1]]) / _TURN)
        wraps = abs(ends[height + new] - ends[new]) < pi
        value[new] = where(wraps, value[new] - _TURN * turns, value[new])


@compiled
def predict(cpd, cov, matrix, noise, out, work):
    """F P Fᵀ + noise; whether zeros of components without noise need not be told from rounding."""
    size, height = cpd[t.SIZE], cpd[t.HEIGHT]
    wide, tall = width(size, cov), width(height, cov)
    half, turned = work, past(work, height * wide)
    product(matrix, wide, 1, cov, half, height, size, wide)
    transpose(matrix, turned, height, size)
    copy(noise, out, height * tall)
    add(1.0, half, wide, 1, turned, out, height, size, tall)
    mirror(out, height)
    ok = True
    if cpd[t.BARE] and size:
        for i in range(height):
            if not (cpd[t.BARE] >> i) & 1:
                continue
            most = 0.0
            for k in range(size):
                variance = cov[k * wide + k]
                most += abs(matrix[i * wide + k]) * sqrt(where(variance > 0.0, variance, 0.0))
            ok = ok & (out[i * tall + i] > _ROUNDING * most * most)
    if cpd[t.UNSURE]:
        ok = ok & (root(out, work, past(work, height * tall), height, 1e-13) > 0.0)
    return ok


@compiled
def nearest(cpd, value, reading):
    """Move angles of a reading to the branch nearest the value."""
    for i in range(cpd[t.HEIGHT]):
        if (cpd[t.ANGLES] >> i) & 1:
            off = reading[i] - value[i]
            far = (abs(off) > pi) & (off - off == 0.0)
            reading[i] = where(far, reading[i] - _TURN * whole(off / _TURN), reading[i])
