"""Gauss–Newton steps of a chain in machine code.

A chain linearised at a trajectory is a least-squares problem, whose normal equations have a block
for each slice and one for each pair of neighbours: L D Lᵀ of them on the way forward, on the way
back the means, and the entries of the inverse that lie in these blocks, by its recurrence
(Takahashi, Fagan and Chen, 1973). No covariance is carried forward, and no noise may be singular.

A chain is told as to `sweeps`, but for its trajectories, which are (runs, T + 1, n), and one table
of all CPDs, in which

- rows are linearised in packs, in the place of runs: strides of rows and runs change places, and
  the functions are of packs;
- a row of a transition is as of a sensor that reads its own child;
- `PARENTS` are places in a slice and the one after it, those of that child at the end;
- `NOISE` is the inverse of a covariance, zero where nothing is measured;
- `TARGETS` are places in the equations of its step, each with that of a square or right side.
"""

from __future__ import annotations

from typing import Any

from pgm.kernels.compiled import factors as f
from pgm.kernels.compiled import tables as t
from pgm.kernels.compiled.algebra import add, clear, copy, padded, product
from pgm.kernels.compiled.memory import (
    STAMP,
    by_row,
    compiled,
    kept,
    numbers,
    opened,
    past,
    places,
    ready,
)
from pgm.kernels.compiled.packs import where
from pgm.kernels.compiled.tables import RUNS  # `opened` takes a literal, which t.RUNS is not

# So many steps are linearised before they are eliminated.
_AT_ONCE = 64


@compiled
def _of(fields, array, run):
    """The numbers of a run."""
    return past(numbers(fields[array]), run * fields[array + 2])


@compiled
def _size(width):
    """The floats of a step's equations: rows of its slice, with the right side, and across."""
    return 2 * width * padded(width + 1)


@compiled
def _absorb(cpd, run, first, last, reference, width, equations, work):
    """Add the squares of some rows of a CPD, linearised at the reference."""
    size, height = cpd[t.SIZE], cpd[t.HEIGHT]
    curved, linked = cpd[t.KIND] != t.AFFINE, cpd[t.READINGS] == 0
    parents, steps, targets = places(cpd[t.PARENTS]), places(cpd[t.STEP]), places(cpd[t.TARGETS])
    every = size + height if linked else size
    x, value = work, past(work, every)
    left, weight = past(value, height), past(value, 2 * height)
    matrix, slope = past(weight, height * height), past(weight, height * (height + size))
    part = past(slope, height * every)
    squares = past(part, height * every)
    at, found, count = numbers(x), numbers(squares), every * (every + 3) // 2
    for begin in range(first, last, RUNS):
        row = min(begin, cpd[t.ROWS] - RUNS)
        for lane in range(RUNS):
            point = past(reference, steps[row + lane] * width)
            for i in range(every):
                at[i * RUNS + lane] = point[parents[i]]
        if curved:
            f.evaluate(cpd, t.FUNCTION, run, row, x, value, matrix)
        else:
            f.load(cpd, t.MATRIX, run, row, matrix, height, size)
            f.load(cpd, t.OFFSET, run, row, value, 1, height)
            add(1.0, matrix, size, 1, x, value, height, size, 1)
        if linked:
            copy(past(x, size), left, height)
        else:
            f.load(cpd, t.READINGS, run, row, left, 1, height)
        if curved or not linked:
            f.nearest(cpd, value, left)
        f.save(cpd, t.MOVED, run, row, left, 1, height)
        clear(slope, height * every)
        for i in range(height):
            copy(past(matrix, i * size), past(slope, i * every), size)
            residual = where(left[i] == left[i], left[i] - value[i], 0.0)
            if linked:  # the value moves, not the slice
                slope[i * every + size + i] = -1.0
                value[i] += x[size + i] - left[i]
            left[i] = residual
        if curved:
            add(-1.0, matrix, size, 1, x, value, height, size, 1)
            f.save(cpd, t.MATRIX, run, row, matrix, height, size)
            f.save(cpd, t.OFFSET, run, row, value, 1, height)
        f.load(cpd, t.NOISE, run, row, weight, height, height)
        product(weight, height, 1, slope, part, height, height, every)
        product(part, 1, every, slope, squares, every, height, every)
        product(part, 1, every, left, past(squares, every * every), every, height, 1)
        for lane in range(begin - row, min(last - row, RUNS)):
            block = past(equations, steps[row + lane] * _size(width))
            for k in range(0, 2 * count, 2):
                block[targets[k]] += found[targets[k + 1] * RUNS + lane]


@compiled
def _eliminate(block, width):
    """Eliminate a slice from the equations of its step and the next; whether it can be.

    Its rows are then those of D Lᵀ, one over D on the diagonal.
    """
    wide = padded(width + 1)
    blocks, across = wide // 4, past(block, width * wide)
    own, next_, after = by_row(block), by_row(across), by_row(past(block, _size(width)))
    for i in range(width):
        across[i * wide + width] = block[i * wide + width]
    for i in range(width):
        pivot = block[i * wide + i]
        if not pivot > 0.0:
            return False
        pivot = 1.0 / pivot
        block[i * wide + i] = pivot
        for r in range(i + 1, width):
            part = pivot * block[i * wide + r]
            for j in range(blocks):
                own[r * blocks + j] -= part * own[i * blocks + j]
                next_[r * blocks + j] -= part * next_[i * blocks + j]
        for r in range(width):
            part = pivot * across[i * wide + r]
            for j in range(blocks):
                after[r * blocks + j] -= part * next_[i * blocks + j]
    return True


@compiled
def _substitute(block, width, known, work):
    """The covariance of a slice, with its mean in a column, given those of the one after it."""
    wide = padded(width + 1)
    blocks, across = wide // 4, past(block, width * wide)
    later, rows = by_row(known), by_row(work)
    clear(work, width * wide)
    for i in range(width - 1, -1, -1):
        here, pivot = i * wide, block[i * wide + i]
        work[here + width] = across[here + width]
        for j in range(blocks):
            total = rows[i * blocks + j]
            for k in range(width):
                total -= across[here + k] * later[k * blocks + j]
            for k in range(i + 1, width):
                total -= block[here + k] * rows[k * blocks + j]
            rows[i * blocks + j] = pivot * total
    for i in range(width - 1, -1, -1):
        here, pivot = i * wide, block[i * wide + i]
        for j in range(width - 1, i - 1, -1):
            total = 1.0 if i == j else 0.0
            for k in range(width):
                total -= across[here + k] * work[j * wide + k]
            for k in range(i + 1, width):
                total -= block[here + k] * known[j * wide + k]
            known[here + j] = known[j * wide + i] = pivot * total
        known[here + width] = work[here + width]


@compiled
def _forward(fields, run, reference, equations, work):
    """Linearise a run, and eliminate slice after slice; whether that goes."""
    width, last = fields[t.WIDTH], fields[t.LAST]
    size = _size(width)
    copy(_of(fields, t.BEGIN, run), equations, size)
    for begin in range(0, last + 1, _AT_ONCE):
        end = min(begin + _AT_ONCE, last + 1)
        clear(past(equations, (begin + 1) * size), (end - begin) * size)
        for k in range(fields[t.SENSOR_COUNT]):
            cpd = past(places(fields[t.SENSORS]), k * t.COLUMNS)
            rows = places(cpd[t.STEPS])
            _absorb(cpd, run, rows[begin], rows[end], reference, width, equations, work)
        for step in range(begin, end):
            if not _eliminate(past(equations, step * size), width):
                return False
    return True


def _entry(stamp: int) -> Any:
    """The step that Python calls, which closes over the stamp."""

    def newton(chain, first, last, memory):
        fields, known = places(chain), numbers(memory)
        status, width = places(fields[t.STATUS]), fields[t.WIDTH]
        part = (first * fields[t.THREADS] + fields[t.RUN_COUNT] - 1) // fields[t.RUN_COUNT]
        equations, work = _of(fields, t.EQUATIONS, part), past(known, _size(width))
        for run in range(first, last):
            if status[run] != t.DONE:
                continue
            reference = _of(fields, t.REFERENCE, run)
            if not _forward(fields, run, reference, equations, opened(memory, RUNS)):
                status[run] = t.LEFT
                continue
            found, variance = _of(fields, t.FOUND, run), _of(fields, t.VARIANCE, run)
            clear(known, _size(width))
            for step in range(fields[t.LAST], -1, -1):
                _substitute(past(equations, step * _size(width)), width, known, work)
                for i in range(width):
                    row, here = i * padded(width + 1), step * width + i
                    found[here] = reference[here] + known[row + width]
                    variance[here] = known[row + i]
        return stamp

    return kept(newton, "newton", nogil=True)


# A step of some runs of the chain at an address; the last argument is that of `room`.
newton = _entry(STAMP)
ready(newton, "int64(int64,int64,int64,int64)")
