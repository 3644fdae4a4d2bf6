"""Matrices of fronts in the room of a call: column by column, each of whole packs."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import NamedTuple

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.memory import Cells, Memory
from pgm.kernels.machine.emitter.numbers import Number, constant
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.fronts.plan import TOLD

# Columns that are worked on together: each pack of another column is loaded once for all of them.
TOGETHER = 4


class Matrix(NamedTuple):
    """A matrix at an address, whose columns lie `height` floats apart: a multiple of the lanes."""

    code: Code
    address: Address
    height: Whole

    @property
    def numbers(self) -> Memory:
        """Its numbers, one by one, column by column."""
        return Memory(self.code, self.address, lanes=1, name="front")

    def entry(self, i: Whole | int, j: Whole) -> Number:
        """The number in row i and column j."""
        return self.numbers.load(j * self.height + i)

    def put(self, i: Whole | int, j: Whole, value: Number) -> None:
        """Write the number in row i and column j."""
        self.numbers.store(j * self.height + i, value)

    def add(self, i: Whole, j: Whole, value: Number) -> None:
        """Add to the number in row i and column j."""
        place = j * self.height + i
        self.numbers.store(place, self.numbers.load(place) + value)

    def packs(self, j: Whole, first: Whole | int = 0) -> Memory:
        """The packs of column j, from a row on."""
        return packs(self.code, self.address + (j * self.height + first))

    def clear(self, columns: Whole) -> None:
        """Make so many columns zero."""
        found = packs(self.code, self.address)
        with self.code.loop(columns * self.height // self.code.lanes) as k:
            found.store(k, 0.0)


class Given(NamedTuple):
    """The arrays of a call on the way up: the plan's, and those of numbers.

    Attributes
    ----------
    told : dict of str to Cells
        See `plan`.
    entries, right : Memory
        The entries of all factors, and their right sides.
    left : Memory
        The stack on which fronts leave to their parents.
    sides : Whole
        The number of right sides.
    """

    told: dict[str, Cells[Whole]]
    entries: Memory
    right: Memory
    left: Memory
    sides: Whole

    @classmethod
    def of(cls, code: Code, table: Address, numbers: Sequence[Address], sides: Whole) -> Given:
        """The arrays at addresses: of a plan's table, and of entries, right sides and the stack."""
        entries, right, left = (Memory(code, each, lanes=1) for each in numbers)
        return cls(plan(code, table), entries, right, left, sides)

    def each(self, first: str, front: Whole) -> AbstractContextManager[Whole]:
        """The code inside runs for each number from a front's `first` to the next front's."""
        starts = self.told[first]
        return self.entries.code.loop(starts.load(front + 1), starts.load(front))


def packs(code: Code, address: Address) -> Memory:
    """The packs that lie one after another from an address on."""
    return Memory(code, address, step=code.lanes, name="front")


def padded(code: Code, count: Whole) -> Whole:
    """The least multiple of the lanes that is no less."""
    return (count + (code.lanes - 1)) // code.lanes * code.lanes


def plan(code: Code, table: Address) -> dict[str, Cells[Whole]]:
    """The arrays of a plan, from the table of their addresses."""
    addresses = code.addresses(table, len(TOLD), "plan")
    return {name: code.wholes(addresses.load(k), name=name) for k, name in enumerate(TOLD)}


def scalar(code: Code, value: float) -> Number:
    """The number of one lane of a value that is known."""
    return constant(code, value)


def product(
    code: Code, left: Matrix, right: Matrix, out: Matrix, shape: tuple[Whole, Whole, Whole]
) -> None:
    """Write the product of two matrices, of which `left` has only zeros below its rows.

    `shape` are the rows of the product, the numbers that are summed for each entry, and the columns
    of the product.
    """
    helper = code.module.helper("product", [ADDRESS, WHOLE] * 3 + [WHOLE] * 3, code.lanes, None)
    if helper.fresh:
        _product(helper.code)
    given = [part for each in (left, right, out) for part in (each.address, each.height)]
    code.call(helper.code, *given, *shape)


def _product(code: Code) -> None:
    a, lda, b, ldb, c, ldc, rows, inner, columns = code.arguments
    left, right, out = Matrix(code, a, lda), Matrix(code, b, ldb), Matrix(code, c, ldc)
    count = (rows + (code.lanes - 1)) // code.lanes

    def block(j: Whole, width: int, q: Whole, tall: int) -> None:
        sums = [[code.varying(0.0) for _ in range(tall)] for _ in range(width)]
        with code.loop(inner) as k:
            column = left.packs(k)
            packs = [column.load(q + t) for t in range(tall)]
            for w in range(width):
                factor = right.entry(k, j + w).spread(code.lanes)
                for t in range(tall):
                    sums[w][t].set(sums[w][t].get() + packs[t] * factor)
        for w in range(width):
            for t in range(tall):
                out.packs(j + w).store(q + t, sums[w][t].get())

    def across(j: Whole, width: int) -> None:
        pairs = count // 2
        with code.loop(pairs) as k:
            block(j, width, k * 2, 2)
        with code.loop(count, pairs * 2) as q:
            block(j, width, q, 1)

    whole = columns // TOGETHER
    with code.loop(whole) as k:
        across(k * TOGETHER, TOGETHER)
    with code.loop(columns, whole * TOGETHER) as j:
        across(j, 1)
