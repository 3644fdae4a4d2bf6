"""Forward and backward sweeps of a chain in machine code, a run after another."""

from __future__ import annotations

from typing import Any

from pgm.kernels.compiled import tables as t
from pgm.kernels.compiled.algebra import (
    add,
    clear,
    copy,
    least_open,
    mirror,
    product,
    root,
    squares,
    transpose,
    unwhiten,
    whiten,
    width,
)
from pgm.kernels.compiled.factors import gather, keep, linearise, load, predict, save, to_chart
from pgm.kernels.compiled.measurements import taken
from pgm.kernels.compiled.memory import (
    STAMP,
    compiled,
    give,
    kept,
    numbers,
    opened,
    past,
    places,
    some,
    take,
)
from pgm.kernels.compiled.packs import bits, opposite, where

# Runs whose arrays lie next to each other are swept together, so that memory is read in rows.
TOGETHER = 256
# As of `moments` and `forward`.
_CORRELATED, _EVERY, _MILD, _GROWN = 3e-5, 8, 1e-3, 1e2
# The square of deviations from zero in which the last digit of a mean might count.
_FAR = 1e16
# A number from which on little or nothing can be told.
_LARGEST = 1e150


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
    size = fields[t.WIDTH]
    wide = width(size, known)
    spread = past(known, wide)
    mean, cov = work, past(work, wide)
    rest = past(cov, size * wide)
    sure = True
    if not step:
        load(fields, t.BEGIN_MEAN, 0, run, mean, 1, size)
        load(fields, t.BEGIN_COV, 0, run, cov, size, size)
    elif fields[t.SINGLE]:
        sure = moved(fields, step - 1, run, known, spread, mean, cov, rest)
    else:
        sure = joined(fields, step - 1, run, known, spread, mean, cov, rest)
    if not some(sure):
        return sure
    save(fields, t.PREDICTED_MEAN, step, run, mean, 1, size)
    save(fields, t.PREDICTED_COV, step, run, cov, size, size)
    ok, density = taken(fields, step, run, mean, cov, known, spread, rest)
    total = density
    for i in range(size):
        at = i * wide + i
        total += abs(mean[i]) + cov[at] + abs(known[i]) + spread[at]
    ok = ok & sure & (abs(total) < _LARGEST)
    if not some(ok):
        return ok
    save(fields, t.MEAN, step, run, known, 1, size)
    save(fields, t.COV, step, run, spread, size, size)
    rest[0] = density
    save(fields, t.DENSITY, step, run, rest, 1, 1)
    closest = past(numbers(fields[t.CLOSEST]), run)
    _look(closest, fields[t.RUN_COUNT], known, cov, spread, size, step, fields[t.LAST], rest)
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
def moved(fields, row, run, before, spread, mean, cov, work):
    """The slice, where one CPD makes all of it of all of the slice before."""
    cpd = places(fields[t.LINKS])
    size = cpd[t.SIZE]
    square = size * width(size, work)
    matrix, noise, rest = work, past(work, square), past(work, 2 * square)
    ok = linearise(cpd, row, run, before, spread, matrix, mean, noise, rest)
    ok = ok & predict(cpd, spread, matrix, noise, cov, rest)
    if some(ok):
        to_chart(cpd, row, run, before, before, mean, rest)
        keep(cpd, row, run, before, mean, matrix, noise, rest)
    return ok


@compiled
def joined(fields, row, run, known, spread, mean, cov, work):
    """The slice, a CPD after another, in the joint of the states before and itself."""
    front, own, states = fields[t.FRONT], fields[t.WIDTH], places(fields[t.STATES])
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
    for link in range(fields[t.LINK_COUNT]):
        cpd = past(places(fields[t.LINKS]), link * t.COLUMNS)
        count, height, child = cpd[t.SIZE], cpd[t.HEIGHT], cpd[t.CHILD]
        parents = places(cpd[t.PARENTS])
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
        keep(cpd, row, run, x, value, matrix, noise, rest)
        copy(value, past(pair, child), height)
    for i in range(own):
        mean[i] = pair[front + i]
        for j in range(own):
            cov[i * own_wide + j] = joint[(front + i) * wide + front + j]
        for j in range(own, own_wide):
            cov[i * own_wide + j] = 0.0
    return ok


@compiled
def _back(fields, step, run, later, work):
    """Reverse the transition from a step, and send the belief of the step after it through."""
    size, front = fields[t.WIDTH], fields[t.FRONT]
    wide, thin, ok = width(size, work), width(front, work), True
    spread = past(later, wide)
    if step == fields[t.LAST]:
        load(fields, t.MEAN, step, run, later, 1, size)
        load(fields, t.COV, step, run, spread, size, size)
    else:
        # The gain, and then the transpose of that of controls.
        gain, shift = work, past(work, max(size * thin, front * wide))
        left = past(shift, wide)
        rest = past(left, size * wide)
        ok = _reverse(fields, step, run, gain, shift, left, rest)
        if not some(ok):
            return ok
        transpose(gain, rest, size, front)
        save(fields, t.GAIN, step, run, rest, front, size)
        save(fields, t.SHIFT, step, run, shift, 1, front)
        save(fields, t.REST, step, run, left, front, front)
        if not fields[t.LATER_MEAN]:
            return ok
        _push(gain, shift, left, later, spread, front, size, rest)
        if fields[t.CONTROL_GAIN]:
            load(fields, t.CONTROL_GAIN, step, run, rest, size, front)
            transpose(rest, gain, size, front)
            load(fields, t.CONTROL_SHIFT, step, run, shift, 1, size)
            load(fields, t.CONTROL_REST, step, run, left, size, size)
            _push(gain, shift, left, later, spread, size, front, rest)
    save(fields, t.LATER_MEAN, step, run, later, 1, size)
    save(fields, t.LATER_COV, step, run, spread, size, size)
    return ok


@compiled
def _reverse(fields, step, run, gain, shift, left, work):
    """Bayes' rule for the transition from a step, as `moments.reverse`; the gain is Gᵀ."""
    size, front, states = fields[t.WIDTH], fields[t.FRONT], places(fields[t.STATES])
    wide, thin = width(size, work), width(front, work)
    mean, cov, matrix = work, past(work, thin), past(work, thin + front * thin)
    noise, after = past(matrix, size * thin), past(matrix, size * (thin + wide))
    later, upper = past(after, wide), past(after, wide + size * wide)
    inverse, rest = past(upper, size * wide), past(upper, (size + 1) * wide)
    load(fields, t.MEAN, step, run, after, 1, size)
    load(fields, t.COV, step, run, later, size, size)
    gather(states, front, after, later, wide, mean, cov)
    load(fields, t.STEP_MATRIX, step, run, matrix, size, front)
    load(fields, t.STEP_NOISE, step, run, noise, size, size)
    load(fields, t.PREDICTED_MEAN, step + 1, run, after, 1, size)
    load(fields, t.PREDICTED_COV, step + 1, run, later, size, size)
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
        left += status[run + lane] == t.LEFT
    return left == lanes


@compiled
def _leave(status, run, ok):
    """Leave the runs of which something is not true."""
    wrong = bits(opposite(ok))
    while wrong:
        if wrong & 1:
            status[run] = t.LEFT
        wrong >>= 1
        run += 1


def _entry(stamp: int, lanes: int, back: bool) -> Any:
    """A sweep that Python calls, which closes over the stamp as well."""

    def sweep(chain, first, last, memory):
        fields, beliefs = places(chain), opened(memory, lanes)
        status, size = places(fields[t.STATUS]), fields[t.WIDTH]
        apart = (size + 1) * width(size, beliefs)
        work, final = past(beliefs, TOGETHER // lanes * apart), fields[t.LAST]
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

    return kept(sweep, f"{'backward' if back else 'forward'}_{lanes}", nogil=True)


# Sweep some runs of the chain at an address forward; reverse their transitions, and send the last
# belief back, if it has a place. The last argument is the address of `room`. A run by itself, and
# eight at once, of which there have to be as many: the last may share runs with others.
forward, forward_together = _entry(STAMP, 1, False), _entry(STAMP, t.RUNS, False)
backward, backward_together = _entry(STAMP, 1, True), _entry(STAMP, t.RUNS, True)
