"""Types and small operations for stacks of vectors (..., n) and of matrices (..., m, n).

A stack lies *by runs* where each entry (i, j) of its matrices is a row in memory, contiguous over
the runs, or over steps and runs, while the axes stay (..., m, n). Products of many small matrices
then go along these rows, which is faster than one product a matrix.

Other arrays have the components first and the *batch*, any number of axes, mostly that of runs,
last: vectors (n, *batch) and matrices (m, n, *batch).
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import addressof, c_char
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Integers = npt.NDArray[np.intp]
Kind = TypeVar("Kind", bound=np.generic)
# Where some components stand in a longer vector; a slice, where they stand together, makes views.
Index = slice | Integers

LOG_2PI = float(np.log(2.0 * np.pi))
# Two solutions of one model differ by no more than this part of a mean, of long chains either.
LAST_PLACES = 32.0 * float(np.finfo(np.float64).eps)
# From this many matrices on, going along rows of runs beats one product a matrix.
_MANY = 32
_FAR = _MANY * np.dtype(np.float64).itemsize


def stacked(lead: tuple[int, ...], shape: tuple[int, ...]) -> Array:
    """Zeros of shape (*lead, *shape), in memory with the last axis of `lead`, the runs, fastest.

    Kernels go along contiguous rows of runs; element-wise results and `multiply` keep that layout.
    """
    *before, runs = lead
    return np.zeros((*before, *shape, runs)).transpose(_order(len(before), len(shape)))


def vacant(lead: tuple[int, ...], shape: tuple[int, ...]) -> Array:
    """An uninitialised array (*lead, *shape), in memory with the last axis of `lead` fastest."""
    *before, runs = lead
    return np.empty((*before, *shape, runs)).transpose(_order(len(before), len(shape)))


@lru_cache(maxsize=64)
def _order(before: int, own: int) -> tuple[int, ...]:
    """The axes of an array whose last one is moved behind its first `before`, `own` being between.

    With them `transpose` takes a tenth of the time of `moveaxis`.
    """
    return (*range(before), before + own, *range(before, before + own))


def address(array: npt.NDArray[Any]) -> int:
    """Where an array's memory begins, for machine code."""
    if array.flags.carray and array.size:  # which takes a fifth of the time
        return addressof(c_char.from_buffer(array.data))
    found: int = array.__array_interface__["data"][0]
    return found


def holds(mask: Mask) -> bool:
    """Whether a mask is true everywhere."""
    # A few bytes are searched in a quarter of the time that `all` takes.
    return b"\0" not in mask.tobytes()


def is_finite(array: Array) -> bool:
    """Whether all numbers are finite."""
    return b"\0" not in np.isfinite(array).tobytes()


def components_last(array: npt.NDArray[Kind], own: int) -> npt.NDArray[Kind]:
    """A view of an array with its first `own` axes, those of components, moved behind the batch.

    With `own` = 2, (n, n, *batch) becomes (*batch, n, n), the order in which users see arrays.
    """
    axes = array.ndim
    if axes == own:
        return array
    found: npt.NDArray[Kind] = array.transpose(_turned(axes, own))
    return found


def components_first(array: npt.NDArray[Kind], own: int) -> npt.NDArray[Kind]:
    """A view of an array with its last `own` axes, those of components, moved before the batch.

    With `own` = 2, (*batch, n, n) becomes (n, n, *batch), the order that kernels of one step take.
    """
    axes = array.ndim
    if axes == own:
        return array
    found: npt.NDArray[Kind] = array.transpose(_turned(axes, axes - own))
    return found


@lru_cache(maxsize=64)
def _turned(axes: int, first: int) -> tuple[int, ...]:
    """The axes of an array whose `first` ones are moved behind the others."""
    return (*range(first, axes), *range(first))


def times(matrix: Array, vector: Array) -> Array:
    """Matrix times vector, components first: (d, n, *batch) and (n, *batch) give (d, *batch)."""
    product: Array
    product = (
        matrix.dot(vector) if matrix.ndim == 2 else np.einsum("ij...,j...->i...", matrix, vector)
    )
    return product


def within(cov: Array, places: Index) -> Array:
    """The covariances (k, k, *batch) of the k components `places` within `cov` (n, n, *batch)."""
    return cov[places][:, places]


def block_diagonal(blocks: Array) -> Array:
    """The block-diagonal matrices (k d, k d, *batch) of blocks (k, d, d, *batch)."""
    count, size, _, *batch = blocks.shape
    if count == 1:
        only: Array = blocks[0]
        return only
    each = np.arange(count)
    joint = np.zeros((count, size, count, size, *batch))
    joint[each, :, each] = blocks
    whole: Array = joint.reshape(count * size, count * size, *batch)
    return whole


def transpose(matrix: Array) -> Array:
    """The matrices (..., m, n) transposed, (..., n, m), as a view."""
    return matrix.swapaxes(-1, -2)


def by_runs(matrix: Array) -> bool:
    """Whether a stack lies by runs in memory, with 32 or more numbers in each row."""
    if matrix.size < _MANY:
        return False
    (height, width), (down, across) = matrix.shape[-2:], matrix.strides[-2:]
    return (width == 1 or across >= _FAR) and (height == 1 or down >= _FAR)


def room(lead: tuple[int, ...], shape: tuple[int, ...]) -> Array:
    """An uninitialised array (*lead, *shape), in memory with all axes of `lead` fastest."""
    own = len(shape)
    memory = np.empty((*shape, *lead))
    return memory.transpose(*range(own, memory.ndim), *range(own))


def multiply(a: Array, b: Array) -> Array:
    """The products A B, (..., m, n), of stacked matrices A (..., m, k) and B (..., k, n).

    They are computed along the runs where A or B lies by runs.
    """
    many_a, many_b = by_runs(a), by_runs(b)
    if not (many_a or many_b):
        return a @ b
    if many_b and b.ndim == 3 and (one := distinct(a)).ndim == 2:
        return transpose(_times_one(transpose(b), one))
    if many_a and a.ndim == 3 and (one := distinct(b)).ndim == 2:
        return _times_one(a, transpose(one))
    return _along_runs("...ij,...jk->...ik", a, b, b.shape[-1])


def times_transposed(a: Array, b: Array) -> Array:
    """The products A Bᵀ, (..., m, n), of stacked matrices A (..., m, k) and B (..., n, k).

    This is the fastest product where both are in C order, or both lie by runs.
    """
    many_a, many_b = by_runs(a), by_runs(b)
    if many_a and many_b:
        return _along_runs("...ij,...kj->...ik", a, b, b.shape[-2])
    if many_a or many_b:
        return multiply(a, transpose(b))
    return a @ np.ascontiguousarray(transpose(b))


def times_symmetric(a: Array, b: Array) -> Array:
    """The products A B, (..., m, n), of A (..., m, n) and symmetric B (..., n, n).

    They are computed as A Bᵀ where both lie by runs, which is faster.
    """
    return times_transposed(a, b) if by_runs(a) and by_runs(b) else multiply(a, b)


def _along_runs(product: str, a: Array, b: Array, width: int) -> Array:
    """A product of stacked matrices A and B by einsum, with its leading axes fastest in memory.

    `width` is the number of columns of the result, which has as many rows as A. `product` has the
    subscripts of the einsum, which say whether B is transposed.
    """
    lead, other = a.shape[:-2], b.shape[:-2]
    if lead != other:
        lead = np.broadcast_shapes(lead, other)
    # Left to itself, einsum lays out the product of a constant and of many as the constant is.
    out = room(lead, (a.shape[-2], width))
    result: Array = np.einsum(product, a, b, out=out)
    return result


def distinct(matrix: Array) -> Array:
    """The one matrix (m, n) of which a stack (R, m, n) is a broadcast view; else the stack."""
    return matrix[0] if matrix.ndim == 3 and matrix.strides[0] == 0 else matrix


def _times_one(many: Array, one: Array) -> Array:
    """The products A Bᵀ, (R, m, k), of R matrices A (R, m, n) and one matrix B (k, n).

    They are computed as m products of B with a matrix (n, R).
    """
    product: Array = one @ many.transpose(1, 2, 0)
    return product.transpose(2, 0, 1)


def apply(matrix: Array, vector: Array) -> Array:
    """Matrix times vector, stacked: (..., d, n) and (..., n) give (..., d)."""
    if vector.size < 256:
        return (matrix @ vector[..., None])[..., 0]
    product: Array = np.einsum("...ij,...j->...i", matrix, vector)  # twice as fast for many
    return product


def inner(a: Array, b: Array) -> Array:
    """The inner products (...) of stacked vectors (..., n)."""
    product: Array = np.einsum("...i,...i->...", a, b)
    return product


def variances(cov: Array) -> Array:
    """The diagonals of stacked matrices, (..., n), as a read-only view."""
    found: Array = np.diagonal(cov, axis1=-2, axis2=-1)
    return found


def deviation(cov: Array) -> Array:
    """The standard deviations (..., n) of covariances (..., n, n); zero for negative variances."""
    return np.sqrt(np.maximum(variances(cov), 0.0))


def symmetric(matrix: Array) -> Array:
    """The matrices (A + Aᵀ) / 2, (..., n, n), without the asymmetry that rounding has left in A."""
    return 0.5 * (matrix + transpose(matrix))


def make_symmetric(matrix: Array) -> Array:
    """Matrices (..., n, n) made exactly symmetric, where rounding has left them nearly so.

    The result is (A + Aᵀ) / 2; where A lies by runs, its upper triangle is copied onto the lower
    one instead, in place.
    """
    if not by_runs(matrix):
        return symmetric(matrix)
    for j in range(1, matrix.shape[-1]):
        matrix[..., j, :j] = matrix[..., :j, j]
    return matrix


def sandwich(factor: Array, matrix: Array) -> Array:
    """The matrices F P Fᵀ, (..., d, d), for F (..., d, n) and symmetric P (..., n, n)."""
    return times_transposed(times_symmetric(factor, matrix), factor)


def as_index(positions: npt.ArrayLike) -> Index:
    """Positions as a slice where they are consecutive, else as an array."""
    array = np.asarray(positions, dtype=np.intp)
    first = int(array[0]) if array.size else 0
    if np.array_equal(array, np.arange(first, first + array.size)):
        return slice(first, first + array.size)
    return array


def block(matrix: Array, rows: Index, columns: Index) -> Array:
    """The blocks of matrices (..., m, n) at some rows and columns; a view where both are slices."""
    if isinstance(rows, slice) or isinstance(columns, slice):
        return matrix[..., rows, :][..., columns]
    return matrix[..., rows[:, None], columns]


def independent(cov: Array, seen: Mask) -> Array:
    """Covariances (..., n, n) in which components that `seen` does not mark are independent.

    `seen` (..., n) marks the components whose variances and covariances stay. Each other component
    gets the variance one and no covariance, so that it adds a known constant to a log-density.
    """
    return np.where(seen[..., None] & seen[..., None, :], cov, np.eye(cov.shape[-1]))


def tiled(array: npt.NDArray[Kind], count: int, *, alone: bool = False) -> npt.NDArray[Kind]:
    """An array (rows, runs or 1, ...) of so many copies of the runs, one after another.

    An axis of runs of length one stands for all runs: the array is then returned whole, unless its
    one run stands `alone`.
    """
    whole = array.shape[1] == 1 and not alone
    return array if whole else np.concatenate([array] * count, axis=1)


def cut(array: npt.NDArray[Kind], runs: Index, axis: int = 1) -> npt.NDArray[Kind]:
    """An array cut to the runs `runs` along `axis`, its axis of runs: a view if they are a slice.

    An axis of runs of length one stands for all runs: the array is then returned whole.
    """
    return array if array.shape[axis] == 1 else array[(slice(None),) * axis + (runs,)]


def length(runs: Index) -> int:
    """How many runs there are of an index, whose slice has a start and a stop."""
    found: int = runs.stop - runs.start if isinstance(runs, slice) else len(runs)
    return found


def quiet() -> np.errstate:
    """A context in which overflow and undefined results become infinity or NaN, with no warning."""
    return np.errstate(all="ignore")


def may_hold(mask: Mask) -> bool:
    """Whether a mask is true somewhere; one of traced numbers, which are still to come, may be."""
    return mask.dtype == object or bool(mask.any())


def frozen(array: Array) -> Array:
    """A read-only view, safe to hand out."""
    view = array.view()
    view.flags.writeable = False
    return view


def unravelled(index: Integers, shape: Sequence[int]) -> tuple[Integers, ...]:
    """The indices along each axis, (...) each, of flat indices (...) into an array of `shape`.

    NumPy's own function is wrong for more than 8,192 indices whose last axis has length one.
    """
    if np.ndim(index) < 2:
        return np.unravel_index(index, shape)
    return tuple(k.reshape(index.shape) for k in np.unravel_index(index.reshape(-1), shape))


def ranks(labels: Integers) -> Integers:
    """How many labels (n,) before each equal it, (n,)."""
    order = np.argsort(labels, kind="stable")
    ranked = labels[order]
    found = np.empty_like(order)
    found[order] = np.arange(order.size) - np.searchsorted(ranked, ranked)
    return found
