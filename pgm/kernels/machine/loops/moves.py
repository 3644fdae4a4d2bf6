"""Matrices in memory entry by entry: sums, copies, parts, and what stands on a diagonal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby

from pgm.kernels.machine.code import Code
from pgm.kernels.machine.loops.views import Index, View, lanes_where
from pgm.kernels.machine.numbers import Number
from pgm.kernels.numbers import most


def copied(code: Code, a: View, out: View) -> None:
    """A copy of A."""
    _each(code, lambda x: x, a, out)


def summed(code: Code, a: View, b: View, out: View) -> None:
    """The sum A + B."""
    _each(code, lambda x, y: x + y, a, b, out)


def subtracted(code: Code, a: View, b: View, out: View) -> None:
    """The difference A − B."""
    _each(code, lambda x, y: x - y, a, b, out)


def scaled(code: Code, a: View, number: View, out: View) -> None:
    """A times a number."""
    by = number.entry(0, 0)
    _each(code, lambda x: x * by, a, out)


def chosen(code: Code, a: View, b: View, truth: View, out: View) -> None:
    """A where a truth holds, B elsewhere."""
    holds = truth.entry(0, 0).as_truth()
    _each(code, holds.where, a, b, out)


def one_minus(code: Code, a: View, out: View) -> None:
    """The matrix I − A."""
    _each(code, lambda x: 0.0 - x, a, out)
    with code.loop(a.height) as i:
        out.put_entry(i, i, 1.0 - a.entry(i, i))


def raised(code: Code, a: View, numbers: View) -> None:
    """Numbers added to a diagonal."""
    with code.loop(a.height) as i:
        a.put_entry(i, i, a.entry(i, i) + numbers.entry(0, i))


def diagonal(code: Code, a: View, out: View) -> None:
    """The diagonal, as a row."""
    _clear(out)
    with code.loop(a.height) as i:
        out.put_entry(0, i, a.entry(i, i))


def largest(code: Code, a: View, out: View) -> None:
    """The largest magnitude in each column, as a row."""
    with code.loop(a.packs) as q:
        found = code.variable(abs(a.pack(0, q)))
        with code.loop(a.height, 1) as i:
            found.set(most(found.get(), abs(a.pack(i, q))))
        out.put(0, q, found.get())


def kept(code: Code, a: View, truths: View, out: View) -> None:
    """A with zeros in rows whose truth does not hold."""
    zero = code.constant(0.0)
    with code.loop(a.height) as i:
        holds = truths.entry(0, i).as_truth()
        with code.loop(a.packs) as q:
            out.put(i, q, holds.where(a.pack(i, q), zero))


def part(code: Code, a: View, out: View, rows: Sequence[int], columns: Sequence[int]) -> None:
    """The entries in some rows and columns."""
    stretches, at = list(_stretches(columns)), 0
    alone = len(stretches) == 1
    if not alone:
        _clear(out)
    for i, height in _stretches(rows):
        with code.loop(height) as r:
            to = 0
            for j, width in stretches:
                if alone:
                    _row(a, i + r, j, out, at + r)
                else:
                    _entries(a, (i + r, j), out, (at + r, to), (1, width))
                to += width
        at += height


def widened(code: Code, a: View, out: View, places: Sequence[int]) -> None:
    """The columns of A at some places, zeros elsewhere."""
    _clear(out)
    at = 0
    for j, width in _stretches(places):
        _entries(a, (0, at), out, (0, j), (out.height, width))
        at += width


def bordered(code: Code, a: View, b: View, c: View, out: View) -> None:
    """The symmetric matrix [[A, Bᵀ], [B, C]]."""
    n, m = a.height, c.height
    _clear(out)
    _entries(a, (0, 0), out, (0, 0), (n, n))
    with code.loop(m) as i, code.loop(n) as j:
        x = b.entry(i, j)
        out.put_entry(n + i, j, x)
        out.put_entry(j, n + i, x)
    _entries(c, (0, 0), out, (n, n), (m, m))


def above(code: Code, a: View, b: View, out: View) -> None:
    """A column, and below it another; the first lane of A counts, where rows are packs."""
    first, second = (each.width if each.turned else each.height for each in (a, b))
    _clear(out)
    _entries(a, (0, 0), out, (0, 0), (first, 1))
    _entries(b, (0, 0), out, (first, 0), (second, 1))


def _each(code: Code, operation: Callable[..., Number], *views: View) -> None:
    *given, out = views
    with code.loop(out.height * out.packs) as k:
        out.put(0, k, operation(*(view.pack(0, k) for view in given)))


def _clear(out: View) -> None:
    """Write zeros."""
    height, packs = (out.height, out.packs)
    plain = View(out.code, out.layout, out.address, out.height, out.width)
    with out.code.loop(height * packs) as k:
        plain.put(0, k, 0.0)


def _row(a: View, i: Index, j: int, out: View, at: Index) -> None:
    """Write a row from the columns of another, from j on."""
    across, code = out.layout.across, out.code
    if across == 1:
        with code.loop(out.width) as k:
            out.put(at, k, a.beside(i, k + j))
        return
    full, rest = divmod(out.width, across)
    for q in range(full):
        out.put(at, q, a.beside(i, j + q * across))
    if rest:
        real = lanes_where(code, [lane < rest for lane in range(across)])
        out.put(at, full, real.where(a.beside(i, j + full * across), code.constant(0.0)))


def _entries(
    a: View,
    source: tuple[Index, Index],
    out: View,
    to: tuple[Index, Index],
    shape: tuple[int, int],
) -> None:
    """Copy a block, entry by entry."""
    code, (i, j), (k, m) = out.code, source, to
    with code.loop(shape[0]) as r, code.loop(shape[1]) as c:
        out.put_entry(k + r, m + c, a.entry(i + r, j + c))


def _stretches(places: Sequence[int]) -> Iterator[tuple[int, int]]:
    """The first and the number of places that follow on each other."""
    for _, group in groupby(enumerate(places), lambda each: each[1] - each[0]):
        found = [place for _, place in group]
        yield found[0], len(found)
