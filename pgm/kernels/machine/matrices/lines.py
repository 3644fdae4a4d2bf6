"""Matrices of a sweep in straight lines: rows of numbers in registers, for a few components."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.numbers import Number, constant
from pgm.kernels.machine.emitter.traces import Inputs, traced
from pgm.kernels.machine.emitter.variables import held
from pgm.kernels.numbers import Matrix, most, where


class Lines:
    """Matrices that are rows of single numbers, side by side one by one; see `Matrices`."""

    def __init__(self, code: Code) -> None:
        self.code = code

    # From arrays and to them

    def column(self, cells: Memory, size: int) -> Matrix:
        """The vector in an array's cells."""
        return Matrix.column(cells.load(k) for k in range(size))

    def matrix(self, cells: Memory, height: int, width: int) -> Matrix:
        """The matrix in an array's cells."""
        rows = ([cells.load(i * width + j) for j in range(width)] for i in range(height))
        return Matrix(rows, width)

    def symmetric(self, cells: Memory, size: int) -> Matrix:
        """The symmetric matrix in an array's cells, of which the lower half is read."""
        return _symmetric([[cells.load(i * size + j) for j in range(i + 1)] for i in range(size)])

    def symmetric_of(self, cells: Memory, places: Sequence[int], size: int) -> Matrix:
        """Some rows and columns, in ascending order, of a symmetric matrix in an array's cells."""
        rows = enumerate(places)
        return _symmetric([[cells.load(i * size + j) for j in places[: k + 1]] for k, i in rows])

    def keep(self, cells: Memory, matrix: Matrix) -> None:
        """Put a vector or a matrix into an array's cells."""
        for k, number in enumerate(number for row in matrix.rows for number in row):
            cells.store(k, number)

    def constant(self, rows: Sequence[Sequence[float]]) -> Matrix:
        """The matrix that is known as the code is written."""
        return Matrix(rows)

    def carried(self, mean: Matrix, cov: Matrix) -> Carried:
        """A vector and a symmetric matrix that may be set anew."""
        return Carried(self.code, mean, cov)

    def scratch(self) -> AbstractContextManager[None]:
        """A context; numbers computed in it are not used after it, unless kept or carried."""
        return nullcontext()

    # Numbers of matrices

    def beside(self, vector: Matrix) -> list[Any]:
        """The numbers of a vector, side by side."""
        return [number for row in vector.rows for number in row]

    def row(self, matrix: Matrix, i: int) -> list[Any]:
        """The numbers of a row, side by side."""
        return list(matrix.rows[i])

    def diagonal(self, matrix: Matrix) -> list[Any]:
        """The numbers on a diagonal, side by side."""
        return matrix.diagonal

    def largest(self, matrix: Matrix) -> list[Any]:
        """The largest magnitude in each column, side by side."""
        first, *others = ([abs(x) for x in row] for row in matrix.rows)
        for row in others:
            first = [most(a, b) for a, b in zip(first, row, strict=True)]
        return first

    def alike(self, value: float, size: int) -> list[Number]:
        """Equal numbers of a vector, side by side."""
        return [self.code.constant(value)] * size

    # Operations beside those of matrices

    def replaced(self, vector: Matrix, numbers: Mapping[int, Any]) -> Matrix:
        """The vector with other numbers at some places."""
        return Matrix.column(numbers.get(k, x) for k, (x,) in enumerate(vector.rows))

    def with_columns(self, matrix: Matrix, columns: Mapping[int, list[Any]]) -> Matrix:
        """The matrix with other columns, whose numbers are side by side, at some places."""
        rows = zip(*(columns.get(j, each) for j, each in enumerate(matrix.columns)), strict=True)
        return Matrix(rows, matrix.width)

    def above(self, one: Matrix, other: Matrix) -> Matrix:
        """A matrix, and below it another."""
        return Matrix([*one.rows, *other.rows], one.width)

    def shifted(self, matrix: Matrix, vector: Matrix) -> Matrix:
        """The matrix with a vector added to each of its rows."""
        by = self.beside(vector)
        return Matrix([a + b for a, b in zip(row, by, strict=True)] for row in matrix.rows)

    def widened(self, matrix: Matrix, places: Sequence[int], width: int) -> Matrix:
        """The matrix whose columns stand at some places among `width`, with zeros elsewhere."""
        own = {place: k for k, place in enumerate(places)}
        size = range(width)
        rows = ([row[own[j]] if j in own else 0.0 for j in size] for row in matrix.rows)
        return Matrix(rows, width)

    def truths(self, beside: Sequence[Number], size: int) -> Sequence[Number]:
        """Truths about a vector's numbers, side by side, as the steps take them."""
        return beside

    def chosen(self, truth: Number, one: Matrix, other: Matrix) -> Matrix:
        """One matrix where a truth holds, another elsewhere."""
        rows = zip(one.rows, other.rows, strict=True)
        found = ([where(truth, x, y) for x, y in zip(*both, strict=True)] for both in rows)
        return Matrix(found, one.width)

    # Functions

    def value(self, function: Function, at: Matrix, inputs: Inputs) -> Matrix:
        """The value of a function at a vector."""
        return Matrix.column(traced(self.code, function, self.beside(at), inputs)[0])

    def slope(self, function: Function, at: Matrix, inputs: Inputs) -> tuple[Matrix, Matrix]:
        """The value of a function at a vector, and its derivative."""
        value, slope = traced(self.code, function, self.beside(at), inputs, slope=True)
        size = at.shape[0]
        rows = (slope[i * size : (i + 1) * size] for i in range(len(value)))
        return Matrix.column(value), Matrix(rows, size)

    def values(self, function: Function, points: Matrix, inputs: Inputs) -> Matrix:
        """The values of a function at points, row by row: those of a single run pack by pack."""
        lanes = self.code.module.target.registers[0]
        if self.code.lanes > 1 or len(points.rows) <= lanes:
            return Matrix(traced(self.code, function, row, inputs)[0] for row in points.rows)
        found: list[list[Any]] = []
        for first in range(0, len(points.rows), lanes):
            rows = points.rows[first : first + lanes]
            # Lanes beyond the last point have the first, as they must have some.
            every = [*rows, *[rows[0]] * (lanes - len(rows))]
            packs = [_beside(self.code, column) for column in zip(*every, strict=True)]
            value = [constant(self.code, x) for x in traced(self.code, function, packs, inputs)[0]]
            found += [[x.lane(k) for x in value] for k in range(len(rows))]
        return Matrix(found)


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
        return _symmetric([[x.get() for x in row] for row in self._cov])

    def set(self, mean: Matrix, cov: Matrix) -> None:
        """Replace both."""
        for variable, (x,) in zip(self._mean, mean.rows, strict=True):
            variable.set(x)
        for i, row in enumerate(self._cov):
            for j, variable in enumerate(row):
                variable.set(cov[i, j])


def _beside(code: Code, numbers: Sequence[Number | float]) -> Number:
    """The pack that has a number in each lane."""
    pack = Number(code, "poison", len(numbers))
    for lane, number in enumerate(numbers):
        pack = pack.with_lane(lane, number)
    return pack


def _symmetric(half: list[list[Any]]) -> Matrix:
    """The matrix whose lower half this is."""
    size = range(len(half))
    return Matrix([half[max(i, j)][min(i, j)] for j in size] for i in size)
