"""What sweeps are written with: arrays by rows and runs, and beliefs that are carried along."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

from pgm.kernels.machine import told
from pgm.kernels.machine.code import Code, Variable
from pgm.kernels.machine.memory import Cells, Memory, Runs
from pgm.kernels.machine.numbers import Number, constant
from pgm.kernels.machine.wholes import Address, Whole
from pgm.kernels.numbers import Matrix, where


class Writer:
    """A sweep that is being written: its function, the table of a chain, and the runs at hand.

    All of the table is read when a call begins, as what is written to memory later may, for all
    that is known, be the table.
    """

    def __init__(self, code: Code, table: Address, chain: Any) -> None:
        self.code = code
        wholes, addresses = Cells(code, table, Whole), Cells(code, table, Address)
        self.last, self._count = wholes.load(told.LAST), wholes.load(told.RUNS)
        self.iterations = wholes.load(told.ITERATIONS)
        self._settings = addresses.load(told.SETTINGS)
        self._residuals, self._ended = addresses.load(told.RESIDUALS), addresses.load(told.ENDED)
        self._places = {
            array: (addresses.load(array.place), *map(wholes.load, _after(array.place)))
            for array in arrays(chain)
        }
        self.lag = wholes.load(told.LAG)
        sensors = () if isinstance(chain, told.Backward) else chain.sensors
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

    def sightings(self, sensor: told.Sensor, at: Whole) -> tuple[Whole, Whole]:
        """The first sighting of a step, and the one after its last."""
        assert sensor.bounds is not None
        bounds = Cells(self.code, self._bounds[sensor.bounds], Whole)
        return bounds.load(at), bounds.load(at + 1)

    def column(self, array: told.Array, row: Whole | None = None) -> Matrix:
        """The vector of an array at a row."""
        cells = self.at(array, row)
        return Matrix.column(cells.load(k) for k in range(array.shape[0]))

    def matrix(self, array: told.Array, row: Whole | None = None) -> Matrix:
        """The matrix of an array at a row."""
        cells, (height, width) = self.at(array, row), array.shape
        return Matrix([cells.load(i * width + j) for j in range(width)] for i in range(height))

    def symmetric(self, array: told.Array, row: Whole | None = None) -> Matrix:
        """The symmetric matrix of an array at a row, of which the lower half is read."""
        cells, size = self.at(array, row), array.shape[0]
        half = [[cells.load(i * size + j) for j in range(i + 1)] for i in range(size)]
        return Matrix([half[max(i, j)][min(i, j)] for j in range(size)] for i in range(size))

    def keep(self, array: told.Array | None, matrix: Matrix, row: Whole | None = None) -> None:
        """Put a vector or a matrix into an array at a row, if there is one."""
        if array is not None:
            cells = self.at(array, row)
            for k, number in enumerate(number for each in matrix.rows for number in each):
                cells.store(k, number)

    def sum(self, numbers: Sequence[Any]) -> Any:
        """A sum, of zero where there is nothing to add."""
        total: Any = self.code.constant(0.0)
        for each in numbers:
            total = total + each
        return total

    @property
    def true(self) -> Number:
        """A truth that holds."""
        return self.code.constant(True)


class Carried:
    """A vector and a symmetric matrix that are carried from step to step, in variables."""

    def __init__(self, code: Code, mean: Matrix, cov: Matrix) -> None:
        self._mean = [held(code, x) for (x,) in mean.rows]
        size = range(len(self._mean))
        self._cov = [[held(code, cov[i, j]) for j in range(i + 1)] for i in size]

    @property
    def mean(self) -> Matrix:
        """The vector."""
        return Matrix.column(x.get() for x in self._mean)

    @property
    def cov(self) -> Matrix:
        """The matrix."""
        half, size = [[x.get() for x in row] for row in self._cov], range(len(self._cov))
        return Matrix([half[max(i, j)][min(i, j)] for j in size] for i in size)

    def set(self, mean: Matrix, cov: Matrix) -> None:
        """Replace both."""
        for variable, (x,) in zip(self._mean, mean.rows, strict=True):
            variable.set(x)
        for i, row in enumerate(self._cov):
            for j, variable in enumerate(row):
                variable.set(cov[i, j])


def held(code: Code, number: Number | float) -> Variable[Number]:
    """A variable that begins as a number, of all runs at hand."""
    return code.variable(constant(code, number).spread(code.lanes))


def chosen(truth: Any, a: Matrix, b: Matrix) -> Matrix:
    """One matrix or another, by a truth."""
    rows = zip(a.rows, b.rows, strict=True)
    return Matrix([where(truth, x, y) for x, y in zip(*both, strict=True)] for both in rows)


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
        elif is_dataclass(each) and not isinstance(each, told.Function | told.Points):
            stack += [getattr(each, field.name) for field in fields(each)]
    return iter(found)


def _after(place: int) -> range:
    return range(place + told.DOWN, place + told.CELL + 1)
