"""The matrices that sweeps are written with, in straight lines or in loops.

Two kinds have the operations here, and their matrices those of `pgm.kernels.numbers.Matrix`, over
which `pgm.kernels.step` is written. `Lines` keeps numbers in registers: its code grows with the
cube of the components, and leaves out zeros that are known. `Loops` keeps them in memory.

Numbers that are *side by side* are those of a vector, one by one, or in packs of several of a
single run, with zeros after the last; arithmetic on such lists is the same for both kinds, and
`Writer.together` makes one number of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.traces import Inputs
from pgm.kernels.step import AnyMatrix


class Belief(Protocol):
    """A mean and a covariance that are carried from step to step.

    What it gives holds until it is set anew.
    """

    @property
    def mean(self) -> AnyMatrix:
        """The vector."""

    @property
    def cov(self) -> AnyMatrix:
        """The matrix."""

    def set(self, mean: Any, cov: Any) -> None:
        """Replace both."""


class Matrices(Protocol):
    """A kind of matrices."""

    # From arrays and to them

    def column(self, cells: Memory, size: int) -> AnyMatrix:
        """The vector in an array's cells."""

    def matrix(self, cells: Memory, height: int, width: int) -> AnyMatrix:
        """The matrix in an array's cells."""

    def symmetric(self, cells: Memory, size: int) -> AnyMatrix:
        """The symmetric matrix in an array's cells."""

    def keep(self, cells: Memory, matrix: Any) -> None:
        """Put a vector or a matrix into an array's cells."""

    def constant(self, rows: Sequence[Sequence[float]]) -> AnyMatrix:
        """The matrix that is known as the code is written."""

    def carried(self, mean: Any, cov: Any) -> Belief:
        """A vector and a symmetric matrix that may be set anew."""

    def scratch(self) -> AbstractContextManager[None]:
        """A context; numbers computed in it are not used after it, unless kept or carried."""

    # Numbers of matrices

    def beside(self, vector: Any) -> list[Any]:
        """The numbers of a vector, side by side."""

    def row(self, matrix: Any, i: int) -> list[Any]:
        """The numbers of a row, side by side."""

    def diagonal(self, matrix: Any) -> list[Any]:
        """The numbers on a diagonal, side by side."""

    def largest(self, matrix: Any) -> list[Any]:
        """The largest magnitude in each column, side by side."""

    def alike(self, value: float, size: int) -> list[Number]:
        """Equal numbers of a vector, side by side."""

    # Operations beside those of matrices

    def replaced(self, vector: Any, numbers: Mapping[int, Any]) -> AnyMatrix:
        """The vector with other numbers at some places."""

    def with_columns(self, matrix: Any, columns: Mapping[int, list[Any]]) -> AnyMatrix:
        """The matrix with other columns, whose numbers are side by side, at some places."""

    def above(self, one: Any, other: Any) -> AnyMatrix:
        """A matrix, and below it another."""

    def shifted(self, matrix: Any, vector: Any) -> AnyMatrix:
        """The matrix with a vector added to each of its rows."""

    def widened(self, matrix: Any, places: Sequence[int], width: int) -> AnyMatrix:
        """The matrix whose columns stand at some places among `width`, with zeros elsewhere."""

    def truths(self, beside: Sequence[Number], size: int) -> Any:
        """Truths about a vector's numbers, side by side, as the steps take them."""

    def chosen(self, truth: Number, one: Any, other: Any) -> AnyMatrix:
        """One matrix where a truth holds, another elsewhere."""

    # Functions

    def value(self, function: Function, at: Any, inputs: Inputs) -> AnyMatrix:
        """The value of a function at a vector."""

    def slope(self, function: Function, at: Any, inputs: Inputs) -> tuple[AnyMatrix, AnyMatrix]:
        """The value of a function at a vector, and its derivative."""

    def values(self, function: Function, points: Any, inputs: Inputs) -> AnyMatrix:
        """The values of a function at points, row by row."""
