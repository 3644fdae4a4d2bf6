"""Types and small operations for stacks of vectors and matrices."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Integers = npt.NDArray[np.intp]
# Where some components stand in a longer vector; a slice, where they stand together, makes views.
Index = slice | Integers

LOG_2PI = float(np.log(2.0 * np.pi))
# From this many matrices on, going along rows of runs beats one product a matrix.
_MANY = 32


def stacked(lead: tuple[int, ...], shape: tuple[int, ...]) -> Array:
    """Zeros (*lead, *shape) in memory with the last leading axis, of runs, fastest.

    Kernels then go along contiguous rows of runs, one component at a time; results of element-wise
    operations and of `multiply` keep that layout.
    """
    *before, runs = lead
    memory = np.zeros((*before, *shape, runs))
    return np.moveaxis(memory, -1, len(before))


def transpose(matrix: Array) -> Array:
    """Swap the last two axes."""
    return matrix.swapaxes(-1, -2)


def multiply(a: Array, b: Array) -> Array:
    """A B, stacked; along rows of runs where those are contiguous in memory."""
    if _by_runs(a) or _by_runs(b):
        product: Array = np.einsum("...ij,...jk->...ik", a, b)
        return product
    return a @ b


def times_transposed(a: Array, b: Array) -> Array:
    """A Bᵀ; stacks of small matrices multiply faster where both are contiguous."""
    if _by_runs(a) or _by_runs(b):
        product: Array = np.einsum("...ij,...kj->...ik", a, b)
        return product
    return a @ np.ascontiguousarray(transpose(b))


def _by_runs(matrix: Array) -> bool:
    """Whether the last leading axis is contiguous in memory, as in `stacked`, and long."""
    return matrix.ndim > 2 and matrix.shape[-3] >= _MANY and matrix.strides[-3] == matrix.itemsize


def apply(matrix: Array, vector: Array) -> Array:
    """Matrix times vector, stacked: (..., d, n) and (..., n) give (..., d)."""
    if vector.size < 256:
        return (matrix @ vector[..., None])[..., 0]
    product: Array = np.einsum("...ij,...j->...i", matrix, vector)  # twice as fast for many
    return product


def inner(a: Array, b: Array) -> Array:
    """Inner product of stacked vectors, (...)."""
    product: Array = np.einsum("...i,...i->...", a, b)
    return product


def deviation(cov: Array) -> Array:
    """Standard deviations, (..., n); zero where rounding has left a variance below zero."""
    return np.sqrt(np.maximum(np.diagonal(cov, axis1=-2, axis2=-1), 0.0))


def symmetric(matrix: Array) -> Array:
    """The symmetric part, which removes what rounding made of a symmetric product."""
    return 0.5 * (matrix + transpose(matrix))


def sandwich(factor: Array, matrix: Array) -> Array:
    """F P Fᵀ."""
    return times_transposed(multiply(factor, matrix), factor)


def as_index(positions: npt.ArrayLike) -> Index:
    """Positions as a slice where they are consecutive, else as an array."""
    array = np.asarray(positions, dtype=np.intp)
    first = int(array[0]) if array.size else 0
    if np.array_equal(array, np.arange(first, first + array.size)):
        return slice(first, first + array.size)
    return array


def block(matrix: Array, rows: Index, columns: Index) -> Array:
    """The block of a stacked matrix at some rows and columns; a view where both are slices."""
    if isinstance(rows, slice) or isinstance(columns, slice):
        return matrix[..., rows, :][..., columns]
    return matrix[..., rows[:, None], columns]


def frozen(array: Array) -> Array:
    """A read-only view, for values that are handed out."""
    view = array.view()
    view.flags.writeable = False
    return view
