"""Writers of sweeps: arrays by rows and runs, and the matrices in them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import reduce
from math import prod
from operator import add
from typing import Any

from pgm.kernels import step
from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.emitter.memory import Cells, Memory, Runs
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.waiting import Waiting
from pgm.kernels.machine.emitter.wholes import Address, Whole
from pgm.kernels.machine.matrices.protocol import Matrices
from pgm.kernels.machine.sweeps import told
from pgm.kernels.step import AnyMatrix


class Writer:
    """A sweep that is being written: its function, the table of a chain, and the runs at hand.

    All of the table is read when a call begins, as what is written to memory later may, for all
    that is known, be the table.
    """

    def __init__(
        self,
        code: Code,
        table: Address,
        chain: Any,
        matrices: Matrices,
        waiting: Waiting | None = None,
    ) -> None:
        self.code, self.matrices, self._waiting = code, matrices, waiting
        self._asked = chain.asked if isinstance(chain, told.Forward) else None
        wholes, addresses = Cells(code, table, Whole), Cells(code, table, Address)
        self.last, self._count = wholes.load(told.LAST), wholes.load(told.RUNS)
        self.iterations = wholes.load(told.ITERATIONS)
        self._settings = addresses.load(told.SETTINGS)
        self._residuals, self._ended = addresses.load(told.RESIDUALS), addresses.load(told.ENDED)
        self._places: dict[told.Array, tuple[Any, ...]] = {
            array: (addresses.load(array.place), *map(wholes.load, _after(array.place)))
            for array in arrays(chain)
        }
        self.lag = wholes.load(told.LAG)
        self.numbers = {place: wholes.load(place) for place in getattr(chain, "numbers", ())}
        sensors = getattr(chain, "sensors", ())
        due = [sensor.bounds for sensor in sensors if sensor.bounds is not None]
        self._bounds = {place: addresses.load(place) for place in due}
        self.run = code.whole(0)

    def at(self, array: told.Array, row: Whole | None = None) -> Memory:
        """The cells of an array at a row, of the runs at hand."""
        address, down, across, cell = self._places[array]
        if row is not None:
            address = address + row * down
        return Memory(
            self.code,
            address + self.run * across,
            length=prod(array.shape),
            step=1 if array.near else cell,
            runs=array.runs,
            apart=across,
        )

    @property
    def settings(self) -> Memory:
        """The tolerance and the damping of iterations."""
        return Memory(self.code, self._settings, runs=Runs.SAME)

    @property
    def residuals(self) -> Memory:
        """The record of iterations: a number of each, of the runs at hand."""
        return Memory(self.code, self._residuals + self.run, step=self._count)

    def ended(self, what: int) -> Memory:
        """Where something is told of the runs at hand."""
        return Memory(self.code, self._ended + (self.run + self._count * what))

    def ask(self, what: int, count: int, first: Whole, after: Whole, place: Whole) -> None:
        """Wait until the program has called a function at some rows, at so many points.

        They are of one step; see `told.WHAT`.
        """
        assert self._waiting is not None
        assert self._asked is not None
        cells = self.at(self._asked)
        cells.store(told.WHAT, float(what))
        cells.store(told.COUNT, float(count))
        for cell, whole in ((told.ROW, first), (told.AFTER, after), (told.PLACE, place)):
            cells.store(cell, whole.number())
        self._waiting.wait()

    def reach(self, step: Number | float, sure: Number) -> None:
        """Tell the program how far the runs at hand are, and whether all was right so far.

        It is told where it is asked for anything.
        """
        if self._asked is not None:
            cells = self.at(self._asked)
            cells.store(told.STEP, step)
            cells.store(told.SURE, sure.number())

    @contextmanager
    def each_sighting(self, sensor: told.Sensor, at: Whole) -> Iterator[Whole]:
        """The rows of a step's sightings, one after another, each with a scratch of its own."""
        if sensor.bounds is None:
            with self.matrices.scratch():
                yield at
        else:
            first, last = self.sightings(sensor, at)
            with self.code.loop(last, first) as row, self.matrices.scratch():
                yield row

    def sightings(self, sensor: told.Sensor, at: Whole) -> tuple[Whole, Whole]:
        """The first sighting of a step, and the one after its last."""
        assert sensor.bounds is not None
        bounds = Cells(self.code, self._bounds[sensor.bounds], Whole)
        return bounds.load(at), bounds.load(at + 1)

    def column(self, array: told.Array, row: Whole | None = None) -> AnyMatrix:
        """The vector of an array at a row."""
        return self.matrices.column(self.at(array, row), array.shape[0])

    def matrix(self, array: told.Array, row: Whole | None = None) -> AnyMatrix:
        """The matrix of an array at a row."""
        return self.matrices.matrix(self.at(array, row), *array.shape)

    def symmetric(self, array: told.Array, row: Whole | None = None) -> AnyMatrix:
        """The symmetric matrix of an array at a row, of which the lower half is read."""
        return self.matrices.symmetric(self.at(array, row), array.shape[0])

    def keep(self, array: told.Array | None, matrix: AnyMatrix, row: Whole | None = None) -> None:
        """Put a vector or a matrix into an array at a row, if there is one."""
        if array is not None and 0 not in matrix.shape:
            self.matrices.keep(self.at(array, row), matrix)

    def together(self, operation: Callable[[Any, Any], Any], numbers: Sequence[Any]) -> Any:
        """One number of several that are side by side, for each of the runs at hand."""
        found = reduce(operation, numbers)
        if isinstance(found, Number) and found.lanes > self.code.lanes:
            found = reduce(operation, map(found.lane, range(found.lanes)))
        return found

    def sum(self, numbers: Sequence[Any]) -> Any:
        """The sum of numbers that are side by side, of zero where there is nothing to add."""
        return self.together(add, numbers) if numbers else self.code.constant(0.0)

    def open_share(self, cov: AnyMatrix) -> Number:
        """The least share of a variance that is left open; see `step.open_share`."""
        found: Number = step.open_share(cov, self.varies(cov))
        return found

    def varies(self, cov: AnyMatrix) -> Any:
        """Truths about a belief's components: whether they have a variance."""
        numbers = [variance != 0.0 for variance in self.matrices.diagonal(cov)]
        return self.matrices.truths(numbers, cov.shape[0])

    @property
    def true(self) -> Number:
        """A truth that holds."""
        return self.code.constant(True)


def arrays(value: Any) -> Iterator[told.Array]:
    """The arrays that a chain is told of, each once."""
    found: dict[told.Array, None] = {}
    stack = [value]
    while stack:
        each = stack.pop()
        if isinstance(each, told.Array):
            found[each] = None
        elif isinstance(each, tuple):
            stack += each
        elif is_dataclass(each) and not isinstance(each, Function | told.Points):
            stack += [getattr(each, field.name) for field in fields(each)]
    return iter(found)


def _after(place: int) -> range:
    return range(place + told.DOWN, place + told.CELL + 1)
