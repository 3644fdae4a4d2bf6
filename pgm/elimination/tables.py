"""The algebra of tables: products of arrays, and sums or maxima over their axes.

A table is an array with an axis for each variable of its scope, then a *tail*: further axes that
are kept, the last of them that of runs. Tails broadcast with one another, from their last axes on,
so that a table that all runs share may lack the axis of runs, or have it of length one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pgm.elimination.carry_out import Algebra
from pgm.elimination.plan import Label, Scope, Step
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import Semiring
from pgm.kernels.stochastic import Transition

# A table of at least so many entries is summed over one axis after the other: summed over several
# axes at once, its inner loops are as short as its last axes.
LONG = 2**8
# From so many entries of a product on it is made as one of matrices, which are turned for it.
MATRICES = 2**15
# The first axes of a table, by how many they are: NumPy's arrays have up to 64.
FIRST = [tuple(range(count)) for count in range(65)]
# How many labels einsum has: the numbers from 0 on, of variables and of axes of the tail.
LETTERS = 52


class Move(NamedTuple):
    """A table p(child | parent), to be applied as a matrix: along the parent's or the child's axis.

    maps: Pairs (matrix, the indices (k,) of the runs it is for); each run is in one pair. Where one
        matrix is for all runs there is one pair, with None in place of indices.
    """

    maps: tuple[tuple[Transition, Integers | None], ...]

    def along(self, array: Array, axis: int, semiring: Semiring, *, back: bool) -> Array:
        """An array with one of its axes transformed by the matrix of each run.

        The axis of the parent's states becomes one of the child's states, or, if `back`, an axis of
        the child's states one of the parent's. If runs have different matrices, the array's last
        axis is that of runs.
        """
        if self.maps[0][1] is None:
            return _mapped(self.maps[0][0], array, axis, semiring, back)
        parts: list[Array] = []
        places = []
        for each, runs in self.maps:
            parts.append(_mapped(each, array[..., runs], axis, semiring, back))
            places.append(runs)
        found = np.concatenate(parts, axis=-1)
        return found[..., np.argsort(np.concatenate([p for p in places if p is not None]))]


# A factor of a chain of tables: its entries, or a matrix to be applied.
Entries = Array | Move


def _mapped(each: Transition, array: Array, axis: int, semiring: Semiring, back: bool) -> Array:
    """An array multiplied by the matrix `each` along one axis, or, if `back`, by its transpose.

    In a semiring of logarithms the array has logarithms, and so has the result.
    """
    if not semiring.linear:
        return each.logs(array, axis, semiring, back=back)
    return each.backward(array, axis) if back else each.forward(array, axis)


class TableAlgebra(Algebra[Any]):
    """Products and sums of tables, or maxima, as a semiring has them.

    sizes: Of each variable, its number of states; 1 if its axes have that length.
    scaled: Whether each result is divided by its largest entry in each run, where entries are
        numbers: then only ratios matter, and long products stay in float64's range.
    aligned: The number of tail axes of all tables, where the variables of all of them, and of the
        plan's steps, stand in one order; None where tables have to be turned, and tails differ.
    watched: Whether underflow is to be noticed, by an error if NumPy is told to raise it. Products
        are made by whole then, before they are summed, where entries are numbers.
    """

    def __init__(
        self,
        semiring: Semiring,
        sizes: Mapping[Label, int] | Sequence[int],
        *,
        scaled: bool = False,
        aligned: int | None = None,
        watched: bool = True,
    ) -> None:
        self.semiring, self.sizes, self.aligned = semiring, sizes, aligned
        self.scaled = scaled and semiring.linear
        self.fused = semiring.linear and not watched

    def product(self, step: Step, factors: Sequence[Array]) -> Array:
        """The product of a step's tables, (size of each variable of the scope..., tail).

        It may be a view of a table, which must not be written to.
        """
        scope, times, aligned, sizes = step.scope, self.semiring.times, self.aligned, self.sizes
        if aligned is None:
            pairs = zip(factors, step.scopes, strict=True)
            tail = max([table.ndim - len(own) for table, own in pairs])
        found: Array | None = None
        for table, own in zip(factors, step.scopes, strict=True):
            if aligned is None:
                table = over(table, own, scope, tail)
            elif len(own) < len(scope):
                shape = [sizes[x] if x in own else 1 for x in scope]
                table = table.reshape([*shape, *table.shape[len(own) :]] if aligned else shape)
            found = table if found is None else times(found, table)
        assert found is not None
        return found

    def total(self, product: Array, scope: Scope, left: Scope) -> Array:
        """The sum of a table to some of its variables, in the order that they have in the table."""
        count, total = len(scope) - len(left), self.semiring.total
        if not count:
            return product
        if scope[count:] == left:
            if product.size < LONG:
                return total(product, FIRST[count])
            # One axis of all that is summed out.
            return total(product.reshape(-1, *product.shape[count:]), 0)
        gone = [axis for axis, x in enumerate(scope) if x not in left]
        if product.size < LONG or not self.semiring.linear:
            return total(product, tuple(gone))
        for lost, axis in enumerate(gone):
            product = total(product, axis - lost)
        return product

    def made(self, step: Step, factors: Sequence[Any]) -> Array:
        """The result of a step: of a map, along its axis; else a product that is summed."""
        if step.axis >= 0:
            array, move = factors
            (*_, child), axis = step.scopes[1], step.axis
            back = step.scopes[0][axis] == child
            moved: Array = move.along(array, axis, self.semiring, back=back)
            return moved
        if self.fused and len(factors) == 2:
            tail = max([table.ndim - len(s) for table, s in zip(factors, step.scopes, strict=True)])
            if len(step.scope) + tail <= LETTERS:
                return self._fused(step, factors)
        found = self.total(self.product(step, factors), step.scope, step.left)
        if self.scaled:
            axes = tuple(range(len(step.left)))
            found = found / np.maximum.reduce(found, axes)
        return found

    def _fused(self, step: Step, factors: Sequence[Array]) -> Array:
        """The sum of a product of two tables, which is not held by itself."""
        scopes, left = step.scopes, step.left
        if max(step.scope, default=0) >= LETTERS:
            letter = {x: k for k, x in enumerate(step.scope)}
            scopes = tuple([tuple([letter[x] for x in own]) for own in scopes])
            left = tuple([letter[x] for x in left])
        (a, b), sizes = factors, self.sizes
        entries = math.prod([sizes[x] for x in step.scope])
        tail = a.shape[len(scopes[0]) :]
        large = entries * (tail[-1] if tail else 1) >= MATRICES
        operands: list[Any] = [a, [*scopes[0], ...], b, [*scopes[1], ...], [*left, ...]]
        found: Array = np.einsum(*operands, optimize=large)
        return found

    def arranged(self, factor: Array, scope: Scope, wanted: Scope) -> Array:
        """A table with its axes in the order wanted; it is constant along those that are new."""
        tail = factor.ndim - len(scope)
        found = over(factor, scope, wanted, tail)
        if len(scope) == len(wanted):
            return found
        sizes = self.sizes
        full = tuple([sizes[x] for x in wanted])
        return np.broadcast_to(found, full + found.shape[len(full) :])

    def joint(self, step: Step, product: Array, total: Array, outside: Array | None) -> Array:
        """The joint of a step's variables; see `Algebra.joint`."""
        semiring, scope, left = self.semiring, step.scope, step.left
        found: Array
        # Sums over the first axes are slow where memory has another order than "C".
        if outside is None:
            found = semiring.over(product, total, order="C")
            return found
        if not semiring.linear or np.count_nonzero(total) < total.size:
            total = semiring.divisor(total)  # where it is zero the joint outside is, too
        ratio = semiring.over(outside, total)
        if scope[len(scope) - len(left) :] != left:
            ratio = over(ratio, left, scope, product.ndim - len(scope))
        found = semiring.times(product, ratio, order="C")
        return found


def over(table: Array, own: Scope, scope: Scope, tail: int) -> Array:
    """A view of a table over `own` with an axis for each variable of `scope`, then `tail` axes.

    Axes of variables that the table lacks have length one, and so have those that its tail lacks,
    which stand first in it.
    """
    if own == scope and table.ndim == len(own) + tail:
        return table
    given, count = table.shape, len(own)
    shape, k = [], 0
    for x in scope:
        if k < count and own[k] == x:
            shape.append(given[k])
            k += 1
        else:
            shape.append(1)
    if k < count:  # in another order
        order = [own.index(x) for x in scope if x in own]
        turned = table.transpose(*order, *range(count, len(given)))
        return over(turned, tuple([own[k] for k in order]), scope, tail)
    rest = given[count:]
    return table.reshape((*shape, *(1,) * (tail - len(rest)), *rest))
