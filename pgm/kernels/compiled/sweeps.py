"""Forward and backward sweeps of a chain in machine code, a run after another.

A chain is a row of integers, as a CPD is one (`factors`): its shape, the addresses of its tables
of CPDs, and its arrays, by step where those of a CPD are by row.
"""

from __future__ import annotations

from math import isfinite, log, sqrt
from typing import Any

from numba import njit

from pgm.kernels.arrays import LOG_2PI
from pgm.kernels.compiled.algebra import (
    add_symmetric,
    compiled,
    copy,
    least_open,
    product,
    root,
    times,
    unwhiten,
    whiten,
)
from pgm.kernels.compiled.factors import (
    AFFINE,
    CHILD,
    COLUMNS,
    HEIGHT,
    KEPT_NOISE,
    KIND,
    MATRIX,
    MOVED,
    OFFSET,
    PARENTS,
    READINGS,
    SIZE,
    STEPS,
    WHOLE,
    gather,
    linearise,
    load,
    nearest,
    predict,
    save,
    to_chart,
)
from pgm.kernels.compiled.memory import numbers, past, places

# The shape of a chain: T, whether one CPD makes all of a slice of all of the one before, and the
# components of states and of a slice.
(LAST, SINGLE, FRONT, WIDTH, LINKS, LINK_COUNT, SENSORS, SENSOR_COUNT, STATES) = range(9)
# Linearisations of a step's measurements, where their settings are, (tolerance, damping), and their
# record, (runs, iterations + 1): the residuals of each, how many, and whether some did not settle.
(ITERATIONS, SETTINGS, RESIDUALS) = range(9, 12)
# The least share of a variance that is left open, by run; how runs ended.
(CLOSEST, STATUS) = range(12, 14)
# The belief that a sweep starts with, and its record.
(BEGIN_MEAN, BEGIN_COV, PREDICTED_MEAN, PREDICTED_COV, MEAN, COV, DENSITY) = range(16, 44, 4)
# The reversed chain, its transition, and the smoothed beliefs.
(STEP_MATRIX, STEP_NOISE, GAIN, SHIFT, REST, LATER_MEAN, LATER_COV) = range(44, 72, 4)
(CONTROL_GAIN, CONTROL_SHIFT, CONTROL_REST) = range(72, 84, 4)
FIELDS = 84
# Runs whose arrays lie next to each other are swept together, so that memory is read in rows.
_TOGETHER = 64
# As of `gaussian`, `moments` and `forward`.
NEARLY_SINGULAR, _NEGLIGIBLE, _EVERY, _MILD = 1e-6, 1e-15, 8, 1e-3
# How a run ended: done, or to be done by the general kernels.
DONE, LEFT = 0, 1


def room(width: int, front: int, height: int, points: int) -> int:
    """How many floats of memory a sweep works in; its components and points are the largest."""
    size = max(width + front, height)
    return 16 * size * size + 16 * size + points * (size + 2 * height) + points * points


@compiled
def _step(fields, step, run, work):
    """Predict a step of a run and take in its measurements; whether that went without a doubt."""
    size = fields[WIDTH]
    mean, cov = work, past(work, size)
    known, spread = past(cov, size * size), past(cov, size * size + size)
    rest = past(spread, size * size)
    if not step:
        load(fields, BEGIN_MEAN, 0, run, mean, size)
        load(fields, BEGIN_COV, 0, run, cov, size * size)
    else:
        load(fields, MEAN, step - 1, run, known, size)
        load(fields, COV, step - 1, run, spread, size * size)
        if fields[SINGLE]:
            ok = _moved(fields, step - 1, run, known, spread, mean, cov, rest)
        else:
            ok = _joined(fields, step - 1, run, known, spread, mean, cov, rest)
        if not ok:
            return False
    save(fields, PREDICTED_MEAN, step, run, mean, size)
    save(fields, PREDICTED_COV, step, run, cov, size * size)
    ok, density = _taken(fields, step, run, mean, cov, known, spread, rest)
    total = density
    for i in range(size):
        total += known[i] + spread[i * size + i]
    if not (ok and isfinite(total)):
        return False
    save(fields, MEAN, step, run, known, size)
    save(fields, COV, step, run, spread, size * size)
    rest[0] = density
    save(fields, DENSITY, step, run, rest, 1)
    if fields[CLOSEST]:
        closest = past(numbers(fields[CLOSEST]), run)
        _look(closest, cov, spread, size, step, fields[LAST], rest)
    return True


@compiled
def _look(closest, before, after, size, step, last, work):
    """Look how much of variances is left open; see `Watch`."""
    least = 1.0
    for i in range(size):
        was, left = before[i * size + i], after[i * size + i]
        if left != 0.0 and was > 0.0:
            least = min(least, left / was)
    sharp = least < _MILD
    if sharp:
        least = min(least, least_open(before, work, size))
    if sharp or step == last or step % _EVERY == 0:
        least = min(least, least_open(after, work, size))
    closest[0] = min(closest[0], least)


@compiled
def _moved(fields, row, run, before, spread, mean, cov, work):
    """The slice, where one CPD makes all of it of all of the slice before."""
    cpd = places(fields[LINKS])
    size = cpd[SIZE]
    matrix, noise = work, past(work, size * size)
    rest = past(noise, size * size)
    error = linearise(cpd, row, run, before, spread, matrix, mean, noise, rest)
    if error < 0 or not predict(cpd, spread, matrix, noise, cov, rest):
        return False
    to_chart(cpd, row, run, before, before, mean, rest)
    _keep(cpd, row, run, before, mean, matrix, noise, error, rest)
    return True


@compiled
def _keep(cpd, row, run, x, value, matrix, noise, error, work):
    """Keep a linearisation, where that is asked for."""
    if cpd[KIND] == AFFINE or not cpd[MATRIX]:
        return
    size, height = cpd[SIZE], cpd[HEIGHT]
    save(cpd, MATRIX, row, run, matrix, height * size)
    times(matrix, x, work, height, size)
    for i in range(height):
        work[i] = value[i] - work[i]
    save(cpd, OFFSET, row, run, work, height)
    if error:
        save(cpd, KEPT_NOISE, row, run, noise, height * height)


@compiled
def _joined(fields, row, run, known, spread, mean, cov, work):
    """The slice, a CPD after another, in the joint of the states before and itself."""
    front, width = fields[FRONT], fields[WIDTH]
    size = front + width
    states = places(fields[STATES])
    pair, joint = work, past(work, size)
    x, block = past(joint, size * size), past(joint, size * size + size)
    matrix = past(block, size * size)
    noise, value = past(matrix, size * size), past(matrix, 2 * size * size)
    own = past(value, size)
    rest = past(own, size * size)
    for i in range(size * size):
        joint[i] = 0.0
    for i in range(front):
        pair[i] = known[states[i]]
        for j in range(front):
            joint[i * size + j] = spread[states[i] * width + states[j]]
    for link in range(fields[LINK_COUNT]):
        cpd = past(places(fields[LINKS]), link * COLUMNS)
        count, height, child, parents = cpd[SIZE], cpd[HEIGHT], cpd[CHILD], places(cpd[PARENTS])
        gather(cpd, pair, joint, size, x, block)
        error = linearise(cpd, row, run, x, block, matrix, value, noise, rest)
        if error < 0 or not predict(cpd, block, matrix, noise, own, rest):
            return False
        for i in range(height):
            for j in range(size):
                total = 0.0
                for k in range(count):
                    total += matrix[i * count + k] * joint[parents[k] * size + j]
                rest[i * size + j] = total
        for i in range(height):
            for j in range(size):
                joint[(child + i) * size + j] = rest[i * size + j]
                joint[j * size + child + i] = rest[i * size + j]
        for i in range(height):
            for j in range(height):
                joint[(child + i) * size + child + j] = own[i * height + j]
        to_chart(cpd, row, run, pair, x, value, rest)
        _keep(cpd, row, run, x, value, matrix, noise, error, rest)
        copy(value, past(pair, child), height)
    for i in range(width):
        mean[i] = pair[front + i]
        for j in range(width):
            cov[i * width + j] = joint[(front + i) * size + front + j]
    return True


@compiled
def _taken(fields, step, run, mean, cov, known, spread, work):
    """The belief given the measurements of a step; whether all was regular, and their density."""
    size, iterations = fields[WIDTH], fields[ITERATIONS]
    if iterations < 2 or not _are_curved(fields, step):
        return _once(fields, step, run, mean, cov, mean, cov, known, spread, work)
    point, about = work, past(work, size)
    rest = past(about, size * size)
    copy(mean, point, size)
    copy(cov, about, size * size)
    settings = numbers(fields[SETTINGS])
    record = past(numbers(fields[RESIDUALS]), run * (iterations + 1))
    density, residual, made = 0.0, 0.0, 0
    for iteration in range(iterations):
        ok, density = _once(fields, step, run, mean, cov, point, about, known, spread, rest)
        if not ok:
            return ok, density
        if iteration:
            residual, made = 0.0, iteration
            for i in range(size):
                unit = sqrt(max(spread[i * size + i], 0.0))
                unit = unit if unit > 0.0 else max(abs(known[i]), 1.0)
                residual = max(residual, abs(known[i] - point[i]) / unit)
            record[iteration - 1] = max(record[iteration - 1], residual)
            if residual <= settings[0]:
                break
        for i in range(size):
            point[i] = settings[1] * point[i] + (1.0 - settings[1]) * known[i]
        for i in range(size * size):
            about[i] = settings[1] * about[i] + (1.0 - settings[1]) * spread[i]
    for later in range(made, iterations - 1):
        record[later] = max(record[later], residual)
    record[iterations - 1] = max(record[iterations - 1], 1.0 * made)
    if not residual <= settings[0]:
        record[iterations] = 1.0
    return True, density


@compiled
def _are_curved(fields, step):
    """Whether a measurement of a step has to be linearised."""
    for k in range(fields[SENSOR_COUNT]):
        cpd = past(places(fields[SENSORS]), k * COLUMNS)
        bounds = places(cpd[STEPS])
        if cpd[KIND] != AFFINE and bounds[step] < bounds[step + 1]:
            return True
    return False


@compiled
def _once(fields, step, run, mean, cov, point, about, known, spread, work):
    """Take the measurements of a step, linearised at a point, into N(mean, cov)."""
    size, density = fields[WIDTH], 0.0
    copy(mean, known, size)
    copy(cov, spread, size * size)
    for k in range(fields[SENSOR_COUNT]):
        cpd = past(places(fields[SENSORS]), k * COLUMNS)
        bounds = places(cpd[STEPS])
        for row in range(bounds[step], bounds[step + 1]):
            ok, more = _read(cpd, row, run, size, point, about, known, spread, work)
            density += more
            if not ok:
                return False, density
    return True, density


@compiled
def _read(cpd, row, run, size, point, about, known, spread, work):
    """Take in a measurement, linearised at a point; its missing components are NaN."""
    count, height, parents = cpd[SIZE], cpd[HEIGHT], places(cpd[PARENTS])
    matrix, noise = work, past(work, height * size)
    value, reading = past(noise, height * height), past(noise, height * height + height)
    x = past(reading, height)
    block = past(x, size)
    rest = past(block, size * size)
    if cpd[WHOLE]:  # all of the slice, in its order
        error = linearise(cpd, row, run, point, about, matrix, value, noise, rest)
        _keep(cpd, row, run, point, value, matrix, noise, error, rest)
    else:
        gather(cpd, point, about, size, x, block)
        error = linearise(cpd, row, run, x, block, matrix, value, noise, rest)
        _keep(cpd, row, run, x, value, matrix, noise, error, rest)
    if error < 0:
        return False, 0.0
    load(cpd, READINGS, row, run, reading, height)
    nearest(cpd, value, reading)
    save(cpd, MOVED, row, run, reading, height)
    if not cpd[WHOLE]:
        copy(matrix, rest, height * count)
        for i in range(height * size):
            matrix[i] = 0.0
        for i in range(height):
            for j in range(count):
                matrix[i * size + parents[j]] = rest[i * count + j]
    seen = 0
    for i in range(height):
        if reading[i] != reading[i]:
            continue
        residual = reading[i] - value[i]
        for j in range(size):
            residual -= matrix[i * size + j] * (known[j] - point[j])
            matrix[seen * size + j] = matrix[i * size + j]
        # Rows and columns before these have been moved already.
        for j in range(height):
            noise[seen * height + j] = noise[i * height + j]
        for j in range(height):
            noise[j * height + seen] = noise[j * height + i]
        value[seen] = residual
        seen += 1
    if not seen:
        return True, 0.0
    for i in range(seen):
        for j in range(seen):
            noise[i * seen + j] = noise[i * height + j]
    return _update(known, spread, matrix, value, noise, size, seen, rest)


@compiled
def _update(mean, cov, matrix, residual, noise, size, height, work):
    """Condition N(mean, cov) on z = H x + n, of residual z − H mean, as `gaussian.update_one`."""
    gain, predictive = work, past(work, height * size)
    lower, white = past(predictive, height * height), past(predictive, 2 * height * height)
    keep = past(white, height)
    spread, half = past(keep, size * size), past(keep, 2 * size * size)
    product(matrix, cov, gain, height, size, size)
    copy(noise, predictive, height * height)
    add_symmetric(gain, matrix, predictive, height, size)
    if not root(predictive, lower, height, NEARLY_SINGULAR):
        return False, 0.0
    copy(residual, white, height)
    whiten(lower, white, height, 1)
    density, volume = -0.5 * height * LOG_2PI, 0.0
    for i in range(height):
        density -= 0.5 * white[i] * white[i]
        volume += log(lower[i * height + i])
    whiten(lower, gain, height, size)
    unwhiten(lower, gain, height, size)  # Gᵀ
    for i in range(size):
        for k in range(height):
            mean[i] += gain[k * size + i] * residual[k]
    _squares(cov, gain, matrix, noise, size, height, keep, half, spread)
    copy(spread, cov, size * size)
    return True, density - volume


@compiled
def _squares(cov, gain, matrix, noise, size, height, keep, half, out):
    """The covariance (I − G H) P (I − G H)ᵀ + G noise Gᵀ, given Gᵀ (height, size)."""
    for i in range(size):
        for j in range(size):
            total = 1.0 if i == j else 0.0
            for k in range(height):
                total -= gain[k * size + i] * matrix[k * size + j]
            keep[i * size + j] = total
    product(noise, gain, half, height, height, size)
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for k in range(height):
                total += gain[k * size + i] * half[k * size + j]
            out[i * size + j] = total
    product(keep, cov, half, size, size, size)
    add_symmetric(half, keep, out, size, size)


@compiled
def _back(fields, step, run, work):
    """Reverse the transition from a step, and send the belief after it through."""
    width, front, smooths = fields[WIDTH], fields[FRONT], fields[LATER_MEAN]
    mean, cov = work, past(work, width)
    rest = past(cov, width * width)
    if step == fields[LAST]:
        load(fields, MEAN, step, run, mean, width)
        load(fields, COV, step, run, cov, width * width)
        save(fields, LATER_MEAN, step, run, mean, width)
        save(fields, LATER_COV, step, run, cov, width * width)
        return True
    gain, shift = rest, past(rest, front * width)
    left = past(shift, front)
    rest = past(left, front * front)
    if not _reverse(fields, step, run, gain, shift, left, rest):
        return False
    save(fields, GAIN, step, run, gain, front * width)
    save(fields, SHIFT, step, run, shift, front)
    save(fields, REST, step, run, left, front * front)
    if not smooths:
        return True
    load(fields, LATER_MEAN, step + 1, run, mean, width)
    load(fields, LATER_COV, step + 1, run, cov, width * width)
    _push(gain, shift, left, mean, cov, front, width, rest)
    if fields[CONTROL_GAIN]:
        load(fields, CONTROL_GAIN, step, run, gain, width * front)
        load(fields, CONTROL_SHIFT, step, run, shift, width)
        left = past(shift, width)
        rest = past(left, width * width)
        load(fields, CONTROL_REST, step, run, left, width * width)
        _push(gain, shift, left, mean, cov, width, front, rest)
    save(fields, LATER_MEAN, step, run, mean, width)
    save(fields, LATER_COV, step, run, cov, width * width)
    return True


@compiled
def _reverse(fields, step, run, gain, shift, left, work):
    """Bayes' rule for the transition from a step, as `moments.reverse`."""
    width, front, states = fields[WIDTH], fields[FRONT], places(fields[STATES])
    mean, cov = work, past(work, width)
    matrix, noise = past(cov, width * width), past(cov, width * (width + front))
    after, later = past(noise, width * width), past(noise, width * width + width)
    lower = past(later, width * width)
    back, keep = past(lower, width * width), past(lower, width * (width + front))
    half = past(keep, front * front)
    load(fields, MEAN, step, run, after, width)
    load(fields, COV, step, run, later, width * width)
    for i in range(front):
        mean[i] = after[states[i]]
        for j in range(front):
            cov[i * front + j] = later[states[i] * width + states[j]]
    load(fields, STEP_MATRIX, step, run, matrix, width * front)
    load(fields, STEP_NOISE, step, run, noise, width * width)
    load(fields, PREDICTED_MEAN, step + 1, run, after, width)
    load(fields, PREDICTED_COV, step + 1, run, later, width * width)
    if not root(later, lower, width, _NEGLIGIBLE):
        return False
    product(matrix, cov, back, width, front, front)
    whiten(lower, back, width, front)
    unwhiten(lower, back, width, front)  # Gᵀ
    for i in range(front):
        total = mean[i]
        for k in range(width):
            gain[i * width + k] = back[k * front + i]
            total -= back[k * front + i] * after[k]
        shift[i] = total
    _squares(cov, back, matrix, noise, front, width, keep, half, left)
    return isfinite(shift[0])


@compiled
def _push(matrix, offset, noise, mean, cov, height, size, work):
    """Moments of F x + b + n in the place of those of x."""
    moved, half = work, past(work, height)
    times(matrix, mean, moved, height, size)
    for i in range(height):
        moved[i] += offset[i]
    product(matrix, cov, half, height, size, size)
    add_symmetric(half, matrix, noise, height, size)
    copy(moved, mean, height)
    copy(noise, cov, height * height)


_kept: Any = njit("void(int64,int64,int64,int64)", error_model="numpy", nogil=True, cache=True)


@_kept
def forward(chain, first, last, memory):
    """Sweep some runs of the chain at an address forward; `memory` is the address of `room`."""
    fields, work = places(chain), numbers(memory)
    status = places(fields[STATUS])
    for begin in range(first, last, _TOGETHER):
        end = min(begin + _TOGETHER, last)
        for step in range(fields[LAST] + 1):
            for run in range(begin, end):
                if status[run] == DONE and not _step(fields, step, run, work):
                    status[run] = LEFT


@_kept
def backward(chain, first, last, memory):
    """Reverse the transitions of some runs, and send the last belief back, if it has a place."""
    fields, work = places(chain), numbers(memory)
    status = places(fields[STATUS])
    for begin in range(first, last, _TOGETHER):
        end = min(begin + _TOGETHER, last)
        for step in range(fields[LAST], -1, -1):
            for run in range(begin, end):
                if status[run] == DONE and not _back(fields, step, run, work):
                    status[run] = LEFT
