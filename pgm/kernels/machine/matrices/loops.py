"""Matrices of a sweep in memory, by loops, for more than a few components."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.numbers import Number, constant
from pgm.kernels.machine.emitter.passed import inside, lie, place
from pgm.kernels.machine.emitter.traces import Inputs, traced
from pgm.kernels.machine.emitter.wholes import Address
from pgm.kernels.machine.matrices.in_memory.frame import Frame
from pgm.kernels.machine.matrices.in_memory.layout import Layout
from pgm.kernels.machine.matrices.in_memory.stored import Space, Stored
from pgm.kernels.machine.matrices.in_memory.transfers import read, write
from pgm.kernels.machine.matrices.in_memory.views import View, lanes_where


class Loops:
    """Matrices in memory, whose numbers are side by side in packs; see `Matrices`."""

    def __init__(self, code: Code, frame: Frame) -> None:
        self.code, self._frame = code, frame
        self._space = Space(code, frame, Layout.of(code.lanes, code.module.target.registers))

    # From arrays and to them

    def column(self, cells: Memory, size: int) -> Stored:
        """The vector in an array's cells."""
        return read(self._space, cells, 1, size).T

    def matrix(self, cells: Memory, height: int, width: int) -> Stored:
        """The matrix in an array's cells."""
        return read(self._space, cells, height, width)

    def symmetric(self, cells: Memory, size: int) -> Stored:
        """The symmetric matrix in an array's cells."""
        return read(self._space, cells, size, size)

    def keep(self, cells: Memory, matrix: Stored) -> None:
        """Put a vector or a matrix into an array's cells."""
        write(self._space, cells, matrix)

    def constant(self, rows: Sequence[Sequence[float]]) -> Stored:
        """The matrix that is known as the code is written."""
        return self._space.constant(rows, len(rows[0]) if rows else 0)

    def carried(self, mean: Stored, cov: Stored) -> Held:
        """A vector and a symmetric matrix that may be set anew."""
        return Held(mean, cov)

    def scratch(self) -> AbstractContextManager[None]:
        """A context; numbers computed in it are not used after it, unless kept or carried."""
        return self._frame.scratch()

    # Numbers of matrices

    def beside(self, vector: Stored) -> list[Number]:
        """The numbers of a vector, side by side."""
        return vector.T.row(0)

    def row(self, matrix: Stored, i: int) -> list[Number]:
        """The numbers of a row, side by side."""
        return matrix.row(i)

    def diagonal(self, matrix: Stored) -> list[Number]:
        """The numbers on a diagonal, side by side."""
        return matrix.diagonal_row().row(0)

    def largest(self, matrix: Stored) -> list[Number]:
        """The largest magnitude in each column, side by side."""
        return matrix.largest().row(0)

    def alike(self, value: float, size: int) -> list[Number]:
        """Equal numbers of a vector, side by side."""
        layout = self._space.layout
        return [constant(self.code, value).spread(layout.lanes)] * layout.packs(size)

    # Operations beside those of matrices

    def replaced(self, vector: Stored, numbers: Mapping[int, Any]) -> Stored:
        """The vector with other numbers at some places."""
        if not numbers:
            return vector
        found = vector.copy()
        for k, number in numbers.items():
            found.view.put_entry(k, 0, number)
        return found

    def with_columns(self, matrix: Stored, columns: Mapping[int, list[Number]]) -> Stored:
        """The matrix with other columns, whose numbers are side by side, at some places."""
        found = matrix.T.plain()
        for j, numbers in columns.items():
            for q, number in enumerate(numbers):
                found.view.put(j, q, number)
        return found.T

    def above(self, one: Stored, other: Stored) -> Stored:
        """A matrix, and below it another."""
        return one.above(other)

    def shifted(self, matrix: Stored, vector: Stored) -> Stored:
        """The matrix with a vector added to each of its rows."""
        ones = self.constant([[1.0]] * matrix.shape[0])
        return matrix + ones @ vector.T

    def widened(self, matrix: Stored, places: Sequence[int], width: int) -> Stored:
        """The matrix whose columns stand at some places among `width`, with zeros elsewhere."""
        return matrix.widened(places, width)

    def truths(self, beside: Sequence[Number], size: int) -> Stored:
        """Truths about a vector's numbers, side by side, as the steps take them: a row."""
        found = self._space.new(1, size)
        for q, truth in enumerate(beside):
            found.view.put(0, q, truth)
        return found

    def chosen(self, truth: Number, one: Stored, other: Stored) -> Stored:
        """One matrix where a truth holds, another elsewhere."""
        return one.chosen(truth, other)

    # Functions, each one that is called with addresses

    def value(self, function: Function, at: Stored, inputs: Inputs) -> Stored:
        """The value of a function at a vector."""
        return self.values(function, at.T, inputs).T

    def slope(self, function: Function, at: Stored, inputs: Inputs) -> tuple[Stored, Stored]:
        """The value of a function at a vector, and its derivative."""
        value = self._space.new(1, len(function.value))
        slope = self._space.new(value.width, at.shape[0])
        self._apply(function, at.T.plain(), inputs, value, slope)
        return value.T, slope

    def values(self, function: Function, points: Stored, inputs: Inputs) -> Stored:
        """The values of a function at points, row by row."""
        if points.shape[0] > self._space.layout.across > 1:
            return self._packed(function, points, inputs)
        points = points.plain()
        found = self._space.new(points.height, len(function.value))
        if points.height == 1:
            self._apply(function, points, inputs, found)
            return found
        with self.code.loop(points.height) as k:
            point, value = (
                Stored(self._space, each.view.at(k, 0), 1, each.width) for each in (points, found)
            )
            self._apply(function, point, inputs, value)
        return found

    def _packed(self, function: Function, points: Stored, inputs: Inputs) -> Stored:
        """The values at points of a single run, whose components lie in packs."""
        count, across = points.shape[0], self._space.layout.across
        columns = points.T.plain()
        found = self._space.new(len(function.value), count)
        with self.code.loop(self._space.layout.packs(count)) as q:
            at = [columns.view.pack(i, q) for i in range(columns.height)]
            for i, x in enumerate(traced(self.code, function, at, inputs)[0]):
                found.view.put(i, q, x)
        full, rest = divmod(count, across)
        if rest:  # and lanes beyond the last point have the value at zero
            known = lanes_where(self.code, [lane < rest for lane in range(across)])
            for i in range(found.height):
                found.view.put(i, full, known.where(found.view.pack(i, full), 0.0))
        return found.T

    def _apply(self, function: Function, at: Stored, inputs: Inputs, *out: Stored) -> None:
        """Write the value, and the slope, if there is room for one, of a function."""
        number = self.code.module.number("function", function)
        memories = list({id(cells): cells for cells, _ in inputs.values()}.values())
        told = " ".join(map(lie, memories))
        given = [value for cells in memories for value in place(cells)]
        kinds = [ADDRESS] * (1 + len(out)) + [ADDRESS, WHOLE, WHOLE] * len(memories)
        name = f"function {number} {len(out)} {told}"
        helper = self.code.module.helper(name, kinds, self.code.lanes, None)
        if helper.fresh:
            self._write(helper.code, function, at, inputs, memories, out)
        self.code.call(helper.code, at.address, *(each.address for each in out), *given)

    def _write(
        self,
        code: Code,
        function: Function,
        at: Stored,
        inputs: Inputs,
        memories: Sequence[Memory],
        out: Sequence[Stored],
    ) -> None:
        point, *more = code.arguments
        results, more = more[: len(out)], more[len(out) :]
        cells = {
            id(like): inside(code, like, *more[3 * k : 3 * k + 3])
            for k, like in enumerate(memories)
        }
        here = {column: (cells[id(like)], index) for column, (like, index) in inputs.items()}
        known = [at.seen(code, point).entry(0, k) for k in range(at.width)]
        value, slope = traced(code, function, known, here, slope=len(out) > 1)
        self._lay(code, results[0], [value], out[0])
        if len(out) > 1:
            size = at.width
            rows = [slope[i * size : (i + 1) * size] for i in range(len(value))]
            self._lay(code, results[1], rows, out[1])

    def _lay(self, code: Code, to: Address, rows: Sequence[Sequence[Any]], like: Stored) -> None:
        """Write numbers to a matrix: constants at once, and others into them."""
        space = self._space.inside(code)
        plain = [[0.0 if isinstance(x, Number) else float(x) for x in row] for row in rows]
        matrix = Stored(space, to, like.height, like.width)
        space.constant(plain, like.width).copied_to(matrix)
        view: View = matrix.view
        for i, row in enumerate(rows):
            for j, number in enumerate(row):
                if isinstance(number, Number):
                    view.put_entry(i, j, number)


class Held:
    """A vector and a symmetric matrix that are carried from step to step, in memory.

    What it gives is what it holds, until it is set anew.
    """

    def __init__(self, mean: Stored, cov: Stored) -> None:
        new, size = mean.space.new, mean.shape[0]
        self.mean, self.cov = new(1, size).T, new(size, size)
        self.set(mean, cov)

    def set(self, mean: Stored, cov: Stored) -> None:
        """Replace both."""
        mean.copied_to(self.mean)
        cov.copied_to(self.cov)
