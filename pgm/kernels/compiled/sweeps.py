"""Forward and backward sweeps of a chain in machine code, a run after another.

A chain is a row of integers, as a CPD is one (`factors`): its shape, the addresses of its tables
of CPDs, and its arrays, by step where those of a CPD are by row.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from numba import njit

from pgm.kernels.arrays import LOG_2PI
from pgm.kernels.compiled.algebra import (
    add,
    clear,
    copy,
    least_open,
    log_det,
    mirror,
    product,
    root,
    squares,
    transpose,
    unwhiten,
    whiten,
    width,
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
    REGRESSION,
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
from pgm.kernels.compiled.memory import (
    STAMP,
    compiled,
    every,
    give,
    numbers,
    opened,
    past,
    places,
    some,
    take,
)
from pgm.kernels.compiled.packs import RUNS, bits, opposite, where

# The shape of a chain: T, whether one CPD makes all of a slice of all of the one before, and the
# components of states and of a slice.
(LAST, SINGLE, FRONT, WIDTH, LINKS, LINK_COUNT, SENSORS, SENSOR_COUNT, STATES) = range(9)
# Linearisations of a step's measurements, where their settings are, (tolerance, damping), and their
# record, (iterations + 1, runs): the residuals of each, how many, and whether some did not settle.
(ITERATIONS, SETTINGS, RESIDUALS) = range(9, 12)
# The least share of a variance that is left open, variances to grow from, and whether a mean is far
# from zero, by run; how runs ended.
(CLOSEST, STATUS, RUN_COUNT) = range(12, 15)
# The belief that a sweep starts with, and its record.
(BEGIN_MEAN, BEGIN_COV, PREDICTED_MEAN, PREDICTED_COV, MEAN, COV, DENSITY) = range(16, 44, 4)
# The reversed chain, its transition, and the smoothed beliefs.
(STEP_MATRIX, STEP_NOISE, GAIN, SHIFT, REST, LATER_MEAN, LATER_COV) = range(44, 72, 4)
(CONTROL_GAIN, CONTROL_SHIFT, CONTROL_REST) = range(72, 84, 4)
FIELDS = 84
# Runs whose arrays lie next to each other are swept together, so that memory is read in rows.
TOGETHER = 256
# As of `gaussian`, `moments` and `forward`.
NEARLY_SINGULAR, _CORRELATED, _EVERY, _MILD, _GROWN = 1e-6, 3e-5, 8, 1e-3, 1e2
# The square of deviations from zero in which the last digit of a mean might count.
_FAR = 1e16
# The part of S (10 + rᵀ S⁻¹ r) that noise has to exceed in all directions. Below, a belief that is
# linearised again, or any, is not known to a billionth of a deviation: an order of sums shows.
_CURVED, _STRAIGHT = 1e-6, 1e-8
# Lengths rᵀ S⁻¹ r and numbers from which on little or nothing can be told.
_FARTHEST, _LARGEST = 1e12, 1e150
# How a run ended: done, or to be done by the general kernels.
DONE, LEFT = 0, 1


def room(width: int, front: int, height: int, points: int, lanes: int = 1) -> int:
    """How many floats of memory a sweep works in; its components and points are the largest."""
    size = max(width + front, height) + 3
    own = 16 * size * (size + 1) + points * (3 * size + points)
    return TOGETHER * size * (size + 1) + lanes * own


@compiled
def _step(fields, step, run, known, work):
    """Predict a step of a run and take in its measurements; whether that went without a doubt.

    The belief is that of the step before, and then of this one.
    """
    size = fields[WIDTH]
    wide = width(size, known)
    spread = past(known, wide)
    mean, cov = work, past(work, wide)
    rest = past(cov, size * wide)
    sure = True
    if not step:
        load(fields, BEGIN_MEAN, 0, run, mean, 1, size)
        load(fields, BEGIN_COV, 0, run, cov, size, size)
    elif fields[SINGLE]:
        sure = _moved(fields, step - 1, run, known, spread, mean, cov, rest)
    else:
        sure = _joined(fields, step - 1, run, known, spread, mean, cov, rest)
    if not some(sure):
        return sure
    save(fields, PREDICTED_MEAN, step, run, mean, 1, size)
    save(fields, PREDICTED_COV, step, run, cov, size, size)
    ok, density = _taken(fields, step, run, mean, cov, known, spread, rest)
    total = density
    for i in range(size):
        at = i * wide + i
        total += abs(mean[i]) + cov[at] + abs(known[i]) + spread[at]
    ok = ok & sure & (abs(total) < _LARGEST)
    if not some(ok):
        return ok
    save(fields, MEAN, step, run, known, 1, size)
    save(fields, COV, step, run, spread, size, size)
    rest[0] = density
    save(fields, DENSITY, step, run, rest, 1, 1)
    closest = past(numbers(fields[CLOSEST]), run)
    _look(closest, fields[RUN_COUNT], known, cov, spread, size, step, fields[LAST], rest)
    return ok


@compiled
def _look(closest, apart, mean, before, after, size, step, last, work):
    """Look how much of variances is left open, as `Watch`, and how far from zero means are."""
    wide, least, grown, far = width(size, before), 1.0, False, False
    often = step == last or step % _EVERY == 0
    for i in range(size):
        was, left = before[i * wide + i], after[i * wide + i]
        grown = grown | (was > _GROWN * take(closest, (i + 1) * apart, 1, before))
        small = (left < _MILD * was) & (left != 0.0) & (was > 0.0) & (left < least * was)
        least = where(small, left / was, least)
        far = far | ((mean[i] * mean[i] > _FAR * left) & (left > 0.0))
    if some(far):
        give(closest, (size + 1) * apart, 1, where(far, 1.0, 0.0), before)
    doubtful = grown | (least < 1.0)
    if some(doubtful):
        share = least_open(before, work, size)
        least = where(doubtful & (share < least), share, least)
    for i in range(size):
        was, left = before[i * wide + i], after[i * wide + i]
        level = where(doubtful, was, take(closest, (i + 1) * apart, 1, before))
        if not step:
            level = left
        low = (doubtful | often) & (left < level)
        give(closest, (i + 1) * apart, 1, where(low, left, level), before)
    if often or some(doubtful):
        share = least_open(after, work, size)
        least = where((doubtful | often) & (share < least), share, least)
    known = take(closest, 0, 1, before)
    give(closest, 0, 1, where(least < known, least, known), before)


@compiled
def _moved(fields, row, run, before, spread, mean, cov, work):
    """The slice, where one CPD makes all of it of all of the slice before."""
    cpd = places(fields[LINKS])
    size = cpd[SIZE]
    square = size * width(size, work)
    matrix, noise, rest = work, past(work, square), past(work, 2 * square)
    ok = linearise(cpd, row, run, before, spread, matrix, mean, noise, rest)
    ok = ok & predict(cpd, spread, matrix, noise, cov, rest)
    if some(ok):
        to_chart(cpd, row, run, before, before, mean, rest)
        _keep(cpd, row, run, before, mean, matrix, noise, rest)
    return ok


@compiled
def _keep(cpd, row, run, x, value, matrix, noise, work):
    """Keep a linearisation, where that is asked for."""
    if cpd[KIND] == AFFINE or not cpd[MATRIX]:
        return
    size, height = cpd[SIZE], cpd[HEIGHT]
    wide = width(size, x)
    save(cpd, MATRIX, row, run, matrix, height, size)
    for i in range(height):
        work[i] = value[i]
        for k in range(size):
            work[i] -= matrix[i * wide + k] * x[k]
    save(cpd, OFFSET, row, run, work, 1, height)
    if cpd[KIND] == REGRESSION:
        save(cpd, KEPT_NOISE, row, run, noise, height, height)


@compiled
def _joined(fields, row, run, known, spread, mean, cov, work):
    """The slice, a CPD after another, in the joint of the states before and itself."""
    front, own, states = fields[FRONT], fields[WIDTH], places(fields[STATES])
    size, own_wide = front + own, width(own, work)
    wide, ok = width(size, work), True
    square = size * wide
    pair, joint = work, past(work, wide)
    x, block = past(joint, square), past(joint, square + wide)
    matrix, noise = past(block, square), past(block, 2 * square)
    after, value = past(noise, square), past(noise, 2 * square)
    rest = past(value, wide)
    clear(joint, square)
    for i in range(front):
        pair[i] = known[states[i]]
        for j in range(front):
            joint[i * wide + j] = spread[states[i] * own_wide + states[j]]
    for link in range(fields[LINK_COUNT]):
        cpd = past(places(fields[LINKS]), link * COLUMNS)
        count, height, child, parents = cpd[SIZE], cpd[HEIGHT], cpd[CHILD], places(cpd[PARENTS])
        thick, tall = width(count, work), width(height, work)
        gather(parents, count, pair, joint, wide, x, block)
        ok = ok & linearise(cpd, row, run, x, block, matrix, value, noise, rest)
        ok = ok & predict(cpd, block, matrix, noise, after, rest)
        if not some(ok):
            return ok
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
                joint[(child + i) * wide + child + j] = after[i * tall + j]
        to_chart(cpd, row, run, pair, x, value, rest)
        _keep(cpd, row, run, x, value, matrix, noise, rest)
        copy(value, past(pair, child), height)
    for i in range(own):
        mean[i] = pair[front + i]
        for j in range(own):
            cov[i * own_wide + j] = joint[(front + i) * wide + front + j]
        for j in range(own, own_wide):
            cov[i * own_wide + j] = 0.0
    return ok


@compiled
def _taken(fields, step, run, mean, cov, known, spread, work):
    """The belief given the measurements of a step; whether all was regular, and their density."""
    size, iterations, apart = fields[WIDTH], fields[ITERATIONS], fields[RUN_COUNT]
    wide = width(size, work)
    if iterations < 2 or not _are_curved(fields, step):
        return _once(fields, step, run, mean, cov, mean, cov, known, spread, work)
    point, about = work, past(work, wide)
    rest = past(about, size * wide)
    copy(mean, point, size)
    copy(cov, about, size * wide)
    tolerance, damping = numbers(fields[SETTINGS])[0], numbers(fields[SETTINGS])[1]
    record = past(numbers(fields[RESIDUALS]), run)
    residual, made, settled, last = 0.0, 0.0, False, 0
    ok, density = _once(fields, step, run, mean, cov, point, about, known, spread, rest)
    for iteration in range(1, iterations):
        if every(settled) or not some(ok):
            break
        for i in range(size):
            mixed = damping * point[i] + (1.0 - damping) * known[i]
            point[i] = where(settled, point[i], mixed)
        for i in range(size * wide):
            mixed = damping * about[i] + (1.0 - damping) * spread[i]
            about[i] = where(settled, about[i], mixed)
        ok, density = _once(fields, step, run, mean, cov, point, about, known, spread, rest)
        residual, last = 0.0, iteration
        made = where(settled, made, 1.0 * iteration)
        for i in range(size):
            variance, size_of = spread[i * wide + i], abs(known[i])
            unit = where(size_of > 1.0, size_of, 1.0)
            unit = where(variance > 0.0, sqrt(variance), unit)
            moved = abs(known[i] - point[i]) / unit
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
    for k in range(fields[SENSOR_COUNT]):
        cpd = past(places(fields[SENSORS]), k * COLUMNS)
        bounds = places(cpd[STEPS])
        if cpd[KIND] != AFFINE and bounds[step] < bounds[step + 1]:
            return True
    return False


@compiled
def _once(fields, step, run, mean, cov, point, about, known, spread, work):
    """Take the measurements of a step, linearised at a point, into N(mean, cov)."""
    size, ok, density = fields[WIDTH], True, 0.0
    wide = width(size, work)
    copy(mean, known, wide)
    copy(cov, spread, size * wide)
    for k in range(fields[SENSOR_COUNT]):
        cpd = past(places(fields[SENSORS]), k * COLUMNS)
        bounds = places(cpd[STEPS])
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
    count, height, wide = cpd[SIZE], cpd[HEIGHT], width(size, work)
    thick, tall = width(count, work), width(height, work)
    matrix, noise = work, past(work, height * wide)
    value, reading = past(noise, height * tall), past(noise, (height + 1) * tall)
    rest = past(reading, tall)
    x, block, parents = point, about, places(cpd[PARENTS])
    if not cpd[WHOLE]:
        x, block = rest, past(rest, thick)
        rest = past(block, count * thick)
        gather(parents, count, point, about, wide, x, block)
    ok = linearise(cpd, row, run, x, block, matrix, value, noise, rest)
    _keep(cpd, row, run, x, value, matrix, noise, rest)
    load(cpd, READINGS, row, run, reading, 1, height)
    nearest(cpd, value, reading)
    save(cpd, MOVED, row, run, reading, 1, height)
    if not cpd[WHOLE]:
        copy(matrix, rest, height * thick)
        clear(matrix, height * wide)
        for i in range(height):
            for j in range(count):
                matrix[i * wide + parents[j]] = rest[i * thick + j]
    sharp, density, unseen = numbers(cpd[SHARP])[0], 0.0, True
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
    limits = sharp, _STRAIGHT if cpd[KIND] == AFFINE else _CURVED
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
    for i in range(height):
        for j in range(i + 1):
            total = noise[i * tall + j]
            for k in range(size):
                total += gain[i * wide + k] * matrix[j * wide + k]
            predictive[i * tall + j] = total
    det = root(predictive, upper, inverse, height, NEARLY_SINGULAR)
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
        for i in range(height):
            for j in range(i + 1):
                total = noise[i * tall + j]
                for k in range(size):
                    total += spread[i * wide + k] * matrix[j * wide + k]
                predictive[i * tall + j] = noise[i * tall + j] - part * total
        ok = ok & (mild | (root(predictive, upper, inverse, height, 0.0) > 0.0))
        squares(cov, turned, matrix, noise, size, height, spread, past(spread, size * wide))
    if some(mild):
        add(-1.0, gain, 1, wide, gain, cov, size, height, wide)
    if not every(mild):
        for i in range(size * wide):
            cov[i] = where(mild, cov[i], spread[i])
    return ok, -0.5 * density


@compiled
def _back(fields, step, run, later, work):
    """Reverse the transition from a step, and send the belief of the step after it through."""
    size, front = fields[WIDTH], fields[FRONT]
    wide, thin, ok = width(size, work), width(front, work), True
    spread = past(later, wide)
    if step == fields[LAST]:
        load(fields, MEAN, step, run, later, 1, size)
        load(fields, COV, step, run, spread, size, size)
    else:
        # The gain, and then the transpose of that of controls.
        gain, shift = work, past(work, max(size * thin, front * wide))
        left = past(shift, wide)
        rest = past(left, size * wide)
        ok = _reverse(fields, step, run, gain, shift, left, rest)
        if not some(ok):
            return ok
        transpose(gain, rest, size, front)
        save(fields, GAIN, step, run, rest, front, size)
        save(fields, SHIFT, step, run, shift, 1, front)
        save(fields, REST, step, run, left, front, front)
        if not fields[LATER_MEAN]:
            return ok
        _push(gain, shift, left, later, spread, front, size, rest)
        if fields[CONTROL_GAIN]:
            load(fields, CONTROL_GAIN, step, run, rest, size, front)
            transpose(rest, gain, size, front)
            load(fields, CONTROL_SHIFT, step, run, shift, 1, size)
            load(fields, CONTROL_REST, step, run, left, size, size)
            _push(gain, shift, left, later, spread, size, front, rest)
    save(fields, LATER_MEAN, step, run, later, 1, size)
    save(fields, LATER_COV, step, run, spread, size, size)
    return ok


@compiled
def _reverse(fields, step, run, gain, shift, left, work):
    """Bayes' rule for the transition from a step, as `moments.reverse`; the gain is Gᵀ."""
    size, front, states = fields[WIDTH], fields[FRONT], places(fields[STATES])
    wide, thin = width(size, work), width(front, work)
    mean, cov, matrix = work, past(work, thin), past(work, thin + front * thin)
    noise, after = past(matrix, size * thin), past(matrix, size * (thin + wide))
    later, upper = past(after, wide), past(after, wide + size * wide)
    inverse, rest = past(upper, size * wide), past(upper, (size + 1) * wide)
    load(fields, MEAN, step, run, after, 1, size)
    load(fields, COV, step, run, later, size, size)
    gather(states, front, after, later, wide, mean, cov)
    load(fields, STEP_MATRIX, step, run, matrix, size, front)
    load(fields, STEP_NOISE, step, run, noise, size, size)
    load(fields, PREDICTED_MEAN, step + 1, run, after, 1, size)
    load(fields, PREDICTED_COV, step + 1, run, later, size, size)
    ok = root(later, upper, inverse, size, _CORRELATED) > 0.0
    if not some(ok):
        return ok
    product(matrix, thin, 1, cov, gain, size, front, thin)
    whiten(upper, inverse, gain, size, thin)
    unwhiten(upper, inverse, gain, size, thin)
    copy(mean, shift, thin)
    add(-1.0, after, 1, 1, gain, shift, 1, size, thin)
    squares(cov, gain, matrix, noise, front, size, left, rest)
    return ok & (shift[0] - shift[0] == 0.0)


@compiled
def _push(gain, offset, noise, mean, cov, height, size, work):
    """Moments of F x + b + n in the place of those of x, given Fᵀ (size, height)."""
    wide, tall = width(size, work), width(height, work)
    add(1.0, mean, 1, 1, gain, offset, 1, size, tall)
    product(gain, 1, tall, cov, work, height, size, wide)
    add(1.0, work, wide, 1, gain, noise, height, size, tall)
    mirror(noise, height)
    copy(offset, mean, tall)
    copy(noise, cov, height * tall)


@compiled
def _left(status, run, lanes):
    """Whether all of some runs are left."""
    left = 0
    for lane in range(lanes):
        left += status[run + lane] == LEFT
    return left == lanes


@compiled
def _leave(status, run, ok):
    """Leave the runs of which something is not true."""
    wrong = bits(opposite(ok))
    while wrong:
        if wrong & 1:
            status[run] = LEFT
        wrong >>= 1
        run += 1


_kept: Any = njit(error_model="numpy", nogil=True, cache=True)


def _entry(stamp: int, lanes: int, back: bool) -> Any:
    """A sweep that Python calls. Numba keeps it on disk by what it closes over."""

    @_kept
    def sweep(chain, first, last, memory):
        fields, beliefs = places(chain), opened(memory, lanes)
        status, apart = places(fields[STATUS]), (fields[WIDTH] + 1) * width(fields[WIDTH], beliefs)
        work, final = past(beliefs, TOGETHER // lanes * apart), fields[LAST]
        for begin in range(first, last, TOGETHER):
            end = min(begin + TOGETHER, last)
            for count in range(final + 1):
                for k in range((end - begin + lanes - 1) // lanes):
                    run, belief = min(begin + k * lanes, end - lanes), past(beliefs, k * apart)
                    if _left(status, run, lanes):
                        continue
                    if back:
                        _leave(status, run, _back(fields, final - count, run, belief, work))
                    else:
                        _leave(status, run, _step(fields, count, run, belief, work))
        return stamp

    return sweep


# Sweep some runs of the chain at an address forward; reverse their transitions, and send the last
# belief back, if it has a place. The last argument is the address of `room`. A run by itself, and
# eight at once, of which there have to be as many: the last may share runs with others.
forward, forward_together = _entry(STAMP, 1, False), _entry(STAMP, RUNS, False)
backward, backward_together = _entry(STAMP, 1, True), _entry(STAMP, RUNS, True)
