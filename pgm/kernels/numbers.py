"""Matrices of numbers, and the functions of numbers that the steps of a chain are written with.

A *number* is whatever computes like one: a float, an array with a number for each run, a pair of
floats (`Twofold`), a traced number, a number of machine code or of a program that is being written.
The kind of number is decided outside; `step` has the arithmetic once, for all of them.

A *matrix* of numbers is whatever has the operations of `Matrix`: sums, products, transposes, and a
`root`. Vectors are matrices of one column. `Matrix` itself is rows of single numbers, `dense` has
matrices that are arrays.

A kind of number that NumPy does not know has two methods: ``x.apply(name, *others)``, the function
of NumPy's that has this name, and ``x.choose(truth, a, b)``, one or the other by a truth.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from math import prod
from typing import Any

import numpy as np

# Of one of the kinds above. They have no common class, as NumPy's arrays are among them.
Number = Any


def applied(name: str, x: Number) -> Number:
    """The function of NumPy's that has this name, of a number of any kind."""
    if hasattr(x, "apply"):
        return x.apply(name)
    with np.errstate(all="ignore"):
        return getattr(np, name)(x)


def sqrt(x: Number) -> Number:
    """√x; NaN of a negative float."""
    if type(x) is float:
        return math.sqrt(x) if x >= 0.0 else math.nan
    return applied("sqrt", x)


def log(x: Number) -> Number:
    """The natural logarithm ln x; −∞ of zero, and NaN of a negative float."""
    if type(x) is float:
        return math.log(x) if x > 0.0 else -math.inf if x == 0.0 else math.nan
    return applied("log", x)


def inverse(x: Number) -> Number:
    """1 / x; infinite of zero."""
    if type(x) is float:
        return 1.0 / x if x else math.copysign(math.inf, x)
    return 1.0 / x


def nearest_whole(x: Number) -> Number:
    """The nearest whole number; of two, the even one."""
    return applied("rint", x)


def where(truth: Number, a: Number, b: Number) -> Number:
    """The number a where a truth holds, b elsewhere."""
    if type(truth) is bool:
        return a if truth else b
    for each in (truth, a, b):
        if hasattr(each, "choose") and not isinstance(each, np.ndarray | np.generic):
            return each.choose(truth, a, b)
    return np.where(truth, a, b)


def least(a: Number, b: Number) -> Number:
    """The lesser of two numbers; NaN where one is."""
    if type(a) is float and type(b) is float:
        return a if a < b or a != a else b
    if isinstance(a, np.ndarray):
        return np.minimum(a, b)
    return where((a < b) | (a != a), a, b)


def most(a: Number, b: Number) -> Number:
    """The larger of two numbers; NaN where one is."""
    if type(a) is float and type(b) is float:
        return a if a > b or a != a else b
    if isinstance(a, np.ndarray):
        return np.maximum(a, b)
    return where((a > b) | (a != a), a, b)


def is_zero(x: Number) -> bool:
    """Whether a number is the float 0, so that it is known before there are others."""
    return type(x) is float and x == 0.0


def inner(a: Sequence[Number], b: Sequence[Number]) -> Number:
    """The sum of the products of numbers; those with a zero that is known are left out."""
    total: Number = None
    for x, y in zip(a, b, strict=True):
        if not (is_zero(x) or is_zero(y)):
            total = x * y if total is None else total + x * y
    return 0.0 if total is None else total


class Matrix:
    """A matrix of single numbers, (m, n), row by row; n is told where there are no rows."""

    __slots__ = ("rows", "width")

    def __init__(self, rows: Iterable[Sequence[Number]], width: int = 0) -> None:
        self.rows = tuple(rows)
        self.width = len(self.rows[0]) if self.rows else width

    @classmethod
    def column(cls, numbers: Iterable[Number]) -> Matrix:
        """A vector, as a matrix of one column."""
        return cls(((x,) for x in numbers), 1)

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of rows and columns."""
        return len(self.rows), self.width

    @property
    def columns(self) -> list[tuple[Number, ...]]:
        """The matrix column by column."""
        return [tuple(row[j] for row in self.rows) for j in range(self.width)]

    def __getitem__(self, place: tuple[int, int]) -> Number:
        return self.rows[place[0]][place[1]]

    @property
    def T(self) -> Matrix:
        """The matrix transposed."""
        return Matrix(self.columns, len(self.rows))

    def __matmul__(self, other: Matrix) -> Matrix:
        columns = other.columns
        found = ([inner(row, column) for column in columns] for row in self.rows)
        return Matrix(found, len(columns))

    def __add__(self, other: Matrix) -> Matrix:
        pairs = zip(self.rows, other.rows, strict=True)
        found = ([x + y for x, y in zip(*both, strict=True)] for both in pairs)
        return Matrix(found, self.width)

    def __sub__(self, other: Matrix) -> Matrix:
        pairs = zip(self.rows, other.rows, strict=True)
        found = ([x - y for x, y in zip(*both, strict=True)] for both in pairs)
        return Matrix(found, self.width)

    def times(self, other: Matrix) -> Matrix:
        """The product A Bᵀ, of which it is known that it is symmetric: half of it is computed."""
        size = len(self.rows)
        out: list[list[Number]] = [[None] * size for _ in range(size)]
        for i, row in enumerate(self.rows):
            for j in range(i + 1):
                out[i][j] = out[j][i] = inner(row, other.rows[j])
        return Matrix(out)

    def one_minus(self) -> Matrix:
        """The matrix I − A."""
        return Matrix(
            [(1.0 if i == j else 0.0) - x for j, x in enumerate(row)]
            for i, row in enumerate(self.rows)
        )

    def scaled(self, number: Number) -> Matrix:
        """The matrix times a number."""
        return Matrix([x * number for x in row] for row in self.rows)

    def beside(self, other: Matrix) -> Matrix:
        """The matrix [A B] of A, this one, and another."""
        pairs = zip(self.rows, other.rows, strict=True)
        return Matrix(((*row, *right) for row, right in pairs), self.width + other.width)

    def part(self, rows: Sequence[int], columns: Sequence[int]) -> Matrix:
        """The entries in some rows and columns."""
        return Matrix(([self.rows[i][j] for j in columns] for i in rows), len(columns))

    def bordered(self, across: Matrix, own: Matrix) -> Matrix:
        """The symmetric matrix [[A, Bᵀ], [B, C]] of A, this one, B = `across` and C = `own`."""
        above = [(*row, *right) for row, right in zip(self.rows, across.columns, strict=True)]
        below = [(*row, *right) for row, right in zip(across.rows, own.rows, strict=True)]
        return Matrix([*above, *below])

    def kept(self, known: Sequence[Number]) -> Matrix:
        """The matrix with zeros in rows that are not `known`, a truth for each."""
        pairs = zip(known, self.rows, strict=True)
        rows = ([x if is_zero(x) else where(truth, x, 0.0) for x in row] for truth, row in pairs)
        return Matrix(rows, self.width)

    def independent(self, known: Sequence[Number]) -> Matrix:
        """The symmetric matrix with the rows and columns of I where a component is not `known`."""
        both = self.kept(known).T.kept(known)
        return Matrix(
            [where(truth, x, 1.0) if i == j else x for j, x in enumerate(row)]
            for i, (truth, row) in enumerate(zip(known, both.rows, strict=True))
        )

    @property
    def diagonal(self) -> list[Number]:
        """The entries on the diagonal."""
        return [row[i] for i, row in enumerate(self.rows)]

    def root(self) -> Root:
        """The lower triangular root L of a symmetric matrix A = L Lᵀ."""
        return Root(self)


class Root:
    """The lower triangular root L of a symmetric positive definite matrix A = L Lᵀ.

    `share` is the least part of its diagonal entry that is left to a pivot L_jj²: a share that is
    not clearly above zero, or NaN, tells that A is nearly singular, or indefinite.
    """

    __slots__ = ("lower", "over", "share")

    def __init__(self, matrix: Matrix) -> None:
        self.share: Number = 1.0
        self.lower: list[list[Number]] = []
        self.over: list[Number] = []  # one over each entry of the diagonal
        for i, row in enumerate(matrix.rows):
            known: list[Number] = []
            for j in range(i):
                known.append((row[j] - inner(known, self.lower[j][:j])) * self.over[j])
            pivot = row[i] - inner(known, known)
            if i:
                self.share = least(pivot * inverse(abs(row[i])), self.share)
            else:  # which is 1, 0 of a pivot that is not positive, and NaN of one that is none
                self.share = where(pivot > 0.0, 1.0, 0.0) + 0.0 * pivot
            known.append(sqrt(pivot))
            self.over.append(inverse(known[i]))
            self.lower.append(known)

    @property
    def volume(self) -> Number:
        """The logarithm of |L|, half of that of |A|."""
        # By pairs: no product of two roots is too small or too large a number.
        pivots = [row[i] for i, row in enumerate(self.lower)]
        total: Number = 0.0
        for k in range(0, len(pivots), 2):
            total = total + log(prod(pivots[k : k + 2]))
        return total

    @property
    def matrix(self) -> Matrix:
        """The root as a matrix."""
        size = len(self.lower)
        return Matrix([*row, *(0.0,) * (size - 1 - i)] for i, row in enumerate(self.lower))

    def solve(self, right: Matrix) -> Matrix:
        """The X with L X = B."""
        found: list[list[Number]] = []
        for i, row in enumerate(right.rows):
            rest = list(row)
            for x, above in zip(self.lower[i], found, strict=False):
                rest = [a if is_zero(b) else a - x * b for a, b in zip(rest, above, strict=True)]
            found.append([a if is_zero(a) else a * self.over[i] for a in rest])
        return Matrix(found, right.width)

    def solve_transposed(self, right: Matrix) -> Matrix:
        """The X with Lᵀ X = B."""
        size = len(self.lower)
        found: list[Sequence[Number]] = [()] * size
        for i in reversed(range(size)):
            rest = list(right.rows[i])
            for k in range(i + 1, size):
                x = self.lower[k][i]
                rest = [a - x * b for a, b in zip(rest, found[k], strict=True)]
            found[i] = [a * self.over[i] for a in rest]
        return Matrix(found, right.width)

    @property
    def inverse(self) -> Matrix:
        """The matrix A⁻¹."""
        white = self._inverse.T
        return white.times(white)

    @property
    def precisions(self) -> list[Number]:
        """The diagonal of A⁻¹: one over each component's variance given all others."""
        return [inner(column, column) for column in self._inverse.columns]

    @property
    def _inverse(self) -> Matrix:
        """The matrix L⁻¹."""
        size = range(len(self.lower))
        return self.solve(Matrix([1.0 if i == j else 0.0 for j in size] for i in size))
