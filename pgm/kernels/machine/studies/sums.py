"""Sums over runs of values by step: what a mean and its standard error need, in one reading.

Values stand in a *row* first, one of each run, with NaN where there is none and behind the last
run. A row is read twice, so that a spread is a sum of squares about the mean, which loses no
digits; both times it is in the processor's cache.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from operator import add
from typing import Any, NamedTuple

import numpy as np

from pgm.kernels.arrays import Array, address
from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import ADDRESS
from pgm.kernels.machine.emitter.memory import Memory, Runs
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.numbers import most, where

# Runs that are worked on together, as the lanes of packs.
LANES = 8


class Moments(NamedTuple):
    """Sums of values (runs, steps, cells), of those that are not NaN.

    By step and cell (steps, cells): how many there are, their mean, and the sum of squares about
    it. Of each run (cells, runs): the sum over steps, and of how many.
    """

    known: Array
    mean: Array
    spread: Array
    total: Array
    number: Array

    @classmethod
    def empty(cls, steps: int, cells: int, runs: int) -> Moments:
        """Room for sums, and for the runs behind the last that fill a pack."""
        known, mean, spread = np.empty((3, steps, cells))
        total, number = np.zeros((2, cells, padded(runs)))
        return cls(known, mean, spread, total, number)

    def of(self, cells: slice, runs: int) -> Moments:
        """The sums of some cells, of the runs that there are."""
        known, mean, spread = (each[:, cells] for each in self[:3])
        total, number = (each[cells, :runs] for each in self[3:])
        return Moments(known, mean, spread, total, number)


def padded(runs: int) -> int:
    """Runs, and as many behind the last as fill a pack."""
    return -(-runs // LANES) * LANES


class Row(NamedTuple):
    """A row of each cell, and the sums of values that are put into them."""

    code: Code
    width: Whole
    rows: Memory
    moments: Sequence[Address]

    def at(self, cell: int, run: Whole) -> Memory:
        """The value of a cell, of the runs at hand."""
        code = self.code
        return Memory(code, self.rows.address + (self.width * cell + run))

    def add(self, step: Whole, cells: int) -> None:
        """Add the rows of a step to the sums."""
        for cell in range(cells):
            self._add(step * cells + cell, cell)

    def _add(self, place: Whole, cell: int) -> None:
        code, packs = self.code, self.width // LANES
        known, means, spreads, totals, numbers = self.moments
        total, count = code.varying(0.0), code.varying(0.0)
        with code.loop(packs) as k:
            run = k * LANES
            value = self.at(cell, run).load(0)
            is_known = value == value
            value, one = where(is_known, value, 0.0), is_known.number()
            total.set(total.get() + value)
            count.set(count.get() + one)
            for sums, each in ((totals, value), (numbers, one)):
                kept = Memory(code, sums + (self.width * cell + run))
                kept.store(0, kept.load(0) + each)
        of = together(count.get())
        mean = together(total.get()) / most(of, 1.0)
        spread = code.varying(0.0)
        with code.loop(packs) as k:
            off = self.at(cell, k * LANES).load(0) - mean
            spread.set(spread.get() + where(off == off, off * off, 0.0))
        for sums, each in ((known, of), (means, mean), (spreads, together(spread.get()))):
            Memory(code, sums, lanes=1).store(place, each)


def together(pack: Number) -> Number:
    """The sum of the lanes of a pack."""
    return in_pairs([pack.lane(k) for k in range(pack.lanes)])


def in_pairs(lanes: list[Number]) -> Number:
    """The sum of numbers of which there are a power of two, in the order that lanes have."""
    while len(lanes) > 1:
        lanes = list(map(add, lanes[::2], lanes[1::2]))
    return lanes[0]


@contextmanager
def each_pack(code: Code, runs: Whole) -> Iterator[Whole]:
    """The first runs of packs, of which the last may share runs with the one before."""
    with code.loop((runs + (LANES - 1)) // LANES) as k:
        last = runs - LANES
        yield (k * LANES).at_most(last)


class Cells(NamedTuple):
    """An array (runs, steps, own axes) in memory: its address, and distances in floats.

    They are from run to run, from step to step, and from number to number.
    """

    address: int
    across: int
    down: int
    cell: int

    @classmethod
    def of(cls, array: Array) -> Cells:
        """The array, whose own numbers are at even distances."""
        across, down, *own = (each // 8 for each in array.strides)
        return cls(address(array), across, down, own[-1] if own else 1)


class Given:
    """The numbers that a call is given in memory, one after another: whole ones and addresses."""

    def __init__(self, code: Code, table: Address) -> None:
        self.code, self._wholes = code, code.wholes(table)
        self._addresses, self._next = code.addresses(table), 0

    def whole(self) -> Whole:
        """The next number."""
        self._next += 1
        return self._wholes.load(self._next - 1)

    def address(self) -> Address:
        """The next address."""
        self._next += 1
        return self._addresses.load(self._next - 1)

    def array(self, runs: Runs) -> Callable[[Whole, Whole], Memory]:
        """The next array, as `Cells` tell of it: its numbers by step, of the runs from one on."""
        begin, across, down, cell = self.address(), self.whole(), self.whole(), self.whole()

        def at(step: Whole, run: Whole) -> Memory:
            place = begin + step * down
            place = place if runs is Runs.SAME else place + run * across
            return Memory(self.code, place, step=cell, runs=runs, apart=across)

        return at


def table(*given: Any) -> Array:
    """The numbers of a call: whole ones, arrays whose addresses are meant, and `Cells`."""
    numbers: list[int] = []
    for each in given:
        if isinstance(each, Cells):
            numbers += each
        else:
            numbers.append(address(each) if isinstance(each, np.ndarray) else int(each))
    return np.array(numbers, dtype=np.int64)


def of_values(values: Array) -> Moments:
    """The sums of values (runs, steps), of as many runs as a pack has at least."""
    runs, steps = values.shape
    found, rows = Moments.empty(steps, 1, runs), np.full((1, padded(runs)), np.nan)
    cells = Cells.of(values)
    given = table(steps, runs, padded(runs), cells, rows, *found)
    _of_values(cells.across == 1)(address(given))
    return found.of(slice(None), runs)


@lru_cache(maxsize=2)
def _of_values(beside: bool) -> Callable[[int], None]:
    code = Module().function("sums", (ADDRESS,), lanes=LANES)
    given = Given(code, code.arguments[0])
    steps, runs, width = given.whole(), given.whole(), given.whole()
    values = given.array(Runs.BESIDE if beside else Runs.APART)
    rows = Memory(code, given.address())
    row = Row(code, width, rows, [given.address() for _ in Moments._fields])
    with code.loop(steps) as step:
        with each_pack(code, runs) as run:
            row.at(0, run).store(0, values(step, run).load(0))
        row.add(step, 1)
    return code.module.compile().callable("sums")
