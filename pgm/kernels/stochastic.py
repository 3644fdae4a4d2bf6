"""Matrices of p(child | parent) as linear maps: dense, sparse, and Kronecker products of both.

A map is applied along one axis of an array, for all other axes at once: `forward`, an axis of
parents becomes one of children; `backward`, one of children becomes one of parents. `logs` does
either (the second if `back` is true) for logarithms: its semiring's sum, ln Σ exp or the maximum,
takes the place of the sum over parents or children. Of an array of parents' states, `draw` returns
a state of the child for each, in an array of the same shape. Of m children's states, `parents`
returns the columns p(child | ·) as an array (m, parents).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from pgm.kernels.arrays import Array, Integers, unravelled
from pgm.kernels.semirings import Semiring

# Entries of the sums of pairs that `Dense.logs` holds at a time.
_CHUNK = 2**22


class Transition(ABC):
    """The matrix of p(child | parent), of shape (parents, children), as a map along an axis."""

    shape: tuple[int, int]

    @abstractmethod
    def forward(self, belief: Array, axis: int = 0) -> Array:
        """Σ_parent p(child | parent) belief(parent), along an axis of parents."""

    @abstractmethod
    def backward(self, message: Array, axis: int = 0) -> Array:
        """Σ_child p(child | parent) message(child), along an axis of children."""

    @abstractmethod
    def logs(self, values: Array, axis: int, semiring: Semiring, *, back: bool = False) -> Array:
        """The logarithms of the result of `forward`, or, if `back`, of `backward`.

        `values` are ln belief or ln message, with parents or children along `axis`. `semiring` is a
        semiring of logarithms; its sum, ln Σ exp or the maximum, takes the place of Σ.
        """

    @abstractmethod
    def entries(self, parent: Integers, child: Integers) -> Array:
        """The probabilities p(child | parent) of pairs of state indices that broadcast."""

    @abstractmethod
    def draw(self, parent: Integers, rng: np.random.Generator) -> Integers:
        """Child states drawn from p(child | parent), of the shape of the parents' state indices."""

    @abstractmethod
    def parents(self, children: Integers) -> Array:
        """The columns p(child | ·) of m children (m,), as rows over all parents, (m, parents)."""

    @property
    @abstractmethod
    def smallest(self) -> float:
        """The smallest positive entry, but at most 1; 1 if no entry is positive."""

    @abstractmethod
    def dense(self) -> Array:
        """The whole matrix as an array, (parents, children)."""


class Dense(Transition):
    """A dense matrix (parents, children); its transpose is copied once, for products along rows."""

    def __init__(self, matrix: Array) -> None:
        self.matrix = np.ascontiguousarray(matrix)
        self.shape = self.matrix.shape

    @cached_property
    def turned(self) -> Array:
        """The transpose (children, parents), in C order."""
        turned: Array = np.ascontiguousarray(self.matrix.T)
        return turned

    @cached_property
    def _logarithms(self) -> Array:
        """The logarithms of the entries, (parents, children)."""
        with np.errstate(divide="ignore"):
            logs: Array = np.log(self.matrix)
        return logs

    def forward(self, belief: Array, axis: int = 0) -> Array:
        """Apply the transition matrix to probabilities along an axis; see `Transition.forward`."""
        return _along(self.turned, belief, axis)

    def backward(self, message: Array, axis: int = 0) -> Array:
        """Apply the transposed matrix to messages along an axis; see `Transition.backward`."""
        return _along(self.matrix, message, axis)

    def logs(self, values: Array, axis: int, semiring: Semiring, *, back: bool = False) -> Array:
        """Apply the matrix to logarithms along an axis, in pieces that fit into the memory.

        See `Transition.logs`.
        """
        own = self._logarithms if back else self._logarithms.T
        moved = np.moveaxis(values, axis, 0)
        flat = moved.reshape(len(moved), -1)
        found = np.empty((len(own), flat.shape[1]))
        size = max(1, _CHUNK // max(flat.size, 1))
        for at in range(0, len(own), size):
            pairs = own[at : at + size, :, None] + flat
            semiring.total(pairs, 1, out=found[at : at + size])
        return np.moveaxis(found.reshape(len(own), *moved.shape[1:]), 0, axis)

    def entries(self, parent: Integers, child: Integers) -> Array:
        """The probabilities p(child | parent) of pairs of indices that broadcast."""
        found: Array = self.matrix[parent, child]
        return found

    @cached_property
    def _cumulative(self) -> Array:
        """The cumulative probabilities along each row, (parents, children)."""
        return np.cumsum(self.matrix, axis=-1)

    def draw(self, parent: Integers, rng: np.random.Generator) -> Integers:
        """Child states drawn by bisection of cumulative probabilities; see `Transition.draw`."""
        cumulative = self._cumulative
        # A uniform below one, times the last sum, stays below it, so that what rounding leaves of
        # the sum from one goes to no state of its own.
        level = rng.random(parent.shape) * cumulative[parent, -1]
        low = np.zeros(parent.shape, dtype=np.intp)
        high = np.full(parent.shape, self.shape[1] - 1)
        for _ in range((self.shape[1] - 1).bit_length()):
            middle = (low + high) // 2
            above = cumulative[parent, middle] > level
            low, high = np.where(above, low, middle + 1), np.where(above, middle, high)
        return low

    def parents(self, children: Integers) -> Array:
        """The columns p(child | ·) of some children; see `Transition.parents`."""
        found: Array = self.turned[children]
        return found

    @cached_property
    def smallest(self) -> float:
        """The smallest positive entry; at most 1."""
        return float(self.matrix.min(where=self.matrix > 0.0, initial=1.0))

    def dense(self) -> Array:
        """The whole matrix, (parents, children)."""
        return self.matrix


class Sparse(Transition):
    """A SciPy sparse matrix (parents, children), copied by rows (CSR) without its stored zeros."""

    def __init__(self, matrix: Any) -> None:
        own = matrix.tocsr(copy=True)
        own.sum_duplicates()
        own.eliminate_zeros()
        self.matrix = own
        self.shape = own.shape

    @cached_property
    def turned(self) -> Any:
        """The transpose (children, parents), a sparse matrix by rows."""
        return self.matrix.T.tocsr()

    def forward(self, belief: Array, axis: int = 0) -> Array:
        """Apply the transition matrix to probabilities along an axis; see `Transition.forward`."""
        return _along(self.turned, belief, axis)

    def backward(self, message: Array, axis: int = 0) -> Array:
        """Apply the transposed matrix to messages along an axis; see `Transition.backward`."""
        return _along(self.matrix, message, axis)

    def logs(self, values: Array, axis: int, semiring: Semiring, *, back: bool = False) -> Array:
        """Apply the matrix to logarithms along an axis; see `Transition.logs`.

        For each k in turn the k-th stored entries of all rows are added at once. The rows are those
        of the transpose, or with `back` those of the matrix itself.
        """
        own = self.matrix if back else self.turned
        moved = np.moveaxis(values, axis, 0)
        flat = moved.reshape(len(moved), -1)
        found = np.full((own.shape[0], flat.shape[1]), -np.inf)
        counts = np.diff(own.indptr)
        for k in range(counts.max(initial=0)):
            rows = np.flatnonzero(counts > k)
            entry = own.indptr[rows] + k
            pair = np.log(own.data[entry])[:, None] + flat[own.indices[entry]]
            found[rows] = semiring.total(np.stack([found[rows], pair]), 0)
        return np.moveaxis(found.reshape(own.shape[0], *moved.shape[1:]), 0, axis)

    def entries(self, parent: Integers, child: Integers) -> Array:
        """The probabilities p(child | parent) of pairs of indices that broadcast."""
        parent, child = np.broadcast_arrays(parent, child)
        if not parent.size:  # of which SciPy makes an array of another shape
            return np.zeros(parent.shape)
        found = np.asarray(self.matrix[parent.ravel(), child.ravel()])
        return found.reshape(parent.shape)

    @cached_property
    def _levels(self) -> Array:
        """For each stored entry, the index of its row plus the cumulative probability in the row.

        The array (entries,) therefore ascends over all rows, so that one search in it draws the
        children of many parents.
        """
        own = self.matrix
        rows = np.repeat(np.arange(own.shape[0]), np.diff(own.indptr))
        sums = np.cumsum(own.data)
        before = np.concatenate([[0.0], sums])[own.indptr[:-1]]
        total = np.asarray(own.sum(axis=1)).ravel()
        levels: Array = rows + np.minimum((sums - before[rows]) / total[rows], 1.0)
        return levels

    def draw(self, parent: Integers, rng: np.random.Generator) -> Integers:
        """Child states drawn by one search in the `_levels` of all rows; see `Transition.draw`."""
        level = parent + rng.random(parent.shape)
        entry = np.searchsorted(self._levels, level, side="right")
        own = self.matrix
        # What rounding leaves of a row's sum from one goes to its last entry.
        entry = np.clip(entry, own.indptr[parent], own.indptr[parent + 1] - 1)
        found: Integers = own.indices[entry].astype(np.intp)
        return found

    def parents(self, children: Integers) -> Array:
        """The columns p(child | ·) of some children; see `Transition.parents`."""
        found: Array = self.turned[children].toarray()
        return found

    @cached_property
    def smallest(self) -> float:
        """The smallest positive entry; at most 1."""
        return float(self.matrix.data.min(initial=1.0))

    def dense(self) -> Array:
        """The whole matrix, (parents, children)."""
        found: Array = self.matrix.toarray()
        return found


class Product(Transition):
    """The Kronecker product of maps: the state has several axes, and each factor acts on one axis.

    States are numbered by flat indices, in C order of their indices along the axes: a state of the
    parents has an axis for each factor, of the lengths `before`, and so has a state of the
    children, of the lengths `after`.
    """

    def __init__(self, factors: Sequence[Transition]) -> None:
        self.factors = tuple(factors)
        self.before = tuple(factor.shape[0] for factor in factors)
        self.after = tuple(factor.shape[1] for factor in factors)
        self.shape = math.prod(self.before), math.prod(self.after)

    def forward(self, belief: Array, axis: int = 0) -> Array:
        """Apply each factor along its own axis of the parents; see `Transition.forward`."""
        found = self._split(belief, axis, self.before)
        for k, factor in enumerate(self.factors):
            found = factor.forward(found, axis + k)
        return self._joined(found, belief, axis, self.shape[1])

    def backward(self, message: Array, axis: int = 0) -> Array:
        """Apply each transposed factor along its own axis; see `Transition.backward`."""
        found = self._split(message, axis, self.after)
        for k, factor in enumerate(self.factors):
            found = factor.backward(found, axis + k)
        return self._joined(found, message, axis, self.shape[0])

    def logs(self, values: Array, axis: int, semiring: Semiring, *, back: bool = False) -> Array:
        """Apply each factor to logarithms along its own axis; see `Transition.logs`."""
        found = self._split(values, axis, self.after if back else self.before)
        for k, factor in enumerate(self.factors):
            found = factor.logs(found, axis + k, semiring, back=back)
        return self._joined(found, values, axis, self.shape[0 if back else 1])

    @staticmethod
    def _split(values: Array, axis: int, sizes: tuple[int, ...]) -> Array:
        """An array with its axis of flat states made into one axis for each factor, of `sizes`."""
        return values.reshape(*values.shape[:axis], *sizes, *values.shape[axis + 1 :])

    @staticmethod
    def _joined(found: Array, like: Array, axis: int, size: int) -> Array:
        """An array with the factors' axes, from `axis` on, made into one of `size` flat states.

        All remaining axes are those that `like` has before and after its axis `axis`.
        """
        return found.reshape(*like.shape[:axis], size, *like.shape[axis + 1 :])

    def entries(self, parent: Integers, child: Integers) -> Array:
        """The probabilities p(child | parent) of pairs of indices: products over the factors."""
        parents, children = self._parts(parent, child)
        found = np.ones(np.broadcast_shapes(np.shape(parent), np.shape(child)))
        for factor, a, b in zip(self.factors, parents, children, strict=True):
            found = found * factor.entries(a, b)
        return found

    def _parts(self, parent: Integers, child: Integers) -> tuple[Any, Any]:
        """The indices along the factors' axes that flat indices mean, an array for each factor.

        The first tuple returned is that of the parents' indices, the second that of the children's.
        """
        return unravelled(parent, self.before), unravelled(child, self.after)

    def draw(self, parent: Integers, rng: np.random.Generator) -> Integers:
        """Child states drawn axis by axis, each by its own factor; see `Transition.draw`."""
        parents = unravelled(parent, self.before)
        drawn = [f.draw(own, rng) for f, own in zip(self.factors, parents, strict=True)]
        found: Integers = np.ravel_multi_index(drawn, self.after)
        return found

    def parents(self, children: Integers) -> Array:
        """The columns p(child | ·) of some children; see `Transition.parents`."""
        found = np.ones((len(children), 1))
        for factor, own in zip(self.factors, unravelled(children, self.after), strict=True):
            pairs = found[:, :, None] * factor.parents(own)[:, None, :]
            found = pairs.reshape(len(children), -1)
        return found

    @cached_property
    def smallest(self) -> float:
        """The smallest positive entry: the product of the factors' smallest ones."""
        return math.prod(factor.smallest for factor in self.factors)

    def dense(self) -> Array:
        """The whole matrix, (parents, children): the Kronecker product of the factors' matrices."""
        found: Array = self.factors[0].dense()
        for factor in self.factors[1:]:
            found = np.asarray(np.kron(found, factor.dense()), dtype=np.float64)
        return found


def _along(matrix: Any, values: Array, axis: int) -> Array:
    """The array `values` with its axis `axis`, of length n, multiplied by a matrix (k, n).

    That axis of the result has the length k. The matrix is dense or sparse. Dense products leave
    the array as it lies in memory; a sparse matrix needs the axis first.
    """
    if values.ndim == 1:
        product: Array = matrix.dot(values)
        return product
    if isinstance(matrix, np.ndarray):
        before, after = values.shape[:axis], values.shape[axis + 1 :]
        stacked = values.reshape(math.prod(before), values.shape[axis], math.prod(after))
        product = matrix.dot(stacked[0]) if axis == 0 else np.matmul(matrix, stacked)
        return product.reshape(*before, len(matrix), *after)
    moved = np.moveaxis(values, axis, 0)
    flat = np.ascontiguousarray(moved.reshape(len(moved), -1))
    product = np.asarray(matrix @ flat).reshape(matrix.shape[0], *moved.shape[1:])
    return np.moveaxis(product, 0, axis)
