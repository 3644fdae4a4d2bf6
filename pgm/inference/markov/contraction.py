"""Sums of a product of tables over the variables of two slices, one table after another.

A *contraction* multiplies an array by the tables of CPDs, and sums over all variables but those
that are wanted: for a forward message the array is the belief over the states before, the tables
are p(child | parents), and the wanted variables are those of the slice.

The order of the tables is found once for a model: next comes the table after which the array is
smallest. A variable is summed out with the last table that has it. If a table has a single parent,
which no other table has, it can be a *map*: a matrix that is applied along that parent's axis,
which becomes the child's. So states that move independently of one another never make an array over
their pairs.

A variable is told by its *label*, an integer. A *factor* is a table, as an array of its entries or
as a map (`Move`); the matrix of a map is a `Transition`. An axis in brackets, [runs], may be
absent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import Semiring
from pgm.kernels.stochastic import Transition

# A variable of the pair of slices, by number: see `SlicePlan.labels`.
Label = int


class Move(NamedTuple):
    """A table p(child | parent), to be applied as a matrix: along the parent's or the child's axis.

    maps: Pairs (matrix, the indices (k,) of the runs it is for); each run is in one pair. Where one
        matrix is for all runs there is one pair, with None in place of indices.
    """

    maps: tuple[tuple[Transition, Integers | None], ...]


# The table of a CPD at a step: an array, with a last axis of runs if it differs by run; or a map.
Factor = Array | Move


class Step(NamedTuple):
    """The multiplication by one table, and sums over the variables that are not needed any more.

    A variable is needed as long as it is in a later table or in the result.

    factor: The index of the table among those of the contraction.
    labels: The variables of the table: parents, child.
    before, after: The variables of the array's axes before and after the step.
    axis: The axis along which the table is applied as a map; None where it is multiplied as a
        table.
    """

    factor: int
    labels: tuple[Label, ...]
    before: tuple[Label, ...]
    after: tuple[Label, ...]
    axis: int | None


class Contraction(NamedTuple):
    """A plan of sums: the steps that lead from an array over some variables to one over others.

    steps: The multiplications, in turn.
    summed: The axes of the first array that are summed out before the steps: their variables are in
        no table and not wanted.
    spread: Of each wanted variable that neither the array nor a table has, the number of states.
        After the steps each of these variables gets an axis, behind those of the other variables,
        along which the array is constant.
    order: The permutation for `transpose` that comes last: axis i of the result is axis
        ``order[i]`` of the array after the steps and `spread`.
    back: Whether maps are applied from the child to the parent, as their transposes.
    largest: The number of entries, in one run, of the largest array that a step leaves.
    """

    steps: tuple[Step, ...]
    summed: tuple[int, ...]
    spread: tuple[int, ...]
    order: tuple[int, ...]
    back: bool
    largest: int

    @property
    def along(self) -> frozenset[int]:
        """The indices of the tables that are applied as maps: `apply` takes a `Move` for each."""
        return frozenset(step.factor for step in self.steps if step.axis is not None)

    @classmethod
    def of(
        cls,
        first: Sequence[Label],
        last: Sequence[Label],
        tables: Sequence[tuple[Label, ...]],
        sizes: Mapping[Label, int],
        maps: Sequence[bool],
        *,
        back: bool = False,
    ) -> Contraction:
        """The contraction of an array over `first` to one over `last`, its order of tables found.

        first, last: The variables of the axes of the array that is given, and of the result.
        tables: The variables of each table: parents, child.
        sizes: The number of states of each variable.
        maps: Of each table whether it may be a map along an axis.
        back: Whether the children are summed out, not the parents.
        """
        known = {label for table in tables for label in table}
        summed = tuple(k for k, x in enumerate(first) if x not in known and x not in last)
        array = tuple(x for k, x in enumerate(first) if k not in summed)
        waiting, steps = dict(enumerate(tables)), []
        while waiting:
            found = [cls._step(k, array, waiting, last, maps[k], back) for k in waiting]
            best = min(found, key=lambda step: math.prod(sizes[x] for x in step.after))
            steps.append(best)
            array = best.after
            del waiting[best.factor]
        new = tuple(x for x in last if x not in array)
        order = tuple((*array, *new).index(x) for x in last)
        spread = tuple(sizes[x] for x in new)
        largest = max((math.prod(sizes[x] for x in step.after) for step in steps), default=1)
        return cls(tuple(steps), summed, spread, order, back, largest)

    @staticmethod
    def _step(
        factor: int,
        array: tuple[Label, ...],
        waiting: Mapping[int, tuple[Label, ...]],
        last: Sequence[Label],
        map_: bool,
        back: bool,
    ) -> Step:
        """The step that multiplies one table in: as a map along an axis, or as a table.

        array: The variables of the array's axes before the step.
        waiting: The variables of each table still to come, table `factor` included.
        last: The wanted variables.
        map_: Whether the table may be a map. It becomes one if it has two variables, the array has
            its parent but not its child, and neither the result nor another table needs the parent.
            With `back` parent and child change places.
        """
        labels = waiting[factor]
        needed = {x for k, table in waiting.items() if k != factor for x in table} | set(last)
        own, new = (labels[-1], labels[0]) if back else (labels[0], labels[-1])
        if map_ and len(labels) == 2 and own in array and own not in needed and new not in array:
            axis = array.index(own)
            after = (*array[:axis], new, *array[axis + 1 :])
            return Step(factor, labels, array, after, axis)
        joined = dict.fromkeys((*array, *labels))
        return Step(factor, labels, array, tuple(x for x in joined if x in needed), None)

    def apply(self, array: Array, factors: Sequence[Factor], semiring: Semiring) -> Array:
        """The product of an array and the tables, summed over all variables that are not wanted.

        array: (sizes..., further axes..., [runs]), with the sizes of the variables `first` of which
            the contraction was made (`of`); all axes behind them are kept.
        factors: Of each table its entries in the semiring, or, at the indices in `along`, its map.
        """
        if self.summed:
            array = semiring.total(array, self.summed, None)
        for step in self.steps:
            factor = factors[step.factor]
            if isinstance(factor, Move):
                assert step.axis is not None
                array = moved(factor, array, step.axis, semiring, back=self.back)
            else:
                array = _multiplied(step, array, factor, semiring)
        if self.spread:
            own = len(self.order) - len(self.spread)
            before, behind = array.shape[:own], array.shape[own:]
            wide = array.reshape(*before, *(1,) * len(self.spread), *behind)
            array = np.broadcast_to(wide, (*before, *self.spread, *behind))
        if self.order != tuple(range(len(self.order))):
            array = array.transpose(*self.order, *range(len(self.order), array.ndim))
        return array


def moved(move: Move, array: Array, axis: int, semiring: Semiring, *, back: bool) -> Array:
    """An array with one of its axes transformed by the `Transition` of each run.

    The axis of the parent's states becomes one of the child's states, or, if `back`, an axis of the
    child's states one of the parent's. If runs have different transitions, the array's last axis is
    that of runs.
    """
    if move.maps[0][1] is None:
        return _mapped(move.maps[0][0], array, axis, semiring, back)
    parts: list[Array] = []
    places = []
    for each, runs in move.maps:
        parts.append(_mapped(each, array[..., runs], axis, semiring, back))
        places.append(runs)
    found = np.concatenate(parts, axis=-1)
    return found[..., np.argsort(np.concatenate([p for p in places if p is not None]))]


def _mapped(each: Transition, array: Array, axis: int, semiring: Semiring, back: bool) -> Array:
    """An array multiplied by the matrix `each` along one axis, or, if `back`, by its transpose.

    In a semiring of logarithms the array has logarithms, and so has the result.
    """
    if not semiring.linear:
        return each.logs(array, axis, semiring, back=back)
    return each.backward(array, axis) if back else each.forward(array, axis)


def _multiplied(step: Step, array: Array, table: Array, semiring: Semiring) -> Array:
    """The product of an array and a table, summed over the variables that a step sums out.

    The array has the axes ``step.before``, the table ``step.labels`` and the result ``step.after``,
    each with further axes behind these, which are kept.
    """
    if semiring.linear:
        operands: list[Any] = [array, [*step.before, ...], table, [*step.labels, ...]]
        found: Array = np.einsum(*operands, [*step.after, ...], optimize=True)
        return found
    gone = [x for x in dict.fromkeys((*step.before, *step.labels)) if x not in step.after]
    axes = (*step.after, *gone)
    behind = max(array.ndim - len(step.before), table.ndim - len(step.labels))
    one = _spread(array, step.before, axes, behind)
    joint = one + _spread(table, step.labels, axes, behind)
    if not gone:
        return joint
    return semiring.total(joint, tuple(range(len(step.after), len(axes))), None)


def _spread(array: Array, labels: Sequence[Label], axes: Sequence[Label], behind: int) -> Array:
    """An array over `labels`, with an axis for each variable of `axes`, then `behind` more axes.

    The axis of a variable not in `labels` has length one. If the array has fewer than `behind` axes
    after those of `labels`, axes of length one are put before these.
    """
    own, rest = array.shape[: len(labels)], array.shape[len(labels) :]
    array = array.reshape((*own, *(1,) * (behind - len(rest)), *rest))
    present = [x for x in axes if x in labels]
    order = [labels.index(x) for x in present]
    turned = array.transpose(*order, *range(len(labels), array.ndim))
    missing = tuple(k for k, x in enumerate(axes) if x not in labels)
    return np.expand_dims(turned, missing)
