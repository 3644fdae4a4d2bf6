"""Forward and backward sweeps of a chain in machine code, a run after another.

A chain is a row of integers, as a CPD is one (`factors`): its shape, the addresses of its tables
of CPDs, and its arrays, by step where those of a CPD are by row.
"""

from __future__ import annotations

from math import isfinite, sqrt
from typing import Any

from numba import njit

from pgm.kernels.arrays import LOG_2PI
from pgm.kernels.compiled.algebra import (
    add,
    clear,
    compiled,
    copy,
    least_open,
    log_det,
    mirror,
    padded,
    product,
    root,
    squares,
    transpose,
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
    SHARP,
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
from pgm.kernels.compiled.memory import STAMP, numbers, past, places

# The shape of a chain: T, whether one CPD makes all of a slice of all of the one before, and the
# components of states and of a slice.
(LAST, SINGLE, FRONT, WIDTH, LINKS, LINK_COUNT, SENSORS, SENSOR_COUNT, STATES) = range(9)
# Linearisations of a step's measurements, where their settings are, (tolerance, damping), and their
# record, (runs, iterations + 1): the residuals of each, how many, and whether some did not settle.
(ITERATIONS, SETTINGS, RESIDUALS) = range(9, 12)
# The least share of a variance that is left open, and variances to grow from, by run; how runs
# ended.
(CLOSEST, STATUS) = range(12, 14)
# The belief that a sweep starts with, and its record.
(BEGIN_MEAN, BEGIN_COV, PREDICTED_MEAN, PREDICTED_COV, MEAN, COV, DENSITY) = range(16, 44, 4)
# The reversed chain, its transition, and the smoothed beliefs.
(STEP_MATRIX, STEP_NOISE, GAIN, SHIFT, REST, LATER_MEAN, LATER_COV) = range(44, 72, 4)
(CONTROL_GAIN, CONTROL_SHIFT, CONTROL_REST) = range(72, 84, 4)
FIELDS = 84
# Runs whose arrays lie next to each other are swept together, so that memory is read in rows.
TOGETHER = 64
# As of `gaussian`, `moments` and `forward`.
NEARLY_SINGULAR, _NEGLIGIBLE, _EVERY, _MILD, _GROWN = 1e-6, 1e-15, 8, 1e-3, 1e2
# How a run ended: done, or to be done by the general kernels.
DONE, LEFT = 0, 1


def room(width: int, front: int, height: int, points: int) -> int:
    """How many floats of memory a sweep works in; its components and points are the largest."""
    size = max(width + front, height) + 3
    return (16 + TOGETHER) * size * (size + 1) + points * (3 * size + points)


@compiled
def _step(fields, step, run, known, work):
    """Predict a step of a run and take in its measurements; whether that went without a doubt.

    The belief is that of the step before, and then of this one.
    """
    size = fields[WIDTH]
    wide = padded(size)
    spread = past(known, wide)
    mean, cov = work, past(work, wide)
    rest = past(cov, size * wide)
    if not step:
        load(fields, BEGIN_MEAN, 0, run, mean, 1, size)
        load(fields, BEGIN_COV, 0, run, cov, size, size)
    elif fields[SINGLE]:
        if not _moved(fields, step - 1, run, known, spread, mean, cov, rest):
            return False
    elif not _joined(fields, step - 1, run, known, spread, mean, cov, rest):
        return False
    save(fields, PREDICTED_MEAN, step, run, mean, 1, size)
    save(fields, PREDICTED_COV, step, run, cov, size, size)
    ok, density = _taken(fields, step, run, mean, cov, known, spread, rest)
    total = density
    for i in range(size):
        total += known[i] + spread[i * wide + i]
    if not (ok and isfinite(total)):
        return False
    save(fields, MEAN, step, run, known, 1, size)
    save(fields, COV, step, run, spread, size, size)
    rest[0] = density
    save(fields, DENSITY, step, run, rest, 1, 1)
    if fields[CLOSEST]:
        closest = past(numbers(fields[CLOSEST]), run * (size + 1))
        _look(closest, cov, spread, size, step, fields[LAST], rest)
    return True


@compiled
def _look(closest, before, after, size, step, last, work):
    """Look how much of variances is left open; see `Watch`."""
    least, wide, level, grown = 1.0, padded(size), past(closest, 1), False
    for i in range(size):
        was, left = before[i * wide + i], after[i * wide + i]
        grown = grown or was > _GROWN * level[i]
        if left < _MILD * was and left != 0.0 and was > 0.0:
            least = min(least, left / was)
    doubtful = grown or least < 1.0
    if doubtful:
        least = min(least, least_open(before, work, size))
    for i in range(size):
        if doubtful:
            level[i] = before[i * wide + i]
        if not step:
            level[i] = after[i * wide + i]
    if doubtful or step == last or step % _EVERY == 0:
        for i in range(size):
            level[i] = min(level[i], after[i * wide + i])
        least = min(least, least_open(after, work, size))
    closest[0] = min(closest[0], least)


@compiled
def _moved(fields, row, run, before, spread, mean, cov, work):
    """The slice, where one CPD makes all of it of all of the slice before."""
    cpd = places(fields[LINKS])
    size = cpd[SIZE]
    square = size * padded(size)
    matrix, noise, rest = work, past(work, square), past(work, 2 * square)
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
    wide = padded(size)
    save(cpd, MATRIX, row, run, matrix, height, size)
    for i in range(height):
        total = 0.0
        for k in range(size):
            total += matrix[i * wide + k] * x[k]
        work[i] = value[i] - total
    save(cpd, OFFSET, row, run, work, 1, height)
    if error:
        save(cpd, KEPT_NOISE, row, run, noise, height, height)


@compiled
def _joined(fields, row, run, known, spread, mean, cov, work):
    """The slice, a CPD after another, in the joint of the states before and itself."""
    front, width, states = fields[FRONT], fields[WIDTH], places(fields[STATES])
    size, own_wide = front + width, padded(width)
    wide = padded(size)
    square = size * wide
    pair, joint = work, past(work, wide)
    x, block = past(joint, square), past(joint, square + wide)
    matrix, noise = past(block, square), past(block, 2 * square)
    own, value = past(noise, square), past(noise, 2 * square)
    rest = past(value, wide)
    clear(joint, square)
    for i in range(front):
        pair[i] = known[states[i]]
        for j in range(front):
            joint[i * wide + j] = spread[states[i] * own_wide + states[j]]
    for link in range(fields[LINK_COUNT]):
        cpd = past(places(fields[LINKS]), link * COLUMNS)
        count, height, child, parents = cpd[SIZE], cpd[HEIGHT], cpd[CHILD], places(cpd[PARENTS])
        thick, tall = padded(count), padded(height)
        gather(parents, count, pair, joint, wide, x, block)
        error = linearise(cpd, row, run, x, block, matrix, value, noise, rest)
        if error < 0 or not predict(cpd, block, matrix, noise, own, rest):
            return False
        clear(rest, height * wide)
        for k in range(count):
            moved = past(joint, parents[k] * wide)
            add(1.0, past(matrix, k), thick, 1, moved, rest, height, 1, wide)
        for i in range(height):
            for j in range(size):
                joint[(child + i) * wide + j] = rest[i * wide + j]
                joint[j * wide + child + i] = rest[i * wide + j]
        for i in range(height):
            for j in range(height):
                joint[(child + i) * wide + child + j] = own[i * tall + j]
        to_chart(cpd, row, run, pair, x, value, rest)
        _keep(cpd, row, run, x, value, matrix, noise, error, rest)
        copy(value, past(pair, child), height)
    for i in range(width):
        mean[i] = pair[front + i]
        for j in range(width):
            cov[i * own_wide + j] = joint[(front + i) * wide + front + j]
        for j in range(width, own_wide):
            cov[i * own_wide + j] = 0.0
    return True


@compiled
def _taken(fields, step, run, mean, cov, known, spread, work):
    """The belief given the measurements of a step; whether all was regular, and their density."""
    size, iterations = fields[WIDTH], fields[ITERATIONS]
    wide = padded(size)
    point, about, rest = mean, cov, work
    if iterations > 1:
        if _are_curved(fields, step):
            point, about = work, past(work, wide)
            rest = past(about, size * wide)
            copy(mean, point, size)
            copy(cov, about, size * wide)
        else:
            iterations = 1
    settings = numbers(fields[SETTINGS])
    record = past(numbers(fields[RESIDUALS]), run * (iterations + 1))
    density, residual, made = 0.0, 0.0, 0
    for iteration in range(max(iterations, 1)):
        ok, density = _once(fields, step, run, mean, cov, point, about, known, spread, rest)
        if not ok or iterations < 2:
            return ok, density
        if iteration:
            residual, made = 0.0, iteration
            for i in range(size):
                unit = sqrt(max(spread[i * wide + i], 0.0))
                unit = unit if unit > 0.0 else max(abs(known[i]), 1.0)
                residual = max(residual, abs(known[i] - point[i]) / unit)
            record[iteration - 1] = max(record[iteration - 1], residual)
            if residual <= settings[0]:
                break
        for i in range(size):
            point[i] = settings[1] * point[i] + (1.0 - settings[1]) * known[i]
        for i in range(size * wide):
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
    wide = padded(size)
    copy(mean, known, wide)
    copy(cov, spread, size * wide)
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
    count, height, wide = cpd[SIZE], cpd[HEIGHT], padded(size)
    thick, tall = padded(count), padded(height)
    matrix, noise = work, past(work, height * wide)
    value, reading = past(noise, height * tall), past(noise, (height + 1) * tall)
    rest = past(reading, tall)
    x, block, parents = point, about, places(cpd[PARENTS])
    if not cpd[WHOLE]:
        x, block = rest, past(rest, thick)
        rest = past(block, count * thick)
        gather(parents, count, point, about, wide, x, block)
    error = linearise(cpd, row, run, x, block, matrix, value, noise, rest)
    if error < 0:
        return False, 0.0
    _keep(cpd, row, run, x, value, matrix, noise, error, rest)
    load(cpd, READINGS, row, run, reading, 1, height)
    nearest(cpd, value, reading)
    save(cpd, MOVED, row, run, reading, 1, height)
    if not cpd[WHOLE]:
        copy(matrix, rest, height * thick)
        clear(matrix, height * wide)
        for i in range(height):
            for j in range(count):
                matrix[i * wide + parents[j]] = rest[i * thick + j]
    seen = 0
    for i in range(height):
        if reading[i] != reading[i]:
            continue
        residual = reading[i] - value[i]
        for j in range(size):
            residual -= matrix[i * wide + j] * (known[j] - point[j])
        value[seen] = residual
        if seen < i:  # rows and columns before these have been moved already
            for j in range(size):
                matrix[seen * wide + j] = matrix[i * wide + j]
            for j in range(height):
                noise[seen * tall + j] = noise[i * tall + j]
            for j in range(height):
                noise[j * tall + seen] = noise[j * tall + i]
        seen += 1
    if not seen:
        return True, 0.0
    sharp = numbers(cpd[SHARP])[0]
    if seen < height:
        sharp, less = 0.0, padded(seen)
        for i in range(seen):
            for j in range(seen):
                noise[i * less + j] = noise[i * tall + j]
            for j in range(seen, less):
                noise[i * less + j] = 0.0
    return _update(known, spread, matrix, value, noise, size, seen, sharp, rest)


@compiled
def _update(mean, cov, matrix, residual, noise, size, height, sharp, work):
    """Condition N(mean, cov) on z = H x + n, of residual z − H mean.

    Where |S| is below `sharp` no direction shrinks so much that P − W Wᵀ would lose digits, and
    elsewhere the covariance is a sum of squares.
    """
    wide, tall = padded(size), padded(height)
    predictive, upper = work, past(work, height * tall)
    inverse, white = past(upper, height * tall), past(upper, (height + 1) * tall)
    gain = past(white, tall)
    product(matrix, wide, 1, cov, gain, height, size, wide)
    for i in range(height):
        for j in range(i + 1):
            total = noise[i * tall + j]
            for k in range(size):
                total += gain[i * wide + k] * matrix[j * wide + k]
            predictive[i * tall + j] = total
    det = root(predictive, upper, inverse, height, NEARLY_SINGULAR)
    if det == 0.0:
        return False, 0.0
    density = height * LOG_2PI + log_det(det, inverse, height)
    for i in range(height):
        total = residual[i]
        for k in range(i):
            total -= upper[k * tall + i] * white[k]
        white[i] = total * inverse[i]
        density += white[i] * white[i]
    whiten(upper, inverse, gain, height, wide)
    add(1.0, white, 1, 1, gain, mean, 1, height, wide)
    if det < sharp:
        add(-1.0, gain, 1, wide, gain, cov, size, height, wide)
    else:
        unwhiten(upper, inverse, gain, height, wide)
        spread = past(gain, height * wide)
        squares(cov, gain, matrix, noise, size, height, spread, past(spread, size * wide))
        copy(spread, cov, size * wide)
    return True, -0.5 * density


@compiled
def _back(fields, step, run, later, work):
    """Reverse the transition from a step, and send the belief of the step after it through."""
    width, front = fields[WIDTH], fields[FRONT]
    wide, thin = padded(width), padded(front)
    spread = past(later, wide)
    if step == fields[LAST]:
        load(fields, MEAN, step, run, later, 1, width)
        load(fields, COV, step, run, spread, width, width)
    else:
        # The gain, and then the transpose of that of controls.
        gain, shift = work, past(work, max(width * thin, front * wide))
        left = past(shift, wide)
        rest = past(left, width * wide)
        if not _reverse(fields, step, run, gain, shift, left, rest):
            return False
        transpose(gain, rest, width, front)
        save(fields, GAIN, step, run, rest, front, width)
        save(fields, SHIFT, step, run, shift, 1, front)
        save(fields, REST, step, run, left, front, front)
        if not fields[LATER_MEAN]:
            return True
        _push(gain, shift, left, later, spread, front, width, rest)
        if fields[CONTROL_GAIN]:
            load(fields, CONTROL_GAIN, step, run, rest, width, front)
            transpose(rest, gain, width, front)
            load(fields, CONTROL_SHIFT, step, run, shift, 1, width)
            load(fields, CONTROL_REST, step, run, left, width, width)
            _push(gain, shift, left, later, spread, width, front, rest)
    save(fields, LATER_MEAN, step, run, later, 1, width)
    save(fields, LATER_COV, step, run, spread, width, width)
    return True


@compiled
def _reverse(fields, step, run, gain, shift, left, work):
    """Bayes' rule for the transition from a step, as `moments.reverse`; the gain is Gᵀ."""
    width, front, states = fields[WIDTH], fields[FRONT], places(fields[STATES])
    wide, thin = padded(width), padded(front)
    mean, cov, matrix = work, past(work, thin), past(work, thin + front * thin)
    noise, after = past(matrix, width * thin), past(matrix, width * (thin + wide))
    later, upper = past(after, wide), past(after, wide + width * wide)
    inverse, rest = past(upper, width * wide), past(upper, (width + 1) * wide)
    load(fields, MEAN, step, run, after, 1, width)
    load(fields, COV, step, run, later, width, width)
    gather(states, front, after, later, wide, mean, cov)
    load(fields, STEP_MATRIX, step, run, matrix, width, front)
    load(fields, STEP_NOISE, step, run, noise, width, width)
    load(fields, PREDICTED_MEAN, step + 1, run, after, 1, width)
    load(fields, PREDICTED_COV, step + 1, run, later, width, width)
    if root(later, upper, inverse, width, _NEGLIGIBLE) == 0.0:
        return False
    product(matrix, thin, 1, cov, gain, width, front, thin)
    whiten(upper, inverse, gain, width, thin)
    unwhiten(upper, inverse, gain, width, thin)
    copy(mean, shift, thin)
    add(-1.0, after, 1, 1, gain, shift, 1, width, thin)
    squares(cov, gain, matrix, noise, front, width, left, rest)
    return isfinite(shift[0])


@compiled
def _push(gain, offset, noise, mean, cov, height, size, work):
    """Moments of F x + b + n in the place of those of x, given Fᵀ (size, height)."""
    wide, tall = padded(size), padded(height)
    add(1.0, mean, 1, 1, gain, offset, 1, size, tall)
    product(gain, 1, tall, cov, work, height, size, wide)
    add(1.0, work, wide, 1, gain, noise, height, size, tall)
    mirror(noise, height)
    copy(offset, mean, tall)
    copy(noise, cov, height * tall)


_kept: Any = njit(error_model="numpy", nogil=True, cache=True)


def _entries(stamp: int) -> tuple[Any, Any]:
    """The sweeps that Python calls. Numba keeps them on disk by what they close over: the stamp."""

    @_kept
    def forward(chain, first, last, memory):
        fields, beliefs = places(chain), numbers(memory)
        status, apart = places(fields[STATUS]), (fields[WIDTH] + 1) * padded(fields[WIDTH])
        work = past(beliefs, TOGETHER * apart)
        for begin in range(first, last, TOGETHER):
            end = min(begin + TOGETHER, last)
            for step in range(fields[LAST] + 1):
                for run in range(begin, end):
                    belief = past(beliefs, (run - begin) * apart)
                    if status[run] == DONE and not _step(fields, step, run, belief, work):
                        status[run] = LEFT
        return stamp

    @_kept
    def backward(chain, first, last, memory):
        fields, beliefs = places(chain), numbers(memory)
        status, apart = places(fields[STATUS]), (fields[WIDTH] + 1) * padded(fields[WIDTH])
        work = past(beliefs, TOGETHER * apart)
        for begin in range(first, last, TOGETHER):
            end = min(begin + TOGETHER, last)
            for step in range(fields[LAST], -1, -1):
                for run in range(begin, end):
                    belief = past(beliefs, (run - begin) * apart)
                    if status[run] == DONE and not _back(fields, step, run, belief, work):
                        status[run] = LEFT
        return stamp

    return forward, backward


# Sweep some runs of the chain at an address forward; reverse their transitions, and send the last
# belief back, if it has a place. The last argument is the address of `room`.
forward, backward = _entries(STAMP)
