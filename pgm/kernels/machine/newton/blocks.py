"""Matrices in memory, whose operations are loops, for those too large for straight lines.

A row is filled up to whole packs of numbers side by side, which are worked on together; what stands
there beside the matrix is never read for a number of it. Results lie in memory that is taken from a
`Workspace` as code is written, and are overwritten when their code runs again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.numbers import Number, Operand
from pgm.kernels.machine.emitter.variables import Variable
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.numbers import inverse, least, sqrt

Place = Whole | int
# Rows of a product, and packs of a solution, that are worked on together: no sum waits for another.
_TOGETHER = 4
# Of the widest packs; and up to how many columns rows may be filled up to half of such.
_LANES, _NARROW = 8, 28


def lanes_of(columns: int) -> int:
    """How many numbers of a row make a pack."""
    if columns == 1:
        return 1
    half = _LANES // 2
    return half if columns <= _NARROW and 0 < columns % _LANES <= half else _LANES


def padded(columns: int) -> int:
    """The numbers in memory of a row of so many columns."""
    return -(-columns // lanes_of(columns)) * lanes_of(columns)


class Workspace:
    """Memory from an address on, taken bit by bit as code is written; `taken` says how much was."""

    def __init__(self, code: Code, address: Address) -> None:
        self.code, self._address, self.taken = code, address, 0

    def take(self, count: int) -> Address:
        """Memory for so many floats."""
        address, self.taken = self._address + self.taken, self.taken + -(-count // _LANES) * _LANES
        return address

    def block(self, height: int, width: int) -> Block:
        """A matrix, whose numbers are still to be set."""
        return Block(self, self.take(height * padded(width)), height, width)


class Block:
    """A matrix (height, width) in memory, or the transpose of one.

    `wide` is how many floats lie from row to row.
    """

    def __init__(
        self,
        space: Workspace,
        address: Address,
        height: int,
        width: int,
        *,
        wide: int | None = None,
        turned: bool = False,
    ) -> None:
        self.space, self.address, self.shape = space, address, (height, width)
        self.wide, self.turned = padded(width) if wide is None else wide, turned
        self.lanes = lanes_of(width)
        self._cells = Memory(space.code, address, lanes=1)
        self._packs = Memory(space.code, address, lanes=self.lanes)

    def __getitem__(self, place: tuple[Place, Place]) -> Number:
        return self.load(*place)

    def load(self, i: Place, j: Place) -> Number:
        """The number in a row and a column."""
        i, j = (j, i) if self.turned else (i, j)
        return self._cells.load(i * self.wide + j)

    def store(self, i: Place, j: Place, number: Operand) -> None:
        """Set the number in a row and a column."""
        self._cells.store(i * self.wide + j, number)

    def pack(self, i: Place, p: Place) -> Number:
        """The pack p of a row."""
        return self._packs.load(i * self.wide + p * self.lanes)

    def put(self, i: Place, p: Place, pack: Operand) -> None:
        """Set the pack p of a row."""
        self._packs.store(i * self.wide + p * self.lanes, pack)

    @property
    def packs(self) -> int:
        """The packs of a row."""
        return padded(self.shape[1]) // self.lanes

    def fill(self, number: float) -> Block:
        """Set all numbers to one that is known."""
        self._each(lambda p: number)
        return self

    def set(self, other: Block) -> None:
        """Set all numbers to those of another matrix, whose rows are filled up as these are."""
        self._each(lambda p: other.pack(0, p))

    @property
    def T(self) -> Block:
        """The matrix transposed, in the same memory."""
        height, width = self.shape
        return Block(
            self.space, self.address, width, height, wide=self.wide, turned=not self.turned
        )

    def __add__(self, other: Block) -> Block:
        found = self._like()
        found._each(lambda p: self.pack(0, p) + other.pack(0, p))
        return found

    def __sub__(self, other: Block) -> Block:
        found = self._like()
        found._each(lambda p: self.pack(0, p) - other.pack(0, p))
        return found

    def __matmul__(self, other: Block) -> Block:
        found = self.space.block(self.shape[0], other.shape[1])
        self._product(other, found, lambda last: found.packs)
        return found

    def times(self, other: Block) -> Block:
        """The product A Bᵀ, of which it is known that it is symmetric: half of it is computed."""
        size, code = self.shape[0], self.space.code
        found = self.space.block(size, size)
        right = other.T if other.turned else other._contiguous_transpose()
        self._product(right, found, lambda last: last // found.lanes + 1)
        with code.loop(size) as i, code.loop(i) as j:
            found.store(j, i, found.load(i, j))
        return found

    def root(self) -> Root:
        """The root of a symmetric matrix A = L Lᵀ."""
        return Root(self)

    def _like(self) -> Block:
        return self.space.block(*self.shape)

    def _each(self, pack: Callable[[Whole], Operand]) -> None:
        """Set each pack, row after row, counted from the first of the first."""
        with self.space.code.loop(self.shape[0] * self.packs) as p:
            self.put(0, p, pack(p))

    def _contiguous_transpose(self) -> Block:
        code, (height, width) = self.space.code, self.shape
        found = self.space.block(width, height)
        with code.loop(height) as i, code.loop(width) as j:
            found.store(j, i, self.load(i, j))
        return found

    def _product(self, other: Block, found: Block, packs: Callable[[Whole], Place]) -> None:
        """Set the packs of rows of a matrix, up to so many by a row's number, to those of A B."""
        code, (height, inner) = self.space.code, self.shape
        with by_groups(code, height) as (i, count), code.loop(packs(i + (count - 1))) as p:

            def terms(k: Whole) -> list[Number]:
                right = other.pack(k, p)
                return [self.load(i + r, k) * right for r in range(count)]

            for r, total in enumerate(summed(code, inner, 0, terms, [0.0] * count, other.lanes)):
                found.put(i + r, p, total)


class Root:
    """The root A = L Lᵀ of a symmetric matrix in memory, kept as the upper triangular Lᵀ.

    `share` is the least part of its diagonal entry that is left to a pivot; see `numbers.Root`.
    """

    def __init__(self, matrix: Block) -> None:
        self._space, self._size = matrix.space, matrix.shape[0]
        code, size = self._space.code, self._size
        self._upper = upper = self._space.block(size, size)
        self._over = Memory(code, self._space.take(size), lanes=1)
        upper.set(matrix)
        share, lanes = code.varying(1.0), upper.lanes
        with code.loop(size) as i:
            pivot = upper.load(i, i)
            share.set(least(pivot * inverse(abs(matrix.load(i, i))), share.get()))
            over = inverse(sqrt(pivot))
            self._over.store(i, over)
            with code.loop(upper.packs, i // lanes) as p:
                upper.put(i, p, upper.pack(i, p) * over)
            with code.loop(size, i + 1) as r:
                part = upper.load(i, r)
                with code.loop(upper.packs, r // lanes) as p:
                    upper.put(r, p, upper.pack(r, p) - part * upper.pack(i, p))
        self.share = share.get()

    def solve(self, right: Block) -> Block:
        """The X with L X = B."""
        found = self._space.block(*right.shape)
        with self._space.code.loop(self._size) as i:
            self._row(i, 0, i, self._upper.T, right, found)
        return found

    def solve_transposed(self, right: Block) -> Block:
        """The X with Lᵀ X = B."""
        found = self._space.block(*right.shape)
        with self._space.code.loop(self._size, down=True) as i:
            self._row(i, i + 1, self._size, self._upper, right, found)
        return found

    @property
    def inverse(self) -> Block:
        """The matrix A⁻¹."""
        eye = self._space.block(self._size, self._size).fill(0.0)
        with self._space.code.loop(self._size) as i:
            eye.store(i, i, 1.0)
        white = self.solve(eye).T
        return white.times(white)

    def _row(
        self, i: Whole, first: Place, last: Place, factor: Block, right: Block, found: Block
    ) -> None:
        """Solve for a row, given those from one to another."""
        code, over = self._space.code, self._over.load(i)
        with by_groups(code, right.packs) as (p, count):

            def terms(k: Whole) -> list[Number]:
                part = -factor.load(i, k)
                return [part * found.pack(k, p + q) for q in range(count)]

            begin = [right.pack(i, p + q) for q in range(count)]
            for q, total in enumerate(summed(code, last, first, terms, begin, right.lanes)):
                found.put(i, p + q, total * over)


def summed(
    code: Code,
    last: Place,
    first: Place,
    terms: Callable[[Whole], Sequence[Number]],
    begin: Sequence[Any],
    lanes: int,
) -> list[Number]:
    """Sums that begin as numbers, and take in terms, those of whole numbers up to a last one."""
    totals: list[Variable[Number]] = [
        code.variable((code.constant(each) if isinstance(each, float) else each).spread(lanes))
        for each in begin
    ]
    with code.loop(last, first) as k:
        for total, term in zip(totals, terms(k), strict=True):
            total.set(total.get() + term)
    return [total.get() for total in totals]


@contextmanager
def by_groups(code: Code, count: int) -> Iterator[tuple[Whole, int]]:
    """The code inside runs for the first of each group of indices below a count.

    It gets their number, too; the last group shares indices with the one before.
    """
    size = min(count, _TOGETHER)
    with code.loop(-(-count // size)) as k:
        yield (k * size).at_most(code.whole(count - size)), size
