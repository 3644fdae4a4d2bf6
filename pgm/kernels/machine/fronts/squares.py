"""The normal equations of fronts, factorised by Cholesky, from the leaves to the roots.

Faster than `rows` by a multiple, and blind to what squares lose: it is for steps of iterations that
end in rows.
"""

from __future__ import annotations

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import ADDRESS, FLOAT, WHOLE
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.fronts.writing import TOGETHER, Given, Matrix, padded


def write(module: Module, lanes: int) -> None:
    """Write the function of all fronts' normal equations.

    It is ``squares(plan, entries, right, kept, left, work, first, last, sides, negligible)``. It
    factorises the fronts from `first` to below `last`, and keeps of each the columns of its
    pivots. It gives the number of the first front with a pivot that is no more than `negligible`
    of what it was before the elimination, else −1.
    """
    kinds = [ADDRESS] * 6 + [WHOLE] * 3 + [FLOAT]
    code = module.function("squares", kinds, WHOLE, lanes=lanes, disjoint=True)
    table, entries, right, kept, left, work, first, last, sides, negligible = code.arguments
    given = Given.of(code, table, (entries, right, left), sides)
    told = given.told
    with code.loop(last, first) as front:
        columns, pivots = told["sizes"].load(front), told["pivots"].load(front)
        every = columns + sides
        height = padded(code, every)
        matrix = Matrix(code, work + height, height)  # behind the diagonal
        matrix.clear(columns)
        _assemble(code, given, front, matrix, columns)
        _factorise(code, front, matrix, Memory(code, work, lanes=1), pivots, columns, negligible)
        out, place = Memory(code, kept, lanes=1), told["keeps"].load(front)
        with code.loop(pivots) as j, code.loop(every, j) as i:
            out.store(place + j * every + i, matrix.entry(i, j))
        out, place = Memory(code, left, lanes=1), told["waiting"].load(front)
        shared = columns - pivots
        with code.loop(shared) as j, code.loop(shared + sides, j) as i:
            out.store(place + j * (shared + sides) + i, matrix.entry(pivots + i, pivots + j))
    code.give(code.whole(-1))


def _assemble(code: Code, given: Given, front: Whole, matrix: Matrix, columns: Whole) -> None:
    """Sum the squares of a front's factors and what its children leave; right sides are rows."""
    told, sides = given.told, given.sides
    factors, where = told["factors"], told["columns"]
    with given.each("first_factor", front) as k:
        height, width, entry, row, begin = (factors.load(k * 5 + part) for part in range(5))
        with code.loop(height) as i, code.loop(width) as a:
            line = entry + i * width
            one, column = given.entries.load(line + a), where.load(begin + a)
            with code.loop(width) as b:
                other = where.load(begin + b)
                with code.when(other >= column):
                    matrix.add(other, column, one * given.entries.load(line + b))
            with code.loop(sides) as n:
                matrix.add(columns + n, column, one * given.right.load((row + i) * sides + n))
    with given.each("first_child", front) as k:
        child = told["children"].load(k)
        shared, begin = told["separators"].load(child), told["first_column"].load(child)
        stack, tall = told["waiting"].load(child), shared + sides
        with code.loop(shared) as j:
            column = told["above"].load(begin + j)
            with code.loop(shared, j) as i:
                matrix.add(
                    told["above"].load(begin + i),
                    column,
                    given.left.load(stack + j * tall + i),
                )
            with code.loop(sides) as n:
                matrix.add(columns + n, column, given.left.load(stack + j * tall + shared + n))


def _factorise(
    code: Code,
    front: Whole,
    matrix: Matrix,
    diagonal: Memory,
    pivots: Whole,
    columns: Whole,
    negligible: Number,
) -> None:
    """Eliminate the pivots, some at a time; what is above the diagonal is never looked at."""
    with code.loop(pivots) as j:
        diagonal.store(j, matrix.entry(j, j))
    whole = pivots // TOGETHER
    with code.loop(whole) as k:
        _panel(code, front, matrix, diagonal, k * TOGETHER, TOGETHER, columns, negligible)
    with code.loop(pivots, whole * TOGETHER) as j:
        _panel(code, front, matrix, diagonal, j, 1, columns, negligible)


def _panel(
    code: Code,
    front: Whole,
    matrix: Matrix,
    diagonal: Memory,
    first: Whole,
    count: int,
    columns: Whole,
    negligible: Number,
) -> None:
    """Eliminate so many pivots, the first of which is given."""
    lanes = code.lanes
    end = matrix.height // lanes
    for k in range(count):
        j = first + k
        pivot = matrix.entry(j, j)
        with code.when(~(pivot > negligible * diagonal.load(j))):
            code.give(front)
        inverse = (1.0 / pivot.apply("sqrt")).spread(lanes)
        column = matrix.packs(j)
        with code.loop(end, j // lanes) as q:
            column.store(q, column.load(q) * inverse)
        for later in range(k + 1, count):
            factor = matrix.entry(first + later, j).spread(lanes)
            other = matrix.packs(first + later)
            with code.loop(end, (first + later) // lanes) as q:
                other.store(q, other.load(q) - factor * column.load(q))
    own = [matrix.packs(first + k) for k in range(count)]
    with code.loop(columns, first + count) as c:
        factors = [matrix.entry(c, first + k).spread(lanes) for k in range(count)]
        other = matrix.packs(c)
        with code.loop(end, c // lanes) as q:
            found = other.load(q)
            for factor, column in zip(factors, own, strict=True):
                found = found - factor * column.load(q)
            other.store(q, found)
