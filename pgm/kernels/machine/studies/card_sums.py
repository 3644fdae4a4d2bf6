"""Sums over runs by step on a card, where the values lie; see `sums`.

Runs are summed in *blocks* of so many, each in the order of the processor: lane by lane, and then
lanes in pairs, so that of the same values sums have the same bits. Lanes are threads of their own,
side by side, as are the runs that they read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from math import nan
from typing import Any, NamedTuple

from pgm.kernels.machine.emitter.card import Card, printed, thread
from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.studies.card import KINDS, Capability
from pgm.kernels.machine.studies.sums import LANES, Given, in_pairs
from pgm.kernels.numbers import most, where

BY_LANE, OFF, BY_STEP, BY_RUN, BY_BLOCK = "by_lane", "off", "by_step", "by_run", "by_block"
# What lanes are told: the sum of values, how many there are, how many runs count, and the sum of
# squares about the mean.
_TOTAL, _KNOWN, _COUNT, _SPREAD = range(4)
TOLD = 4


class Summed(NamedTuple):
    """Values of so many cells, to be summed over runs and over steps, and where sums are put.

    cells: Of each the address of its values and the distance between steps, (cells, 2).
    due: Whether a value is due, (cells, steps), as a float.
    whole: Whether a cell has no value at a step at which some run has none, (cells,), as a float.
    counts: Whether a run counts, (runs,), as a float.
    lanes: Room for what lanes are told, (`TOLD`, blocks, cells, steps, `LANES`), and the distance
        from one of these to the next.
    known, mean, spread: (blocks, steps, cells); as of `sums.Moments`.
    total, number, most, last: (cells, stride): of each run the sum of its values and their number,
        the largest, −∞ without any, and the last, NaN without any.
    pairs: (blocks, cells, 6): of the pairs of `total` and `number` the number of runs, their mean,
        and the sums of squares and products of what they are off it: 11, 12, 22.
    """

    steps: int
    stride: int
    block: int
    width: int
    cells: Any
    due: Any
    whole: Any
    counts: int
    lanes: int
    apart: int
    known: int
    mean: int
    spread: int
    total: int
    number: int
    most: int
    last: int
    pairs: int

    def launches(self, runs: int) -> list[tuple[str, int, int]]:
        """The kernels that sum so many runs, in order, each with its last two arguments."""
        blocks = -(-runs // self.block)
        sums = blocks * self.width * self.steps
        return [
            (BY_LANE, runs, sums * LANES),
            (OFF, runs, sums * LANES),
            (BY_STEP, runs, sums),
            (BY_RUN, runs, self.width * self.stride),
            (BY_BLOCK, runs, blocks * self.width),
        ]


class _Summed:
    """The numbers of a `Summed` in a function that is being written."""

    def __init__(self, code: Code) -> None:
        self.code, given = code, Given(code, code.arguments[0])
        self.steps, self.stride, self.block, self.width = (given.whole() for _ in range(4))
        self.cells, self.due, self.whole, self.counts = (given.address() for _ in range(4))
        self.lanes, self.apart = given.address(), given.whole()
        self.known, self.mean, self.spread = (given.address() for _ in range(3))
        self.total, self.number, self.most, self.last = (given.address() for _ in range(4))
        self.pairs, self.every = given.address(), code.arguments[1]

    def value(self, cell: Whole, step: Whole, run: Whole) -> Number:
        """A value, NaN of a run that does not count, or where none is due."""
        code = self.code
        begin = code.addresses(self.cells).load(cell * 2)
        down = code.wholes(self.cells).load(cell * 2 + 1)
        found = code.memory(begin + (step * down + run)).load(0)
        due = code.memory(self.due).load(cell * self.steps + step)
        value: Number = where((due != 0.0) & (self.is_counted(run) != 0.0), found, nan)
        return value

    def is_counted(self, run: Whole) -> Number:
        """Whether a run counts, as a float."""
        return self.code.memory(self.counts).load(run)

    def of(self, block: Whole) -> tuple[Whole, Whole]:
        """The first run of a block, and how many it has."""
        first = block * self.block
        return first, (self.every - first).at_most(self.block)

    def told(self, what: int, place: Whole) -> Number:
        """The numbers that the lanes of a sum were told, added in pairs."""
        cells = self.code.memory(self.lanes + (self.apart * what + place * LANES))
        return in_pairs([cells.load(lane) for lane in range(LANES)])

    def tell(self, what: int, place: Whole, value: Number) -> None:
        """Tell a lane."""
        self.code.memory(self.lanes + (self.apart * what + place)).store(0, value)


class _Sum(NamedTuple):
    """A sum over the runs of a block: its place among all, and of what it is."""

    place: Whole
    block: Whole
    cell: Whole
    step: Whole

    @classmethod
    def at(cls, s: _Summed, place: Whole) -> _Sum:
        """The sum at a place."""
        block = place // (s.steps * s.width)
        return cls(place, block, place // s.steps % s.width, place % s.steps)


@lru_cache(maxsize=16)
def summing(name: str, capability: Capability) -> str:
    """One of the kernels that sum values, of which `Summed` is the table.

    `BY_LANE` and `OFF`, for the values and for their squares about the mean, have a thread for each
    lane of each step of each cell of each block, `BY_STEP` one for all of these lanes, `BY_RUN` one
    for each run of each cell, of as many as the stride, and `BY_BLOCK` one for each cell of each
    block. They take the number of runs for `first`, and begin at zero; see `Summed.launches`.
    """
    module = Module(target=Card(capability))
    kernels = {
        BY_LANE: _by_lane,
        OFF: _off,
        BY_STEP: _by_step,
        BY_RUN: _by_run,
        BY_BLOCK: _by_block,
    }
    code = module.function(name, KINDS)
    with _each(code) as own:
        kernels[name](_Summed(code), own)
    return printed(module, [name])


@contextmanager
def _each(code: Code) -> Iterator[Whole]:
    """The number of the thread at hand, if there is work for it."""
    own = thread(code)
    with code.when(own < code.arguments[2]):
        yield own


def _by_lane(s: _Summed, own: Whole) -> None:
    code, of = s.code, _Sum.at(s, own // LANES)
    total, known, count = (code.varying(0.0) for _ in range(3))
    with _each_run(s, of.block, own % LANES) as run:
        value = s.value(of.cell, of.step, run)
        there = value == value
        total.set(total.get() + where(there, value, 0.0))
        known.set(known.get() + there.number())
        count.set(count.get() + s.is_counted(run))
    for what, each in ((_TOTAL, total), (_KNOWN, known), (_COUNT, count)):
        s.tell(what, own, each.get())


def _off(s: _Summed, own: Whole) -> None:
    code, of = s.code, _Sum.at(s, own // LANES)
    mean, spread = _mean(s, of.place), code.varying(0.0)
    with _each_run(s, of.block, own % LANES) as run:
        off = s.value(of.cell, of.step, run) - mean
        spread.set(spread.get() + where(off == off, off * off, 0.0))
    s.tell(_SPREAD, own, spread.get())


@contextmanager
def _each_run(s: _Summed, block: Whole, lane: Whole) -> Iterator[Whole]:
    """The runs of a lane of a block, one after another."""
    first, runs = s.of(block)
    with s.code.loop((runs + (LANES - 1) - lane) // LANES) as k:
        yield first + k * LANES + lane


def _mean(s: _Summed, place: Whole) -> Number:
    found: Number = s.told(_TOTAL, place) / most(s.told(_KNOWN, place), 1.0)
    return found


def _by_step(s: _Summed, own: Whole) -> None:
    code, of = s.code, _Sum.at(s, own)
    known = s.told(_KNOWN, own)
    # A step at which some covariance is singular has no NEES.
    empty = (code.memory(s.whole).load(of.cell) != 0.0) & (known < s.told(_COUNT, own))
    place = (of.block * s.steps + of.step) * s.width + of.cell
    found = (s.known, known), (s.mean, _mean(s, own)), (s.spread, s.told(_SPREAD, own))
    for sums, each in found:
        code.memory(sums).store(place, where(empty, 0.0, each))


def _by_run(s: _Summed, own: Whole) -> None:
    code, cell, run = s.code, own // s.stride, own % s.stride
    total, number = code.varying(0.0), code.varying(0.0)
    largest, final = code.varying(-float("inf")), code.varying(nan)
    with code.loop(s.steps) as step:
        value = s.value(cell, step, run)
        place = (run // s.block * s.steps + step) * s.width + cell
        with code.when((code.memory(s.known).load(place) != 0.0) & (value == value)):
            total.set(total.get() + value)
            number.set(number.get() + 1.0)
            largest.set(most(largest.get(), value))
            final.set(value)
    found = (s.total, total), (s.number, number), (s.most, largest), (s.last, final)
    for sums, each in found:
        code.memory(sums).store(own, each.get())


def _by_block(s: _Summed, own: Whole) -> None:
    code, cell, block = s.code, own % s.width, own // s.width
    first, runs = s.of(block)

    def pair(run: Whole) -> Sequence[Number]:
        at = cell * s.stride + run
        both = (code.memory(each).load(at) for each in (s.total, s.number))
        return [s.is_counted(run), *both]

    count, *sums = _added(code, first, runs, pair, 3)
    centre = [each / count for each in sums]

    def off(run: Whole) -> Sequence[Number]:
        counts, *both = pair(run)
        a, b = (counts * (x - c) for x, c in zip(both, centre, strict=True))
        return a * a, a * b, b * b

    found = [count, *centre, *_added(code, first, runs, off, 3)]
    for k, each in enumerate(found):
        code.memory(s.pairs).store(own * len(found) + k, each)


def _added(
    code: Code, first: Whole, runs: Whole, write: Callable[[Whole], Sequence[Number]], count: int
) -> list[Number]:
    """Sums of so many values that are written for each run, one after another."""
    sums = [code.varying(0.0) for _ in range(count)]
    with code.loop(runs) as k:
        for each, value in zip(sums, write(first + k), strict=True):
            each.set(each.get() + value)
    return [each.get() for each in sums]
