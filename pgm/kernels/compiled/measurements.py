"""Measurements of a step in machine code: they are taken into its belief, one after another."""

from __future__ import annotations

from math import sqrt

from pgm.kernels.arrays import LAST_PLACES, LOG_2PI
from pgm.kernels.compiled import tables as t
from pgm.kernels.compiled.algebra import (
    add,
    clear,
    copy,
    log_det,
    product,
    root,
    squares,
    unwhiten,
    whiten,
    width,
)
from pgm.kernels.compiled.factors import gather, keep, linearise, load, nearest, save
from pgm.kernels.compiled.memory import compiled, every, give, numbers, past, places, some, take
from pgm.kernels.compiled.packs import where

# As of `gaussian`.
_NEARLY_SINGULAR = 1e-6
# The part of S (10 + rᵀ S⁻¹ r) that noise has to exceed in all directions. Below, a belief that is
# linearised again, or any, is not known to a billionth of a deviation: an order of sums shows.
_CURVED, _STRAIGHT = 1e-6, 1e-8
# A length rᵀ S⁻¹ r from which on little or nothing can be told.
_FARTHEST = 1e12


@compiled
def taken(fields, step, run, mean, cov, known, spread, work):
    """The belief given the measurements of a step; whether all was regular, and their density."""
    size, iterations, apart = fields[t.WIDTH], fields[t.ITERATIONS], fields[t.RUN_COUNT]
    wide = width(size, work)
    if iterations < 2 or not _are_curved(fields, step):
        return once(fields, step, run, mean, cov, mean, cov, known, spread, work)
    point, about = work, past(work, wide)
    rest = past(about, size * wide)
    copy(mean, point, size)
    copy(cov, about, size * wide)
    tolerance, damping = numbers(fields[t.SETTINGS])[0], numbers(fields[t.SETTINGS])[1]
    record = past(numbers(fields[t.RESIDUALS]), run)
    residual, made, settled, last = 0.0, 0.0, False, 0
    ok, density = once(fields, step, run, mean, cov, point, about, known, spread, rest)
    for iteration in range(1, iterations):
        if every(settled) or not some(ok):
            break
        for i in range(size):
            mixed = damping * point[i] + (1.0 - damping) * known[i]
            point[i] = where(settled, point[i], mixed)
        for i in range(size * wide):
            mixed = damping * about[i] + (1.0 - damping) * spread[i]
            about[i] = where(settled, about[i], mixed)
        ok, density = once(fields, step, run, mean, cov, point, about, known, spread, rest)
        residual, last = 0.0, iteration
        made = where(settled, made, 1.0 * iteration)
        for i in range(size):
            variance, size_of = spread[i * wide + i], abs(known[i])
            unit = where(size_of > 1.0, size_of, 1.0)
            unit = where(variance > 0.0, sqrt(variance), unit)
            larger = where(abs(known[i]) > abs(point[i]), abs(known[i]), abs(point[i]))
            moved = abs(known[i] - point[i]) - LAST_PLACES * larger
            moved = where(moved < 0.0, 0.0, moved) / unit  # NaN stays
            residual = where(residual > moved, residual, moved)
        settled = settled | (residual <= tolerance)
        _at_most(record, (iteration - 1) * apart, residual, known)
    for later in range(last, iterations - 1):
        _at_most(record, later * apart, residual, known)
    _at_most(record, (iterations - 1) * apart, made, known)
    _at_most(record, iterations * apart, where(settled, 0.0, 1.0), known)
    return ok, density


@compiled
def _at_most(record, place, value, like):
    """Let a float of a record be no less than a value."""
    known = take(record, place, 1, like)
    give(record, place, 1, where(known > value, known, value), like)


@compiled
def _are_curved(fields, step):
    """Whether a measurement of a step has to be linearised."""
    for k in range(fields[t.SENSOR_COUNT]):
        cpd = past(places(fields[t.SENSORS]), k * t.COLUMNS)
        bounds = places(cpd[t.STEPS])
        if cpd[t.KIND] != t.AFFINE and bounds[step] < bounds[step + 1]:
            return True
    return False


@compiled
def once(fields, step, run, mean, cov, point, about, known, spread, work):
    """Take the measurements of a step, linearised at a point, into N(mean, cov)."""
    size, ok, density = fields[t.WIDTH], True, 0.0
    wide = width(size, work)
    copy(mean, known, wide)
    copy(cov, spread, size * wide)
    for k in range(fields[t.SENSOR_COUNT]):
        cpd = past(places(fields[t.SENSORS]), k * t.COLUMNS)
        bounds = places(cpd[t.STEPS])
        for row in range(bounds[step], bounds[step + 1]):
            sure, more = _read(cpd, row, run, size, cov, point, about, known, spread, work)
            ok = ok & sure
            density += more
            if not some(ok):
                return ok, density
    return ok, density


@compiled
def _read(cpd, row, run, size, before, point, about, known, spread, work):
    """Take in a measurement, linearised at a point; its missing components are NaN.

    `before` is the covariance before those of its step.
    """
    count, height, wide = cpd[t.SIZE], cpd[t.HEIGHT], width(size, work)
    thick, tall = width(count, work), width(height, work)
    matrix, noise = work, past(work, height * wide)
    value, reading = past(noise, height * tall), past(noise, (height + 1) * tall)
    rest = past(reading, tall)
    x, block, parents = point, about, places(cpd[t.PARENTS])
    if not cpd[t.WHOLE]:
        x, block = rest, past(rest, thick)
        rest = past(block, count * thick)
        gather(parents, count, point, about, wide, x, block)
    ok = linearise(cpd, row, run, x, block, matrix, value, noise, rest)
    keep(cpd, row, run, x, value, matrix, noise, rest)
    load(cpd, t.READINGS, row, run, reading, 1, height)
    nearest(cpd, value, reading)
    save(cpd, t.MOVED, row, run, reading, 1, height)
    if not cpd[t.WHOLE]:
        copy(matrix, rest, height * thick)
        clear(matrix, height * wide)
        for i in range(height):
            for j in range(count):
                matrix[i * wide + parents[j]] = rest[i * thick + j]
    sharp, density, unseen = numbers(cpd[t.SHARP])[0], 0.0, True
    for i in range(height):
        seen = reading[i] == reading[i]
        residual = reading[i] - value[i]
        for j in range(size):
            residual -= matrix[i * wide + j] * (known[j] - point[j])
        value[i] = residual
        density = where(seen, density + LOG_2PI, density)
        unseen = unseen & (reading[i] != reading[i])
        if every(seen):
            continue
        # One that is missing is as a reading of noise alone.
        value[i], sharp = where(seen, residual, 0.0), where(seen, sharp, 0.0)
        for j in range(size):
            matrix[i * wide + j] = where(seen, matrix[i * wide + j], 0.0)
        for j in range(height):
            noise[i * tall + j] = where(seen, noise[i * tall + j], 0.0)
            noise[j * tall + i] = where(seen, noise[j * tall + i], 0.0)
        noise[i * tall + i] = where(seen, noise[i * tall + i], 1.0)
    if every(unseen) or not some(ok):
        return ok, 0.0 * density
    limits = sharp, _STRAIGHT if cpd[t.KIND] == t.AFFINE else _CURVED
    sure, density = _update(
        known, spread, before, matrix, value, noise, size, height, limits, density, rest
    )
    return ok & sure, density


@compiled
def _update(mean, cov, before, matrix, residual, noise, size, height, limits, density, work):
    """Condition N(mean, cov) on z = H x + n, of residual z − H mean; whether digits are left.

    Where |S| is below the first limit no direction shrinks so much that P − W Wᵀ would lose digits,
    and elsewhere the covariance is a sum of squares; the other says how sharp n may be beside the
    covariance before its step.
    """
    wide, tall = width(size, work), width(height, work)
    predictive, upper = work, past(work, height * tall)
    inverse, white = past(upper, height * tall), past(upper, (height + 1) * tall)
    gain = past(white, tall)
    turned = past(gain, height * wide)
    spread = past(turned, height * wide)
    product(matrix, wide, 1, cov, gain, height, size, wide)
    _predictive(gain, matrix, noise, size, height, predictive)
    det = root(predictive, upper, inverse, height, _NEARLY_SINGULAR)
    ok = det > 0.0
    if not some(ok):
        return ok, density
    density += log_det(det, inverse, height)
    length = 0.0
    for i in range(height):
        total = residual[i]
        for k in range(i):
            total -= upper[k * tall + i] * white[k]
        white[i] = total * inverse[i]
        length += white[i] * white[i]
    density += length
    ok = ok & (length < _FARTHEST)
    whiten(upper, inverse, gain, height, wide)
    add(1.0, white, 1, 1, gain, mean, 1, height, wide)
    mild = det < limits[0]
    if not every(mild):
        copy(gain, turned, height * wide)
        unwhiten(upper, inverse, turned, height, wide)
        part = limits[1] * (10.0 + length)
        product(matrix, wide, 1, before, spread, height, size, wide)
        _predictive(spread, matrix, noise, size, height, predictive)
        for i in range(height * tall):
            predictive[i] = noise[i] - part * predictive[i]
        ok = ok & (mild | (root(predictive, upper, inverse, height, 0.0) > 0.0))
        squares(cov, turned, matrix, noise, size, height, spread, past(spread, size * wide))
    if some(mild):
        add(-1.0, gain, 1, wide, gain, cov, size, height, wide)
    if not every(mild):
        for i in range(size * wide):
            cov[i] = where(mild, cov[i], spread[i])
    return ok, -0.5 * density


@compiled
def _predictive(half, matrix, noise, size, height, out):
    """The lower part of H P Hᵀ + noise, given H P."""
    wide, tall = width(size, out), width(height, out)
    for i in range(height):
        for j in range(i + 1):
            total = noise[i * tall + j]
            for k in range(size):
                total += half[i * wide + k] * matrix[j * wide + k]
            out[i * tall + j] = total
