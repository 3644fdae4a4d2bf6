"""The rows of fronts, triangular by Householder's reflections, from the leaves to the roots.

Before each reflection the row with the largest number in its column is taken first, so that rows of
very different sizes keep their digits (Powell & Reid, 1969; Cox & Higham, 1998).
"""

from __future__ import annotations

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import ADDRESS, FLOAT, WHOLE
from pgm.kernels.machine.emitter.memory import Cells, Memory
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.fronts.writing import TOGETHER, Given, Matrix, packs, padded, scalar

# Numbers of a column that are so small are zeros: their inverses are beyond float64's range.
_NOTHING = 1e-300


def write(module: Module, lanes: int) -> None:
    """Write the function of all fronts' rows.

    It is ``rows(plan, entries, right, kept, left, residual, work, first, last, sides,
    negligible)``. It makes the rows of the fronts from `first` to below `last` triangular, and
    keeps their pivots' rows; what they leave goes to `left`, and the squares of what is left at
    last are added to `residual` (sides,). It gives the number of the first front with a pivot that
    is no more than `negligible` of its column, else −1.
    """
    kinds = [ADDRESS] * 7 + [WHOLE] * 3 + [FLOAT]
    code = module.function("rows", kinds, WHOLE, lanes=lanes, disjoint=True)
    table, entries, right, kept, left, residual, work, first, last, sides, negligible = (
        code.arguments
    )
    given = Given.of(code, table, (entries, right, left), sides)
    told = given.told
    with code.loop(last, first) as front:
        rows, columns = told["rows"].load(front), told["sizes"].load(front)
        pivots = told["pivots"].load(front)
        height = padded(code, rows)
        matrix = Matrix(code, work + height, height)  # behind the reflection's vector
        matrix.clear(columns + sides)
        _gather(code, given, front, matrix, columns)
        with code.when(rows < pivots):
            code.give(front)
        _reflect(code, matrix, packs(code, work), rows, columns, sides)
        _keep(code, told, front, matrix, kept, sides, negligible)
        _leave(code, told, front, matrix, left, sides)
        sums = Memory(code, residual, lanes=1)
        with code.loop(sides) as n:
            total = code.variable(sums.load(n))
            with code.loop(rows, columns) as i:
                rest = matrix.entry(i, columns + n)
                total.set(total.get() + rest * rest)
            sums.store(n, total.get())
    code.give(code.whole(-1))


def _gather(code: Code, given: Given, front: Whole, matrix: Matrix, columns: Whole) -> None:
    """Put the rows of a front's factors and of its children below one another."""
    told, sides = given.told, given.sides
    filled = code.variable(code.whole(0))
    factors, where = told["factors"], told["columns"]
    with given.each("first_factor", front) as k:
        height, width, entry, row, begin = (factors.load(k * 5 + part) for part in range(5))
        with code.loop(height) as i:
            at = filled.get()
            with code.loop(width) as j:
                matrix.put(at, where.load(begin + j), given.entries.load(entry + i * width + j))
            with code.loop(sides) as n:
                matrix.put(at, columns + n, given.right.load((row + i) * sides + n))
            filled.set(at + 1)
    with given.each("first_child", front) as k:
        child = told["children"].load(k)
        shared, begin = told["separators"].load(child), told["first_column"].load(child)
        stack, width = told["waiting"].load(child), shared + sides
        with code.loop(told["sent"].load(child)) as i:
            at = filled.get()
            with code.loop(shared, i) as j:
                column = told["above"].load(begin + j)
                matrix.put(at, column, given.left.load(stack + i * width + j))
            with code.loop(sides) as n:
                matrix.put(at, columns + n, given.left.load(stack + i * width + shared + n))
            filled.set(at + 1)


def _reflect(
    code: Code, matrix: Matrix, vector: Memory, rows: Whole, columns: Whole, sides: Whole
) -> None:
    """Make the matrix triangular, in its first columns; the others go along."""
    lanes = code.lanes
    every = columns + sides
    numbers = Memory(code, vector.address, lanes=1)
    packs_in_all = matrix.height // lanes
    with code.loop(rows.at_most(columns)) as j:
        largest, place = code.variable(scalar(code, -1.0)), code.variable(j)
        with code.loop(rows, j) as i:
            size = abs(matrix.entry(i, j))
            with code.when(size > largest.get()):
                largest.set(size)
                place.set(i)
        with code.when(largest.get() > _NOTHING):
            top = place.get()
            with code.when(top != j), code.loop(every, j) as c:
                one, other = matrix.entry(j, c), matrix.entry(top, c)
                matrix.put(j, c, other)
                matrix.put(top, c, one)
            # u = x / x₁ of the column x, ρ = ‖u‖: v = u + ρ e₁, and H = 1 − v vᵀ / (ρ (1 + ρ)).
            head = matrix.entry(j, j)
            inverse = 1.0 / head
            first = j // lanes
            column = matrix.packs(j)
            squares = code.varying(0.0)
            with code.loop(packs_in_all, first) as q:
                vector.store(q, column.load(q) * inverse.spread(lanes))
            with code.loop(j, first * lanes) as i:
                numbers.store(i, 0.0)
            with code.loop(packs_in_all, first) as q:
                pack = vector.load(q)
                squares.set(squares.get() + pack * pack)
            rho = _sum(squares.get()).apply("sqrt")
            numbers.store(j, rho + 1.0)
            share = 1.0 / (rho * (rho + 1.0))
            matrix.put(j, j, -(head * rho))
            after = j + 1
            wide = (every - after) // TOGETHER

            def turned(c: Whole, width: int) -> None:
                ahead = [matrix.packs(c + w) for w in range(width)]
                dots = [code.varying(0.0) for _ in range(width)]
                with code.loop(packs_in_all, first) as q:
                    pack = vector.load(q)
                    for dot, own in zip(dots, ahead, strict=True):
                        dot.set(dot.get() + pack * own.load(q))
                factors = [(_sum(dot.get()) * share).spread(lanes) for dot in dots]
                with code.loop(packs_in_all, first) as q:
                    pack = vector.load(q)
                    for factor, own in zip(factors, ahead, strict=True):
                        own.store(q, own.load(q) - factor * pack)

            with code.loop(wide) as k:
                turned(after + k * TOGETHER, TOGETHER)
            with code.loop(every, after + wide * TOGETHER) as c:
                turned(c, 1)


def _keep(
    code: Code,
    told: dict[str, Cells[Whole]],
    front: Whole,
    matrix: Matrix,
    kept: Address,
    sides: Whole,
    negligible: Number,
) -> None:
    """Keep the pivots' rows, with positive pivots; give the front where one is negligible."""
    pivots, columns = told["pivots"].load(front), told["sizes"].load(front)
    every, place = columns + sides, told["keeps"].load(front)
    out = Memory(code, kept, lanes=1)
    with code.loop(pivots) as j:
        pivot = matrix.entry(j, j)
        squares = code.variable(scalar(code, 0.0))
        with code.loop(j + 1) as i:
            entry = matrix.entry(i, j)
            squares.set(squares.get() + entry * entry)
        proper = abs(pivot) > negligible * squares.get().apply("sqrt")
        with code.when(~proper):
            code.give(front)
        sign = (pivot < 0.0).where(scalar(code, -1.0), scalar(code, 1.0))
        with code.loop(every, j) as c:
            out.store(place + j * every + c, sign * matrix.entry(j, c))


def _leave(
    code: Code,
    told: dict[str, Cells[Whole]],
    front: Whole,
    matrix: Matrix,
    left: Address,
    sides: Whole,
) -> None:
    """Leave the rows below the pivots' to the parent."""
    pivots, shared = told["pivots"].load(front), told["separators"].load(front)
    place, every = told["waiting"].load(front), shared + sides
    out = Memory(code, left, lanes=1)
    with code.loop(told["sent"].load(front)) as i, code.loop(every, i) as c:
        out.store(place + i * every + c, matrix.entry(pivots + i, pivots + c))


def _sum(pack: Number) -> Number:
    """The sum of a pack's lanes."""
    lanes = [pack.lane(k) for k in range(pack.lanes)]
    while len(lanes) > 1:
        half = len(lanes) // 2
        lanes = [a + b for a, b in zip(lanes[:half], lanes[half:], strict=True)]
    return lanes[0]
