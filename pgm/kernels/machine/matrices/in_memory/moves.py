"""Matrices in memory entry by entry: sums, copies, and what stands on a diagonal.

These functions serve matrices of all shapes, which they are told as they are called.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.matrices.in_memory.views import View
from pgm.kernels.numbers import most


def copied(code: Code, a: View, out: View, packs: Whole) -> None:
    """A copy of A."""
    _each(code, lambda x: x, packs, a, out)


def cleared(code: Code, out: View, packs: Whole) -> None:
    """Zeros."""
    with code.loop(packs) as k:
        out.put(0, k, 0.0)


def summed(code: Code, a: View, b: View, out: View, packs: Whole) -> None:
    """The sum A + B."""
    _each(code, lambda x, y: x + y, packs, a, b, out)


def subtracted(code: Code, a: View, b: View, out: View, packs: Whole) -> None:
    """The difference A − B."""
    _each(code, lambda x, y: x - y, packs, a, b, out)


def negative(code: Code, a: View, out: View, packs: Whole) -> None:
    """The negative −A."""
    _each(code, lambda x: 0.0 - x, packs, a, out)


def scaled(code: Code, a: View, number: View, out: View, packs: Whole) -> None:
    """A times a number."""
    by = number.entry(0, 0)
    _each(code, lambda x: x * by, packs, a, out)


def chosen(code: Code, a: View, b: View, truth: View, out: View, packs: Whole) -> None:
    """A where a truth holds, B elsewhere."""
    holds = truth.entry(0, 0).as_truth()
    _each(code, holds.where, packs, a, b, out)


def raised(code: Code, a: View, numbers: View, size: Whole, apart: Whole) -> None:
    """Numbers added to a diagonal, whose entries are so far apart."""
    with code.loop(size) as i:
        place = i * apart
        a.put_entry(0, place, a.entry(0, place) + numbers.entry(0, i))


def kept(code: Code, a: View, truths: View, out: View, height: Whole, packs: Whole) -> None:
    """A with zeros in rows whose truth does not hold."""
    zero = code.constant(0.0)
    with code.loop(height) as i:
        holds = truths.entry(0, i).as_truth()
        with code.loop(packs) as q:
            place = i * packs + q
            out.put(0, place, holds.where(a.pack(0, place), zero))


def largest(code: Code, a: View, out: View, height: Whole, packs: Whole) -> None:
    """The largest magnitude in each column, as a row."""
    with code.loop(packs) as q:
        found = code.variable(abs(a.pack(0, q)))
        with code.loop(height, 1) as i:
            found.set(most(found.get(), abs(a.pack(0, i * packs + q))))
        out.put(0, q, found.get())


def block(
    code: Code,
    a: View,
    out: View,
    height: Whole,
    width: Whole,
    down: Whole,
    across: Whole,
    out_down: Whole,
    out_across: Whole,
) -> None:
    """Entries that are so far apart in either direction, written to such places."""
    with code.loop(height) as i, code.loop(width) as j:
        to = i * out_down + j * out_across
        out.put_entry(0, to, a.entry(0, i * down + j * across))


def stretches(places: Sequence[int]) -> Iterator[tuple[int, int]]:
    """The first and the number of places that follow on each other."""
    for _, group in groupby(enumerate(places), lambda each: each[1] - each[0]):
        found = [place for _, place in group]
        yield found[0], len(found)


def _each(code: Code, operation: Callable[..., Number], packs: Whole, *views: View) -> None:
    *given, out = views
    with code.loop(packs) as k:
        out.put(0, k, operation(*(view.pack(0, k) for view in given)))
