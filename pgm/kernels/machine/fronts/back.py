"""Means and covariances of fronts, from the roots to the leaves.

A front keeps the triangle of its pivots, R₁₁ x + R₁₂ s = c: given its separators s, of mean m and
covariance P, its pivots x have the moments

    mean = R₁₁⁻¹ c + G m,   cov(x, s) = G P,   cov = R₁₁⁻¹ R₁₁⁻ᵀ + G P Gᵀ,   G = −R₁₁⁻¹ R₁₂.
"""

from __future__ import annotations

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import ADDRESS, FLOAT, WHOLE
from pgm.kernels.machine.emitter.memory import Cells, Memory
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.variables import Variable
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.fronts.writing import Matrix, padded, plan, product, scalar


def write(module: Module, lanes: int) -> None:
    """Write the function ``back(plan, kept, means, covs, work, first, last, sides)``.

    It finds the moments of the fronts from below `last` down to `first`. It gives a bound on how
    much larger, at the most, the summands of a variance are than itself.
    """
    kinds = [ADDRESS] * 5 + [WHOLE] * 3
    code = module.function("back", kinds, FLOAT, lanes=lanes, disjoint=True)
    table, kept, means, covs, work, first, last, sides = code.arguments
    told = plan(code, table)
    worst = code.variable(scalar(code, 1.0))
    with code.loop(last, first, down=True) as front:
        pivots, shared = told["pivots"].load(front), told["separators"].load(front)
        size = pivots + shared
        tall, wide, flat = (padded(code, n) for n in (size + sides, shared, pivots))
        # Rows beyond the last of a product are of a pack at the most.
        both = tall + lanes
        solved = Matrix(code, work, tall)  # R₁₁⁻ᵀ, and below it Gᵀ
        above = Matrix(code, solved.address + tall * pivots, wide)  # P
        stacked = Matrix(code, above.address + wide * shared, both)  # R₁₁⁻ᵀ, and below it P Gᵀ
        turned = Matrix(code, stacked.address + both * pivots, flat)  # the transpose of `solved`
        own = Matrix(code, turned.address + flat * size, flat)  # cov
        _solve(code, told, front, solved, kept, sides)
        _look_up(code, told, front, above, covs)
        stacked.clear(pivots)
        below = Matrix(code, solved.address + pivots, tall)
        product(
            code,
            above,
            below,
            Matrix(code, stacked.address + pivots, both),
            (shared, shared, pivots),
        )
        with code.loop(pivots) as j, code.loop(pivots) as i:
            stacked.put(i, j, solved.entry(i, j))
        turned.clear(size)
        with code.loop(pivots) as j, code.loop(size) as i:
            turned.put(j, i, solved.entry(i, j))
        product(code, turned, stacked, own, (pivots, size, pivots))
        _write(code, told, front, own, stacked, above, covs)
        _means(code, told, front, solved, means, sides)
        _weigh(code, told, front, solved, above, own, worst)
    code.give(worst.get())


def _solve(
    code: Code,
    told: dict[str, Cells[Whole]],
    front: Whole,
    solved: Matrix,
    kept: Address,
    sides: Whole,
) -> None:
    """Solve with the triangle: columns of R₁₁⁻ᵀ, below them Gᵀ, and below those −(R₁₁⁻¹ c)ᵀ."""
    lanes = code.lanes
    pivots, size = told["pivots"].load(front), told["sizes"].load(front)
    every, place = size + sides, told["keeps"].load(front)
    solved.clear(pivots)
    numbers = Memory(code, kept, lanes=1)
    with code.loop(pivots) as c:
        solved.put(c, c, scalar(code, 1.0))
        with code.loop(pivots, c) as j:
            line = place + j * every
            value = solved.entry(j, c) / numbers.load(line + j)
            solved.put(j, c, value)
            # Whole packs from the next row on, then the rest one by one.
            after = j + 1
            count = (every - after) // lanes
            factor = value.spread(lanes)
            source = Memory(code, numbers.address + (line + after), step=lanes)
            target = solved.packs(c, after)
            with code.loop(count) as q:
                target.store(q, target.load(q) - factor * source.load(q))
            with code.loop(every, after + count * lanes) as i:
                solved.put(i, c, solved.entry(i, c) - value * numbers.load(line + i))


def _look_up(
    code: Code, told: dict[str, Cells[Whole]], front: Whole, above: Matrix, covs: Address
) -> None:
    """The covariance of the separators, from the parent's."""
    shared, begin = told["separators"].load(front), told["first_column"].load(front)
    above.clear(shared)
    with code.when(shared > 0):
        parent = told["parents"].load(front)
        block, width = told["blocks"].load(parent), told["sizes"].load(parent)
        numbers, columns = Memory(code, covs, lanes=1), told["above"]
        with code.loop(shared) as j:
            line = block + columns.load(begin + j) * width
            with code.loop(shared) as i:
                above.put(i, j, numbers.load(line + columns.load(begin + i)))


def _write(
    code: Code,
    told: dict[str, Cells[Whole]],
    front: Whole,
    own: Matrix,
    stacked: Matrix,
    above: Matrix,
    covs: Address,
) -> None:
    """Write the front's covariance."""
    pivots, shared = told["pivots"].load(front), told["separators"].load(front)
    block, size = told["blocks"].load(front), told["sizes"].load(front)
    out = Memory(code, covs, lanes=1)
    with code.loop(pivots) as j:
        with code.loop(pivots, j) as i:
            value = own.entry(i, j)
            out.store(block + j * size + i, value)
            out.store(block + i * size + j, value)
        with code.loop(shared) as i:
            value = stacked.entry(pivots + i, j)
            out.store(block + j * size + (pivots + i), value)
            out.store(block + (pivots + i) * size + j, value)
    with code.loop(shared) as j, code.loop(shared) as i:
        out.store(block + (pivots + j) * size + (pivots + i), above.entry(i, j))


def _means(
    code: Code,
    told: dict[str, Cells[Whole]],
    front: Whole,
    solved: Matrix,
    means: Address,
    sides: Whole,
) -> None:
    """Write the front's means."""
    pivots, shared = told["pivots"].load(front), told["separators"].load(front)
    place, size, begin = (told[name].load(front) for name in ("means", "sizes", "first_column"))
    out = Memory(code, means, lanes=1)
    parent = told["parents"].load(front)
    with code.when(shared > 0):
        up = told["means"].load(parent)
        with code.loop(shared) as i, code.loop(sides) as n:
            known = out.load((up + told["above"].load(begin + i)) * sides + n)
            out.store((place + (pivots + i)) * sides + n, known)
    with code.loop(pivots) as j, code.loop(sides) as n:
        total = code.variable(-solved.entry(size + n, j))
        with code.loop(shared) as i:
            known = out.load((place + (pivots + i)) * sides + n)
            total.set(total.get() + solved.entry(pivots + i, j) * known)
        out.store((place + j) * sides + n, total.get())


def _weigh(
    code: Code,
    told: dict[str, Cells[Whole]],
    front: Whole,
    solved: Matrix,
    above: Matrix,
    own: Matrix,
    worst: Variable[Number],
) -> None:
    """Compare each variance with its summands, without their signs."""
    pivots, shared = told["pivots"].load(front), told["separators"].load(front)
    with code.loop(pivots) as j:
        total = code.variable(scalar(code, 0.0))
        with code.loop(shared) as i:
            deviation = above.entry(i, i).apply("sqrt")
            total.set(total.get() + abs(solved.entry(pivots + i, j)) * deviation)
        ratio = total.get() * total.get() / own.entry(j, j)
        with code.when(ratio > worst.get()):
            worst.set(ratio)
