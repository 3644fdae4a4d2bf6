"""Children of CPDs drawn row by row: a function or a sum of their parents, and noise L w.

A *row* is a step of a transition, or a reading of a sensor. Each of a CPD's arrays has the numbers
of a row at a place that is told by an array of places, and there those of all runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from pgm.kernels.arrays import Array, Integers, address
from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.emitter.kinds import ADDRESS
from pgm.kernels.machine.emitter.memory import Memory, Runs
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.traces import traced
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.studies.sums import LANES, Cells, Given, each_pack, table


class Placed(NamedTuple):
    """An array (places, runs or 1, d), and the place of each row in it."""

    array: Array
    places: Integers

    @property
    def runs(self) -> Runs:
        """How runs lie in memory."""
        if self.array.shape[1] == 1:
            return Runs.SAME
        return Runs.BESIDE if self.array.strides[1] == self.array.itemsize else Runs.APART

    @property
    def width(self) -> int:
        """The number of components d."""
        found: int = self.array.shape[-1]
        return found

    @property
    def cells(self) -> Cells:
        """The array in memory."""
        return Cells.of(self.array.swapaxes(0, 1))


class Resident(NamedTuple):
    """An array on a card, where it lies there, and the place of each row in it."""

    cells: Cells
    width: int
    runs: Runs
    places: Integers


class Child(NamedTuple):
    """A CPD's child y = f(parents) + L w, or y = Σ F x + b + L w, where there is no function.

    function: Whose arguments are observed, as `given` has them.
    matrices, offset: Of the sum, F of each parent (d, n) and b (d,); of a function they are empty.
    lower, white: L (d, d), and w (rows, runs, d); None where it is drawn at each row.
    out: Where y is put.
    """

    function: Function | None
    given: Sequence[Placed | Resident]
    matrices: Sequence[Array]
    offset: Array
    lower: Array
    white: Array | None
    out: Placed | Resident

    @property
    def form(self) -> Form:
        """All that decides the code."""
        return Form(
            self.function,
            tuple((each.width, each.runs) for each in self.given),
            len(self.lower),
            None if self.white is None else self._placed_white[0].runs,
            self.out.runs,
        )

    @property
    def _placed_white(self) -> list[Placed]:
        return [] if self.white is None else [Placed(self.white, np.arange(len(self.white)))]

    @property
    def numbers(self) -> list[Array | Integers | Cells]:
        """The numbers of a call, in the order of `RowWriter`."""
        found: list[Array | Integers | Cells] = []
        for each in (*self.given, *self._placed_white, self.out):
            found += [each.cells, np.ascontiguousarray(each.places, dtype=np.int64)]
        return [*found, constants(self.matrices, self.offset, self.lower)]


class Form(NamedTuple):
    """The form of a `Child`: its parents' components, and how runs lie in its arrays.

    `white` is None where noise is drawn at each row.
    """

    function: Function | None
    given: tuple[tuple[int, Runs], ...]
    height: int
    white: Runs | None
    out: Runs

    @property
    def operations(self) -> int:
        """How many operations the code has, about."""
        widths = sum(width for width, _ in self.given)
        own = self.height * widths if self.function is None else len(self.function.operations)
        return own + self.height**2


def constants(matrices: Sequence[Array], offset: Array, lower: Array) -> Array:
    """The numbers of a child that are the same for all rows and runs, as `ChildWriter` reads them.

    They are the matrices and the offset of a sum, none of a function, and L.
    """
    return np.concatenate([*(each.ravel() for each in matrices), offset, lower.ravel()])


def draw(children: Sequence[Child], runs: int) -> None:
    """Draw children at all rows, of each row one child after another.

    There are as many runs as a pack has at least.
    """
    numbers = [each.numbers for each in children]
    flat = [number for each in numbers for number in each]
    given = table(len(children[0].out.places), runs, *flat)
    _drawn(tuple(each.form for each in children))(address(given))


@lru_cache(maxsize=64)
def _drawn(forms: tuple[Form, ...]) -> Callable[[int], None]:
    code = Module().function("drawn", (ADDRESS,), lanes=LANES)
    given = Given(code, code.arguments[0])
    count, runs = given.whole(), given.whole()
    rows = [RowWriter(form, given) for form in forms]
    with code.loop(count) as k:
        for row in rows:
            at = row.at(k)
            with each_pack(code, runs) as run:
                *parents, white, out = (cells(run) for cells in at)
                row.write(parents, white, out)
    return code.module.compile().callable("drawn")


class ChildWriter:
    """The code of a child's value at the runs at hand; its constants are read once, before.

    Their address is the next of the numbers given; see `constants`.
    """

    def __init__(self, form: Form, given: Given) -> None:
        self._form, self._code = form, given.code
        numbers = Memory(given.code, given.address(), lanes=1)
        d, place = form.height, 0

        def matrix(width: int) -> list[list[Number]]:
            nonlocal place
            first, place = place, place + d * width
            found = [numbers.load(first + k) for k in range(d * width)]
            return [found[i * width : (i + 1) * width] for i in range(d)]

        summed = form.function is None
        self._matrices = [matrix(width) for width, _ in form.given] if summed else []
        self._offset = [row[0] for row in matrix(1)] if summed else []
        self._lower = matrix(d)

    def mean(self, parents: Sequence[Memory]) -> list[Any]:
        """The child's components without noise, of which a trace's constants are floats."""
        form = self._form
        if form.function is not None:
            at = {(a, i): (parents[a], i) for a, i in form.function.observed}
            return traced(self._code, form.function, (), at)[0]
        mean = list(self._offset)
        for parent, matrix, (width, _) in zip(parents, self._matrices, form.given, strict=True):
            values = [parent.load(j) for j in range(width)]
            for i, row in enumerate(matrix):
                for entry, value in zip(row, values, strict=True):
                    mean[i] = mean[i] + entry * value
        return mean

    def write(self, parents: Sequence[Memory], white: Memory, out: Memory) -> list[Number]:
        """Write the child of the runs at hand; returns its components."""
        mean, found = self.mean(parents), []
        noise = [white.load(j) for j in range(self._form.height)]
        for i in range(self._form.height):
            total = self._lower[i][0] * noise[0]
            for j in range(1, i + 1):
                total = total + self._lower[i][j] * noise[j]
            found.append(total + mean[i])
            out.store(i, found[-1])
        return found


class RowWriter(ChildWriter):
    """A child that is being written at one row after another."""

    def __init__(self, form: Form, given: Given) -> None:
        white = [] if form.white is None else [form.white]
        runs = [*(runs for _, runs in form.given), *white, form.out]
        self._arrays = [
            (given.array(runs=each), given.code.wholes(given.address())) for each in runs
        ]
        super().__init__(form, given)

    def at(self, k: Whole) -> list[Callable[[Whole], Memory]]:
        """The arrays at a row: parents, w unless it is drawn there, and where the child is put."""

        def cells(array: Callable[[Whole, Whole], Memory], row: Whole) -> Callable[..., Memory]:
            return lambda run: array(row, run)

        return [cells(array, places.load(k)) for array, places in self._arrays]
