"""Triangular roots of matrices in memory, and systems that they solve, by rows of the upper one."""

from __future__ import annotations

from collections.abc import Callable

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.elementary import elementary
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.matrices.in_memory.views import Index, View, size_of, tiled
from pgm.kernels.numbers import inner, inverse, least, sqrt

# Rows that are eliminated at once.
_TALL = 4


def root(code: Code, a: View, upper: View, over: View, pivots: View, share: View) -> None:
    """The root Lᵀ of A = L Lᵀ on and above its diagonal, the inverse pivots, and the share.

    Below the diagonal is nothing of meaning. Pivots beyond the last are ones.
    """
    least_share = code.variable(share.one(1.0))
    tall, wide = _tile(upper)
    for p in range(pivots.packs):
        pivots.put(0, p, 1.0)

    def rows(i: Index, height: int) -> None:
        first = i // upper.layout.across

        def eliminate(q: Index, packs: int) -> None:
            rest = _rest(a, upper, i, height, q, packs, code.whole(i), 0, _across(upper))
            _put(upper, i, q, rest)

        tiled(code, upper.packs, wide, eliminate, first)
        corner: list[list[Number]] = []
        for r in range(height):
            known: list[Number] = []
            for t in range(r):
                before = inner(known, corner[t][:t])
                known.append((upper.entry(i + t, i + r) - before) * over.entry(0, i + t))
            pivot = upper.entry(i + r, i + r) - inner(known, known)
            part = pivot * inverse(abs(a.entry(i + r, i + r)))
            least_share.set(least(part, least_share.get()))
            known.append(sqrt(pivot))
            over.put_entry(0, i + r, inverse(known[r]))
            pivots.put_entry(0, i + r, known[r])
            corner.append(known)

        def divide(q: Index, packs: int) -> None:
            lines = [[upper.pack(i + r, q + p) for p in range(packs)] for r in range(height)]
            for r, line in enumerate(lines):
                for t in range(r):
                    line[:] = _less(line, corner[r][t], lines[t])
                line[:] = [x * over.entry(0, i + r) for x in line]
            _put(upper, i, q, lines)

        tiled(code, upper.packs, wide, divide, first)

    tiled(code, upper.height, tall, rows)
    share.put_entry(0, 0, least_share.get())


def solved(code: Code, upper: View, over: View, right: View, out: View) -> None:
    """The X with L X = B."""
    tall, wide = _tile(out)

    def rows(i: Index, height: int) -> None:
        def tile(q: Index, packs: int) -> None:
            _low(upper, over, (right, out), (i, height), (q, packs), 0)

        tiled(code, out.packs, wide, tile)

    tiled(code, out.height, tall, rows)


def solved_transposed(code: Code, upper: View, over: View, right: View, out: View) -> None:
    """The X with Lᵀ X = B."""
    tall, wide = _tile(out)

    def rows(i: Index, height: int) -> None:
        def tile(q: Index, packs: int) -> None:
            below, size = code.whole(i + height), code.whole(out.height)
            lines = _rest(right, out, i, height, q, packs, size, below, upper.entry)
            for r in reversed(range(height)):
                for t in range(r + 1, height):
                    lines[r] = _less(lines[r], upper.entry(i + r, i + t), lines[t])
                lines[r] = [x * over.entry(0, i + r) for x in lines[r]]
            _put(out, i, q, lines)

        tiled(code, out.packs, wide, tile)

    tiled(code, out.height, tall, rows, down=True)


def precisions(code: Code, upper: View, over: View, eye: View, low: View, out: View) -> None:
    """The diagonal of A⁻¹, as a row: the squares of L⁻¹ column by column, `eye` being I.

    L⁻¹ is found in `low`, tile by tile; those above the diagonal are left out.
    """
    tall, wide = _tile(low)
    for p in range(out.packs):
        out.put(0, p, 0.0)

    def rows(i: Index, height: int) -> None:
        def tile(q: Index, packs: int) -> None:
            first = q * low.layout.across
            lines = _low(upper, over, (eye, low), (i, height), (q, packs), first)
            for p in range(packs):
                total = out.pack(0, q + p)
                for line in lines:
                    total = total + line[p] * line[p]
                out.put(0, q + p, total)

        tiled(code, low.packs, wide, tile, last=(i + (height - 1)) // low.layout.across)

    tiled(code, low.height, tall, rows)


def triangle(code: Code, upper: View, out: View) -> None:
    """The root Lᵀ with zeros below its diagonal."""
    with code.loop(out.height) as i:
        with code.loop(out.packs) as q:
            out.put(i, q, upper.pack(i, q))
        with code.loop(i) as j:
            out.put_entry(i, j, 0.0)


def volume(code: Code, pivots: View, out: View) -> None:
    """The logarithm of |L|, of its pivots, by pairs: no product is too small or too large."""
    total = code.variable(out.one(0.0))
    pairs, rest = divmod(pivots.width, 2)
    with code.loop(pairs) as k:
        both = pivots.entry(0, k * 2) * pivots.entry(0, k * 2 + 1)
        total.set(total.get() + elementary("log", both))
    if rest:
        total.set(total.get() + elementary("log", pivots.entry(0, pivots.width - 1)))
    out.put_entry(0, 0, total.get())


def _tile(out: View) -> tuple[int, int]:
    tall = min(_TALL, max(out.layout.held // 2, 1))
    return tall, size_of(out.packs, max(out.layout.held // tall, 1))


def _across(upper: View) -> Callable[[Index, Index], Number]:
    return lambda i, k: upper.entry(k, i)


def _rest(
    right: View,
    known: View,
    i: Index,
    height: int,
    q: Index,
    packs: int,
    end: Index,
    begin: Index,
    coefficient: Callable[[Index, Index], Number],
) -> list[list[Number]]:
    """A tile of a right side, less what the rows from `begin` to below `end` tell of it."""
    code = right.code
    rest = [[code.variable(right.pack(i + r, q + p)) for p in range(packs)] for r in range(height)]
    with code.loop(end, begin) as k:
        above = [known.pack(k, q + p) for p in range(packs)]
        for r, line in enumerate(rest):
            x = coefficient(i + r, k)
            for each, pack in zip(line, above, strict=True):
                each.set(each.get() - x * pack)
    return [[each.get() for each in line] for line in rest]


def _low(
    upper: View,
    over: View,
    sides: tuple[View, View],
    rows: tuple[Index, int],
    columns: tuple[Index, int],
    begin: Index,
) -> list[list[Number]]:
    """A tile of the X with L X = B, of which the rows from `begin` on count; it is written down."""
    (right, out), (i, height), (q, packs) = sides, rows, columns
    coefficient, code = _across(upper), out.code
    lines = _rest(right, out, i, height, q, packs, code.whole(i), begin, coefficient)
    for r, line in enumerate(lines):
        for t in range(r):
            line[:] = _less(line, coefficient(i + r, i + t), lines[t])
        line[:] = [x * over.entry(0, i + r) for x in line]
    _put(out, i, q, lines)
    return lines


def _less(line: list[Number], x: Number, other: list[Number]) -> list[Number]:
    return [a - x * b for a, b in zip(line, other, strict=True)]


def _put(out: View, i: Index, q: Index, lines: list[list[Number]]) -> None:
    for r, line in enumerate(lines):
        for p, pack in enumerate(line):
            out.put(i + r, q + p, pack)
