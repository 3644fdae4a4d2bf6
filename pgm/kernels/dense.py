"""Matrices that are arrays, with the operations of `numbers.Matrix`.

A kind says where the components stand: `Dense` is one matrix, by BLAS and LAPACK; `Runs` are the
matrices of many runs, each entry a contiguous row of runs; `Stack` are matrices in the last two
axes. The roots of the first two are those of regular matrices, of which the `share` tells how
regular; that of a stack is semidefinite, and tells zeros from rounding (`roots`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property, lru_cache
from math import prod
from threading import local
from types import ModuleType
from typing import Any, Self

import numpy as np

from pgm.kernels import roots, solving
from pgm.kernels.arrays import (
    Array,
    Mask,
    block,
    frozen,
    independent,
    make_symmetric,
    multiply,
    times_symmetric,
    times_transposed,
    transpose,
)
from pgm.kernels.numbers import Matrix, Number, Root, least, log

# A B and A Bᵀ along rows of runs.
_PRODUCT, _TIMES = "ij...,jk...->ik...", "ij...,kj...->ik..."
# From this size on half of a symmetric product of rows of runs is computed, row by row.
_LARGE = 6


class _ArrayMatrix:
    """The base of the kinds; `symmetric` tells that a matrix is known to be so."""

    __slots__ = ("array", "symmetric")

    def __init__(self, array: Array, symmetric: bool = False) -> None:
        self.array, self.symmetric = array, symmetric

    def __add__(self, other: Self) -> Self:
        return type(self)(self.array + other.array)

    def __sub__(self, other: Self) -> Self:
        return type(self)(self.array - other.array)


class _ComponentsFirst(_ArrayMatrix):
    """The base of the kinds whose components stand first."""

    __slots__ = ()

    @property
    def shape(self) -> tuple[int, ...]:
        """The numbers of rows and columns."""
        return self.array.shape[:2]

    def beside(self, other: Self) -> Self:
        """The matrix [A B] of A, this one, and another."""
        return type(self)(np.concatenate([self.array, other.array], axis=1))

    def kept(self, known: Any) -> Self:
        """The matrix with zeros in rows that are not `known`, with truths for each."""
        return type(self)(np.where(np.asarray(known)[:, None], self.array, 0.0))

    def independent(self, known: Any) -> Self:
        """The symmetric matrix with the rows and columns of I where a component is not `known`."""
        truths = np.asarray(known)
        if truths.all():
            return self
        eye = _identity(len(truths)).reshape(*self.shape, *(1 for _ in self.array.shape[2:]))
        return type(self)(np.where(truths[:, None] & truths, self.array, eye))


@lru_cache(maxsize=1)
def _lapack() -> ModuleType:
    """SciPy's module of LAPACK functions, imported at the first call."""
    from scipy.linalg import lapack  # here, since it is slow to import

    module: ModuleType = lapack
    return module


@lru_cache(maxsize=64)
def _identity(size: int) -> Array:
    """The matrix I, (size, size)."""
    return frozen(np.eye(size))


class Dense(_ComponentsFirst):
    """One matrix, (m, n)."""

    __slots__ = ()

    def __getitem__(self, place: tuple[int, int]) -> float:
        found: float = self.array.item(*place)
        return found

    @property
    def T(self) -> Dense:
        """The matrix transposed."""
        return Dense(self.array.T)

    def __matmul__(self, other: Dense) -> Dense:
        return Dense(self.array.dot(other.array))

    def times(self, other: Dense) -> Dense:
        """The product A Bᵀ, of which it is known that it is symmetric but for rounding."""
        return Dense(self.array.dot(other.array.T))

    def one_minus(self) -> Dense:
        """The matrix I − A."""
        return Dense(_identity(len(self.array)) - self.array)

    def scaled(self, number: float) -> Dense:
        """The matrix times a number."""
        return Dense(self.array * number)

    def part(self, rows: Sequence[int], columns: Sequence[int]) -> Dense:
        """The entries in some rows and columns."""
        return Dense(self.array[np.ix_(rows, columns)])

    def bordered(self, across: Dense, own: Dense) -> Dense:
        """The symmetric matrix [[A, Bᵀ], [B, C]] of A, this one, B = `across` and C = `own`."""
        return Dense(np.block([[self.array, across.array.T], [across.array, own.array]]))

    @property
    def diagonal(self) -> list[float]:
        """The entries on the diagonal."""
        found: list[float] = self.array.diagonal().tolist()
        return found

    def root(self) -> DenseRoot:
        """The lower triangular root L of a symmetric matrix A = L Lᵀ."""
        return DenseRoot(self.array)


class DenseRoot:
    """The root `lower` (n, n) of a positive definite matrix A = L Lᵀ; NaN if A is not definite."""

    __slots__ = ("lower", "share")
    lower: Array

    def __init__(self, matrix: Array) -> None:
        self.lower, fault = _lapack().dpotrf(matrix, 1)
        if fault:
            self.lower = np.full_like(matrix, np.nan)
        self.share: float = math.nan if fault else 1.0
        pivots, whole = self.lower.diagonal().tolist(), matrix.diagonal().tolist()
        for pivot, variance in zip(pivots, whole, strict=True):
            self.share = least(pivot * pivot / variance if variance else math.nan, self.share)

    @property
    def volume(self) -> float:
        """The logarithm of |L|, half of that of |A|."""
        total: float = sum(map(log, self.lower.diagonal().tolist()))
        return total

    @property
    def matrix(self) -> Dense:
        """The root as a matrix."""
        return Dense(self.lower)

    def solve(self, right: Dense) -> Dense:
        """The X with L X = B."""
        return Dense(_lapack().dtrtrs(self.lower, right.array, 1)[0])

    def solve_transposed(self, right: Dense) -> Dense:
        """The X with Lᵀ X = B."""
        return Dense(_lapack().dtrtrs(self.lower, right.array, 1, 1)[0])


def first(array: Array, symmetric: bool = False) -> Dense | Runs:
    """The matrix (m, n), or those of many runs (m, n, *batch), whose components stand first."""
    return Dense(array, symmetric) if array.ndim == 2 else Runs(array, symmetric)


# The numbers of a step beyond which memory is not kept for the next.
_KEPT = 1 << 22


class _Scratch(local):
    """Memory for the products of a step, which the next step uses again, by thread.

    Fresh memory for large arrays takes longer than their arithmetic.
    """

    def __init__(self) -> None:
        self.memory, self.used, self.active = np.empty(0), 0, False

    def empty(self, *shape: int) -> Array:
        """An uninitialised array."""
        if not self.active:
            return np.empty(shape)
        first, self.used = self.used, self.used + prod(shape)
        if self.used > self.memory.size:
            return np.empty(shape)
        return self.memory[first : self.used].reshape(shape)


_scratch = _Scratch()


@contextmanager
def scratch() -> Iterator[None]:
    """A context in which products of runs lie in memory that is used again after it.

    Sums and differences do not, and can leave it.
    """
    if _scratch.memory.size < _scratch.used <= _KEPT:
        _scratch.memory = np.empty(_scratch.used)
    _scratch.used, _scratch.active = 0, True
    try:
        yield
    finally:
        _scratch.active = False


class Runs(_ComponentsFirst):
    """The matrices of many runs, (m, n, *batch), or one for all, (m, n, 1)."""

    __slots__ = ()

    def __getitem__(self, place: tuple[int, int]) -> Array:
        found: Array = self.array[place]
        return found

    @property
    def T(self) -> Runs:
        """The matrices transposed."""
        return Runs(self.array.swapaxes(0, 1))

    def __matmul__(self, other: Runs) -> Runs:
        a, b = self.array, other.array
        if a.shape[2:] == (1,):  # one for all, of which BLAS makes products
            out, wide = _scratch.empty(len(a), *b.shape[1:]), prod(b.shape[1:])
            np.matmul(a[..., 0], b.reshape(len(b), wide), out=out.reshape(len(a), wide))
            return Runs(out)
        out = _scratch.empty(len(a), b.shape[1], *_batch(a, b))
        if b.shape[2:] == (1,):
            _flat_product(b[..., 0].T, a, out)
            return Runs(out)
        # Of a symmetric matrix rows are read in place of columns, which is faster.
        return Runs(np.einsum(_TIMES if other.symmetric else _PRODUCT, a, b, out=out))

    def times(self, other: Runs) -> Runs:
        """The products A Bᵀ, of which it is known that they are symmetric: half is computed."""
        a, b = self.array, other.array
        size = len(a)
        out = _scratch.empty(size, size, *_batch(a, b))
        if b.shape[2:] == (1,) != a.shape[2:]:
            _flat_product(b[..., 0], a, out)
        elif size < _LARGE:
            np.einsum(_TIMES, a, b, out=out)
        else:
            for i in range(size):
                np.einsum("j...,kj...->k...", a[i], b[: i + 1], out=out[i, : i + 1])
        for i in range(1, size):
            out[:i, i] = out[i, :i]
        return Runs(out)

    def one_minus(self) -> Runs:
        """The matrices I − A."""
        found = np.negative(self.array, out=_scratch.empty(*self.array.shape))
        diagonal = np.einsum("ii...->i...", found)
        diagonal += 1.0
        return Runs(found)

    def scaled(self, number: Number) -> Runs:
        """The matrices times a number each."""
        return Runs(self.array * number)

    def part(self, rows: Sequence[int], columns: Sequence[int]) -> Runs:
        """The entries in some rows and columns."""
        if isinstance(rows, range) and isinstance(columns, range):  # of which there is a view
            return Runs(self.array[rows.start : rows.stop, columns.start : columns.stop])
        return Runs(self.array[np.ix_(rows, columns)])

    def bordered(self, across: Runs, own: Runs) -> Runs:
        """The symmetric matrices [[A, Bᵀ], [B, C]] of A, these, B = `across` and C = `own`."""
        above = np.concatenate([self.array, across.array.swapaxes(0, 1)], axis=1)
        below = np.concatenate([across.array, own.array], axis=1)
        return Runs(np.concatenate([above, below]))

    @property
    def diagonal(self) -> list[Array]:
        """The entries on the diagonal."""
        return [self.array[i, i] for i in range(len(self.array))]

    def root(self) -> RunsRoot:
        """The lower triangular roots L of symmetric matrices A = L Lᵀ."""
        return RunsRoot(Root(Matrix(self.array)))


class RunsRoot:
    """The roots of many runs' matrices: `Root`, whose numbers are rows of runs.

    A row of a right side is one number of it, (columns, *batch), so that all columns are solved for
    at once.
    """

    def __init__(self, root: Root) -> None:
        self.root = root

    @property
    def share(self) -> Array:
        """The least part of a diagonal entry that is left to a pivot, (*batch)."""
        found: Array = self.root.share
        return found

    @cached_property
    def volume(self) -> Array:
        """The logarithms of |L|, (*batch)."""
        found: Array = self.root.volume
        return found

    @property
    def precisions(self) -> list[Array]:
        """The diagonals of the inverses: one over each component's variance given all others."""
        return self.root.precisions

    @property
    def matrix(self) -> Runs:
        """The roots as matrices."""
        lower = self.root.lower
        found = np.zeros((len(lower), len(lower), *lower[0][0].shape))
        for i, row in enumerate(lower):
            found[i, : i + 1] = row
        return Runs(found)

    def solve(self, right: Runs) -> Runs:
        """The X with L X = B."""
        return _runs(self.root.solve(_rows(right)))

    def solve_transposed(self, right: Runs) -> Runs:
        """The X with Lᵀ X = B."""
        return _runs(self.root.solve_transposed(_rows(right)))


def _batch(a: Array, b: Array) -> tuple[int, ...]:
    """The batch of two arrays (m, n, *batch), of which one may be of length one."""
    one, other = a.shape[2:], b.shape[2:]
    return one if other == (1,) or one == other else np.broadcast_shapes(one, other)


def _flat_product(one: Array, many: Array, out: Array) -> None:
    """The products B A_i of B (k, n) and rows A_i (n, *batch) of A (m, n, *batch), for all i."""
    runs = prod(many.shape[2:])
    a, found = (each.reshape(*each.shape[:2], runs) for each in (many, out))
    np.matmul(one, a, out=found)


def _rows(right: Runs) -> Matrix:
    return Matrix([row] for row in right.array)


def _runs(rows: Matrix) -> Runs:
    columns = [row[0] for row in rows.rows]
    out = _scratch.empty(len(columns), *columns[0].shape)
    for place, column in zip(out, columns, strict=True):
        place[...] = column
    return Runs(out)


class Stack(_ArrayMatrix):
    """Matrices in the last two axes, (..., m, n); see `arrays` for how they lie in memory."""

    __slots__ = ()

    @classmethod
    def column(cls, vector: Array) -> Stack:
        """Vectors (..., n), as matrices of one column."""
        return cls(vector[..., None])

    @property
    def vector(self) -> Array:
        """Matrices of one column as vectors, (..., n)."""
        return self.array[..., 0]

    @property
    def shape(self) -> tuple[int, ...]:
        """The numbers of rows and columns."""
        return self.array.shape[-2:]

    def __getitem__(self, place: tuple[int, int]) -> Array:
        found: Array = self.array[(..., *place)]
        return found

    @property
    def T(self) -> Stack:
        """The matrices transposed."""
        return Stack(transpose(self.array))

    def __matmul__(self, other: Stack) -> Stack:
        product = times_symmetric if other.symmetric else multiply
        return Stack(product(self.array, other.array))

    def times(self, other: Stack) -> Stack:
        """The products A Bᵀ, of which it is known that they are symmetric."""
        return Stack(make_symmetric(times_transposed(self.array, other.array)))

    def one_minus(self) -> Stack:
        """The matrices I − A."""
        found = -self.array
        diagonal = np.einsum("...ii->...i", found)
        diagonal += 1.0
        return Stack(found)

    def scaled(self, number: Number) -> Stack:
        """The matrices times a number each."""
        return Stack(self.array * np.asarray(number)[..., None, None])

    def part(self, rows: Sequence[int], columns: Sequence[int]) -> Stack:
        """The entries in some rows and columns."""
        return Stack(block(self.array, np.array(rows, dtype=int), np.array(columns, dtype=int)))

    def bordered(self, across: Stack, own: Stack) -> Stack:
        """The symmetric matrices [[A, Bᵀ], [B, C]] of A, these, B = `across` and C = `own`."""
        above = np.concatenate([self.array, transpose(across.array)], axis=-1)
        below = np.concatenate([across.array, own.array], axis=-1)
        return Stack(np.concatenate([above, below], axis=-2))

    def beside(self, other: Stack) -> Stack:
        """The matrices [A B] of A, these, and others."""
        return Stack(np.concatenate([self.array, other.array], axis=-1))

    def kept(self, known: Mask) -> Stack:
        """The matrices with zeros in rows that `known` (..., m) does not mark."""
        return Stack(np.where(known[..., None], self.array, 0.0))

    def independent(self, known: Mask) -> Stack:
        """The symmetric matrices with the rows and columns of I that `known` (..., n) leaves."""
        return self if known.all() else Stack(independent(self.array, known), True)

    @property
    def diagonal(self) -> list[Array]:
        """The entries on the diagonal."""
        return [self.array[..., i, i] for i in range(self.array.shape[-1])]

    def root(self) -> StackRoot:
        """The lower triangular roots L of symmetric semidefinite matrices A = L Lᵀ."""
        return StackRoot(roots.root(self.array))


class Rounded(Stack):
    """Covariances (..., n, n) of which zeros are told from rounding by the sums that they are.

    A pivot of at most `negligible` times its entry of `scale` (..., n) is zero. Where rounding has
    lost a root, the pseudo-inverse by eigenvalues takes its place.
    """

    __slots__ = ("negligible", "scale")

    def __init__(self, array: Array, scale: Array, negligible: float) -> None:
        super().__init__(array, True)
        self.scale, self.negligible = scale, negligible

    def root(self) -> StackRoot:
        """The lower triangular roots L of A = L Lᵀ, or its pseudo-inverse."""
        return StackRoot(roots.root(self.array, self.scale, self.negligible), self.array)


class StackRoot:
    """The roots `lower` (..., n, n) of semidefinite matrices A = L Lᵀ; NaN where one is indefinite.

    The rows of determined components are zero in what is solved for. If A is given, then where
    rounding has lost its root, `solve` leaves a right side as it is, and `solve_transposed` takes
    the whole pseudo-inverse, so that both are that of A.
    """

    def __init__(self, lower: Array, matrix: Array | None = None) -> None:
        self.lower, self._matrix = lower, matrix

    @cached_property
    def fixed(self) -> Mask:
        """Which components are determined by those before them, (..., n)."""
        return roots.determined(self.lower)

    @cached_property
    def _lost(self) -> Mask | None:
        """Which matrices have lost their roots, (...); None if none has, or they are not given."""
        if self._matrix is None:
            return None
        lost: Mask = np.asarray(np.isnan(self.lower).any(axis=(-2, -1)))
        return lost if lost.any() else None

    @property
    def share(self) -> Array:
        """The least part of a diagonal entry that is left to a pivot, (...)."""
        pivots = np.diagonal(self.lower, axis1=-2, axis2=-1)
        total = np.einsum("...ij,...ij->...i", self.lower, self.lower)
        found: Array = (pivots * pivots / np.where(total > 0.0, total, 1.0)).min(-1, initial=1.0)
        return found

    @property
    def volume(self) -> Array:
        """The logarithms of |L| over the components that are not determined, (...)."""
        return 0.5 * solving.log_determinant(self.lower)

    @property
    def matrix(self) -> Stack:
        """The roots as matrices."""
        return Stack(self.lower)

    @property
    def precisions(self) -> list[Array]:
        """The diagonals of the inverses: one over each component's variance given all others."""
        eye = np.broadcast_to(_identity(self.lower.shape[-1]), self.lower.shape)
        white = self.solve(Stack(eye)).array
        return list(np.moveaxis(np.einsum("...ij,...ij->...j", white, white), -1, 0))

    def left(self, right: Stack) -> Array:
        """The size of what earlier components leave of a vector b in determined ones, (..., n)."""
        rest = solving.solve_lower(self.lower, right.array)[..., 0]
        return np.where(self.fixed, np.abs(rest), 0.0)

    def solve(self, right: Stack) -> Stack:
        """The X with L X = B."""
        found = solving.solve_lower(self.lower, right.array)
        if self.fixed.any():
            found = np.where(self.fixed[..., None], 0.0, found)
        if self._lost is not None:
            found[self._lost] = np.broadcast_to(right.array, found.shape)[self._lost]
        return Stack(found)

    def solve_transposed(self, right: Stack) -> Stack:
        """The X with Lᵀ X = B."""
        found = solving.solve_upper(self.lower, right.array)
        if self._lost is not None:
            assert self._matrix is not None
            lost, cov = self._lost, np.broadcast_to(self._matrix, self.lower.shape)
            found[lost] = transpose(solving.regression(transpose(right.array[lost]), cov[lost]))
        return Stack(found)


class RegularRoot:
    """The roots L of positive definite matrices A = L Lᵀ, (..., n, n), by LAPACK, and their L⁻¹.

    Of a few small matrices that is sooner found than by lines of Python. LinAlgError where a matrix
    is not positive definite.
    """

    def __init__(self, matrix: Stack) -> None:
        self._matrix, self._lower = matrix.array, np.linalg.cholesky(matrix.array)
        self._inverse = Stack(np.linalg.inv(self._lower))
        self._pivots = np.diagonal(self._lower, axis1=-2, axis2=-1)

    @cached_property
    def share(self) -> Array:
        """The least part of a diagonal entry that is left to a pivot, (...)."""
        entries = np.diagonal(self._matrix, axis1=-2, axis2=-1)
        found: Array = (self._pivots * self._pivots / entries).min(axis=-1)
        return found

    @property
    def volume(self) -> Array:
        """The logarithms of |L|, (...)."""
        found: Array = np.log(self._pivots).sum(axis=-1)
        return found

    def solve(self, right: Stack) -> Stack:
        """The X with L X = B."""
        return self._inverse @ right

    def solve_transposed(self, right: Stack) -> Stack:
        """The X with Lᵀ X = B."""
        return self._inverse.T @ right


class KnownRoot:
    """The root L of a matrix A = L Lᵀ, or the roots of many, of which L⁻¹ is known."""

    def __init__(self, inverse: Runs | Stack) -> None:
        self.inverse = inverse

    def solve(self, right: Any) -> Any:
        """The X with L X = B."""
        return self.inverse @ right
