"""Studies on a card: runs drawn, beliefs about them judged, and all of it summed where it lies.

Arrays of runs have a *stride*, from one number of a run to its next: the runs that there is room
for, which lie beside each other. Each kernel is ``kernel(table, first, last)``, a thread for each
number from `first` to below `last`: a run, or what is said of each. Runs are summed in *blocks* of
so many, in the order of `sums`, so that of the same values sums have the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from math import nan
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.kernels import philox
from pgm.kernels.machine.emitter.arena import Arena
from pgm.kernels.machine.emitter.card import Card, printed, thread
from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.driver import Device
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.memory import Memory, Runs
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.matrices.lines import Lines
from pgm.kernels.machine.studies.beliefs import figures
from pgm.kernels.machine.studies.draws import fill, uniform
from pgm.kernels.machine.studies.normals import quantile
from pgm.kernels.machine.studies.rows import Child, Form, RowWriter
from pgm.kernels.machine.studies.sums import LANES, Cells, Given, in_pairs
from pgm.kernels.numbers import Matrix, most, where

KINDS = (ADDRESS, WHOLE, WHOLE)
DRAW, JUDGE, PICK = "draw", "judge", "pick"
BY_STEP, BY_RUN, BY_BLOCK = "by_step", "by_run", "by_block"
Capability = tuple[int, int]


def loaded(make: Callable[..., str], name: str, device: Device, *form: Any) -> Any:
    """A kernel of this name on a card, of the text that is made for its form."""
    return _loaded(make, name, device, form)


@lru_cache(maxsize=64)
def _loaded(make: Callable[..., str], name: str, device: Device, form: tuple[Any, ...]) -> Any:
    with device.current():
        return device.kernel(make(*form, device.capability), name)


def table(arena: Arena, *given: Any) -> int:
    """The address of a kernel's table there; arrays that are given are copied."""
    numbers: list[int] = []
    for each in given:
        if isinstance(each, Cells):
            numbers += each
        else:
            numbers.append(arena.put(each) if isinstance(each, np.ndarray) else int(each))
    return arena.put(np.array(numbers, dtype=np.int64))


@contextmanager
def _each_thread(code: Code) -> Iterator[Whole]:
    """The number of the thread at hand, from zero on, if there is work for it."""
    _, first, last = code.arguments
    own = thread(code)
    with code.when(first + own < last):
        yield own


# Draws


class Drawing(NamedTuple):
    """The forms of CPDs that are drawn: of the prior, the transition, and the sensors."""

    prior: tuple[Form, ...]
    transition: tuple[Form, ...]
    sensors: tuple[Form, ...]

    @property
    def all(self) -> tuple[Form, ...]:
        """The forms, in order."""
        return (*self.prior, *self.transition, *self.sensors)


class Drawn(NamedTuple):
    """A child whose noise is drawn at each of its rows, by counters as of `counted`.

    variable: The child's place among the network's variables.
    order: The row that counters have, of each row.
    """

    child: Child
    variable: int
    order: npt.NDArray[np.int64]

    @property
    def numbers(self) -> list[Any]:
        """The numbers of a table, in the order of `drawing`."""
        return [self.variable, len(self.order), self.order, *self.child.numbers]


@lru_cache(maxsize=32)
def drawing(forms: Drawing, capability: Capability) -> str:
    """The kernel that draws runs: at all steps, from one to the next, and then readings of them.

    Its table has the key, where a sum of all of a run's values is put, and the numbers of each
    `Drawn`. `first` is the number of the first run.
    """
    code = Module(target=Card(capability)).function(DRAW, KINDS)
    given, first = Given(code, code.arguments[0]), code.arguments[1]
    key, sums = (given.whole(), given.whole()), given.address()
    drawn = [_Drawn(form, given) for form in forms.all]
    ahead, after = len(forms.prior), len(forms.prior) + len(forms.transition)
    white = code.room(max(form.height for form in forms.all), "noise")
    noise = _noise(code.module)
    with _each_thread(code) as run:
        total = code.varying(0.0)

        def draw(each: _Drawn, k: Whole) -> None:
            row = code.wholes(each.order).load(k)
            code.call(noise, white.address, each.form.height, *key, first + run, row, each.variable)
            *parents, out = (cells(run) for cells in each.writer.at(k))
            for value in each.writer.write(parents, white, out):
                total.set(total.get() + value)

        for each in drawn[:ahead]:
            draw(each, code.whole(0))
        if drawn[ahead:after]:
            with code.loop(drawn[ahead].count) as k:
                for each in drawn[ahead:after]:
                    draw(each, k)
        for each in drawn[after:]:
            with code.loop(each.count) as k:
                draw(each, k)
        code.memory(sums).store(run, total.get())
    return printed(code.module, [DRAW])


def _noise(module: Module) -> Code:
    """The function that puts so many standard normal numbers of a row of a run into memory.

    It is called rather than copied to where it is due, as it is long.
    """
    kinds = (ADDRESS, *[WHOLE] * 6)
    code = module.function("noise", kinds, internal=True, inline=False)
    out, count, *key, run, row, variable = code.arguments
    words, blocks = code.room(philox.BLOCK, "words"), (count + philox.BLOCK - 1) // philox.BLOCK
    with code.loop(count) as i:
        block, place = i // philox.BLOCK, i % philox.BLOCK
        with code.when(place == 0):
            counter = run * blocks + block, row, variable, code.whole(0)
            fill(code, words.address, 1, (key[0], key[1]), counter)
        code.memory(out).store(i, quantile(code, uniform(code, words.address + place)))
    return code


class _Drawn:
    """A `Drawn` that is being written."""

    def __init__(self, form: Form, given: Given) -> None:
        self.form, self.variable, self.count = form, given.whole(), given.whole()
        self.order, self.writer = given.address(), RowWriter(form, given)


# Figures


class Judging(NamedTuple):
    """A state that is judged: its places in a slice of so many components, and which are angles."""

    places: tuple[int, ...]
    size: int
    angles: tuple[bool, ...]

    @property
    def cells(self) -> int:
        """How many figures there are: errors, their squares, the NEES, and if a region holds it."""
        return 2 * len(self.places) + 2


@lru_cache(maxsize=32)
def judging(form: Judging, capability: Capability) -> str:
    """The kernel that judges a state's beliefs at all steps, a thread a run.

    Its table has the number of steps, the stride, means and covariances of slices, truths, and
    where figures are put, (steps, cells, stride), all as `Cells` but for the last, and the limit of
    the regions of confidence. The NEES of a covariance that is singular is NaN.
    """
    code = Module(target=Card(capability)).function(JUDGE, KINDS)
    given, lines = Given(code, code.arguments[0]), Lines(code)
    steps, stride = given.whole(), given.whole()
    means, covs, truths = (given.array(Runs.BESIDE) for _ in range(3))
    out, limit = given.address(), Memory(code, given.address()).load(0)
    size, places = len(form.places), form.places
    with _each_thread(code) as run, code.loop(steps) as step:
        mean, cov = means(step, run), covs(step, run)
        found = figures(
            lines,
            Matrix.column(mean.load(k) for k in places),
            lines.symmetric_of(cov, places, form.size),
            lines.column(truths(step, run), size),
            form.angles,
        )
        nees = where(found.proper, found.nees, nan)
        held = where(found.proper, (found.nees <= limit).number(), nan)
        squares = [error * error for error in found.errors]
        cells = Memory(code, out + (stride * form.cells * step + run), step=stride)
        for k, figure in enumerate([*found.errors, *squares, nees, held]):
            cells.store(k, figure)
    return printed(code.module, [JUDGE])


# Sums


class Summed(NamedTuple):
    """Values of so many cells, to be summed over runs and over steps, and where sums are put.

    cells: Of each the address of its values and the distance between steps, (cells, 2).
    due: Whether a value is due, (cells, steps), as a float.
    whole: Whether a cell has no value at a step at which some run has none, (cells,), as a float.
    counts: Whether a run counts, (runs,), as a float.
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
    known: int
    mean: int
    spread: int
    total: int
    number: int
    most: int
    last: int
    pairs: int


class _Summed:
    """The numbers of a `Summed` in a function that is being written."""

    def __init__(self, code: Code) -> None:
        self.code, given = code, Given(code, code.arguments[0])
        self.steps, self.stride, self.block, self.width = (given.whole() for _ in range(4))
        self.cells, self.due, self.whole, self.counts = (given.address() for _ in range(4))
        self.known, self.mean, self.spread = (given.address() for _ in range(3))
        self.total, self.number, self.most, self.last = (given.address() for _ in range(4))
        self.pairs = given.address()

    def value(self, cell: Whole, step: Whole, run: Whole) -> Number:
        """A value, NaN of a run that does not count, or where none is due."""
        code = self.code
        begin = code.addresses(self.cells).load(cell * 2)
        down = code.wholes(self.cells).load(cell * 2 + 1)
        found = code.memory(begin + (step * down + run)).load(0)
        due = code.memory(self.due).load(cell * self.steps + step)
        counts = code.memory(self.counts).load(run)
        value: Number = where((due != 0.0) & (counts != 0.0), found, nan)
        return value

    def at(self, block: Whole, step: Whole, cell: Whole) -> Whole:
        """The place of a step's sums."""
        return (block * self.steps + step) * self.width + cell


@lru_cache(maxsize=16)
def summing(name: str, capability: Capability) -> str:
    """One of the kernels that sum values, of which `Summed` is the table.

    `BY_STEP` has a thread for each step of each cell of each block, `BY_RUN` one for each run of
    each cell, of as many as the stride, and `BY_BLOCK` one for each cell of each block. They are
    launched in this order; the first and the last take the number of runs for `first`, and begin at
    zero.
    """
    module = Module(target=Card(capability))
    {BY_STEP: _by_step, BY_RUN: _by_run, BY_BLOCK: _by_block}[name](module)
    return printed(module, [name])


@contextmanager
def _each_sum(code: Code) -> Iterator[tuple[Whole, Whole]]:
    """The number of the thread at hand, and the number of runs."""
    _, runs, last = code.arguments
    own = thread(code)
    with code.when(own < last):
        yield own, runs


def _lanes(
    code: Code, runs: Whole, write: Callable[[Whole], Sequence[Number]], count: int
) -> list[Number]:
    """Sums of so many values that are written for each run, in the order that packs have."""
    sums = [[code.varying(0.0) for _ in range(LANES)] for _ in range(count)]
    with code.loop((runs + (LANES - 1)) // LANES) as k:
        for lane in range(LANES):
            run = k * LANES + lane
            with code.when(run < runs):
                for each, value in zip(sums, write(run), strict=True):
                    each[lane].set(each[lane].get() + value)
    return [in_pairs([each.get() for each in lanes]) for lanes in sums]


def _by_step(module: Module) -> None:
    code = module.function(BY_STEP, KINDS)
    s = _Summed(code)
    with _each_sum(code) as (own, every):
        step, cell = own % s.steps, own // s.steps % s.width
        block = own // (s.steps * s.width)
        first = block * s.block
        runs = (every - first).at_most(s.block)

        def known(run: Whole) -> Sequence[Number]:
            value = s.value(cell, step, first + run)
            there = value == value
            counts = code.memory(s.counts).load(first + run)
            return where(there, value, 0.0), there.number(), counts

        total, of, due = _lanes(code, runs, known, 3)
        mean = total / most(of, 1.0)

        def off(run: Whole) -> Sequence[Number]:
            left = s.value(cell, step, first + run) - mean
            return (where(left == left, left * left, 0.0),)

        (spread,) = _lanes(code, runs, off, 1)
        # A step at which some covariance is singular has no NEES.
        empty = (code.memory(s.whole).load(cell) != 0.0) & (of < due)
        place = s.at(block, step, cell)
        for sums, each in ((s.known, of), (s.mean, mean), (s.spread, spread)):
            code.memory(sums).store(place, where(empty, 0.0, each))


def _by_run(module: Module) -> None:
    code = module.function(BY_RUN, KINDS)
    s = _Summed(code)
    with _each_thread(code) as own:
        cell, run = own // s.stride, own % s.stride
        total, number = code.varying(0.0), code.varying(0.0)
        largest, final = code.varying(-float("inf")), code.varying(nan)
        with code.loop(s.steps) as step:
            value = s.value(cell, step, run)
            kept = code.memory(s.known).load(s.at(run // s.block, step, cell)) != 0.0
            with code.when(kept & (value == value)):
                total.set(total.get() + value)
                number.set(number.get() + 1.0)
                largest.set(most(largest.get(), value))
                final.set(value)
        found = (s.total, total), (s.number, number), (s.most, largest), (s.last, final)
        for place, each in found:
            code.memory(place).store(own, each.get())


def _by_block(module: Module) -> None:
    code = module.function(BY_BLOCK, KINDS)
    s = _Summed(code)
    with _each_sum(code) as (own, every):
        cell, block = own % s.width, own // s.width
        first = block * s.block
        runs = (every - first).at_most(s.block)

        def pair(run: Whole) -> Sequence[Number]:
            counts = code.memory(s.counts).load(first + run)
            at = cell * s.stride + first + run
            return [counts, *(code.memory(each).load(at) for each in (s.total, s.number))]

        count, *sums = _lanes(code, runs, pair, 3)
        centre = [each / count for each in sums]

        def off(run: Whole) -> Sequence[Number]:
            counts, *both = pair(run)
            a, b = (counts * (x - c) for x, c in zip(both, centre, strict=True))
            return a * a, a * b, b * b

        found = [count, *centre, *_lanes(code, runs, off, 3)]
        for k, each in enumerate(found):
            code.memory(s.pairs).store(own * len(found) + k, each)


# A few runs


@lru_cache(maxsize=4)
def picking(capability: Capability) -> str:
    """The kernel that copies a few runs of an array, a thread for each number of a run.

    Its table has the array, its stride, how many runs are copied, the distance between them, and
    where they are put, beside each other.
    """
    code = Module(target=Card(capability)).function(PICK, KINDS)
    given = Given(code, code.arguments[0])
    array, stride, count, apart, out = (
        given.address(),
        given.whole(),
        given.whole(),
        given.whole(),
        given.address(),
    )
    with _each_thread(code) as own, code.loop(count) as k:
        value = code.memory(array).load(own * stride + k * apart)
        code.memory(out).store(own * count + k, value)
    return printed(code.module, [PICK])
