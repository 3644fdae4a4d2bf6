"""Matrices as functions of a shape see them: entries and packs at an address."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import packed
from pgm.kernels.machine.emitter.numbers import Number, Operand, constant
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.matrices.in_memory.layout import Layout

Index = Whole | int


class View:
    """A matrix (height × width) at an address; turned, it is seen as its transpose.

    An *entry* is one number, in one lane or in one of each run; a *pack* q of a row is what lies in
    its lanes. Only a matrix that is not turned has packs.
    """

    def __init__(
        self,
        code: Code,
        layout: Layout,
        address: Address,
        height: int,
        width: int,
        turned: bool = False,
    ) -> None:
        self.code, self.layout, self.address = code, layout, address
        self.height, self.width, self.turned = height, width, turned
        self.packs = layout.packs(width)

    def at(self, i: Index, j: Index) -> Address:
        """The address of an entry."""
        if self.turned:
            i, j = j, i
        return self.address + (i * (self.packs * self.layout.across) + j) * self.layout.entry

    def entry(self, i: Index, j: Index) -> Number:
        """An entry."""
        return self._load(self.at(i, j), self.layout.entry)

    def put_entry(self, i: Index, j: Index, value: Operand) -> None:
        """Write an entry."""
        self._store(self.at(i, j), self.layout.entry, value)

    def pack(self, i: Index, q: Index) -> Number:
        """A pack of a row."""
        return self.beside(i, q * self.layout.across)

    def beside(self, i: Index, j: Index) -> Number:
        """The pack of a row that begins at a column."""
        return self._load(self.at(i, j), self.layout.lanes)

    def put(self, i: Index, q: Index, value: Operand) -> None:
        """Write a pack of a row."""
        self._store(self.at(i, q * self.layout.across), self.layout.lanes, value)

    def one(self, value: float) -> Number:
        """A constant, as an entry is."""
        return constant(self.code, value).spread(self.layout.entry)

    def _load(self, place: Address, lanes: int) -> Number:
        kind = packed("double", lanes)
        return Number(self.code, self.code.value(f"load {kind}, ptr {place.text}, align 8"), lanes)

    def _store(self, place: Address, lanes: int, value: Operand) -> None:
        number = constant(self.code, value).number().spread(lanes)
        self.code.line(f"store {number.kind} {number.text}, ptr {place.text}, align 8")


def tiled(
    code: Code,
    count: int,
    size: int,
    body: Callable[[Any, int], None],
    first: Index = 0,
    last: Index | None = None,
    *,
    down: bool = False,
) -> None:
    """Write a body for all of `count` places, `size` at a time, and for the rest at their end.

    It is given the first place of a tile, and the number of its places. Tiles that end before the
    place `first`, or begin after `last`, are left out.
    """
    full, rest = divmod(count, size)
    begin = first if isinstance(first, int) and not first else first // size

    def whole() -> None:
        if full == 1 and isinstance(begin, int) and last is None:
            if not begin:
                body(0, size)
        elif full:
            with code.loop(full, begin, down=down) as k:
                place = k * size
                if last is not None:
                    code.leave_when(place > last)
                body(place, size)

    def end() -> None:
        place = full * size
        if not rest:
            return
        if isinstance(last, Whole):
            with code.when(last >= place):
                body(place, rest)
        elif last is None or last >= place:
            body(place, rest)

    for part in (end, whole) if down else (whole, end):
        part()


def size_of(count: int, most: int) -> int:
    """The size of tiles, at most this, all of which are nearly alike."""
    parts = max(-(-count // most), 1)
    return max(-(-count // parts), 1)


def shuffled(a: Number, b: Number, places: Sequence[int]) -> Number:
    """The pack of some lanes of two, those of the second counted on from those of the first."""
    mask = ", ".join(f"i32 {place}" for place in places)
    two = f"{a.kind} {a.text}, {b.kind} {b.text}"
    found = a.code.value(f"shufflevector {two}, <{len(places)} x i32> <{mask}>")
    return Number(a.code, found, len(places), a.truth)


def lanes_where(code: Code, truths: Sequence[bool]) -> Number:
    """The pack of truths that are known."""
    text = ", ".join(f"i1 {'true' if truth else 'false'}" for truth in truths)
    return Number(code, f"<{text}>", len(truths), truth=True)


def transposed(block: Sequence[Number]) -> list[Number]:
    """The transpose of a square block, of as many packs as lanes."""
    rows, size, step = list(block), len(block), 1
    while step < size:
        for i in range(size):
            if not i & step:
                a, b = rows[i], rows[i + step]
                low = [k if not k & step else size + k - step for k in range(size)]
                high = [k + step if not k & step else size + k for k in range(size)]
                rows[i], rows[i + step] = shuffled(a, b, low), shuffled(a, b, high)
        step *= 2
    return rows
