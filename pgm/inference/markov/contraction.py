"""Sums of a product of tables over the slices of a step, one table after another.

The order is found once for a model: each table is multiplied in where the array that is left after
summing is smallest, and a variable is summed out with the last table that has it. A table of a
single parent that no other table has is a linear map along that parent's axis, so that states that
move independently of each other never make pairs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import Semiring
from pgm.kernels.stochastic import Transition

# A variable of the pair of slices, by its place.
Label = int


class Move(NamedTuple):
    """A map along an axis, of all runs or of some each.

    maps: Maps and the runs of each; None for all.
    """

    maps: tuple[tuple[Transition, Integers | None], ...]


# The table of a CPD at a step: with its axes, and one of runs where it differs by run; or a map.
Factor = Array | Move


class Step(NamedTuple):
    """The multiplication by one table, and the sums that it makes possible.

    labels: The variables of the table: parents, child.
    """

    factor: int
    labels: tuple[Label, ...]
    before: tuple[Label, ...]
    after: tuple[Label, ...]
    axis: int | None


class Contraction(NamedTuple):
    """The steps from an array over some variables to one over others.

    summed: Axes of the first array that no table has, summed out before.
    spread: Lengths of axes that no table has, along which the last array is constant.
    order: The axes of the last array, those it is spread along behind the others, in the order
        wanted.
    back: Whether maps go from the child to the parent.
    largest: Entries of the largest array on the way.
    """

    steps: tuple[Step, ...]
    summed: tuple[int, ...]
    spread: tuple[int, ...]
    order: tuple[int, ...]
    back: bool
    largest: int

    @property
    def along(self) -> frozenset[int]:
        """The tables that are maps along an axis."""
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
        """Order the tables.

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
        """One table of the product: a map along an axis where it is one, else a sum over what goes.

        A table of two variables whose parent nothing else needs moves the axis of that parent: it
        need not be laid out as a table. `waiting` are the tables still to come, `last` the
        variables that stay.
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
        """The sum of an array times tables; axes behind its own, the last one of runs, are kept."""
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
    """An array with one axis moved by a map, or by one for each of some runs."""
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
    """A transition along one axis of an array, of probabilities or of logarithms."""
    if not semiring.linear:
        return each.logs(array, axis, semiring, back=back)
    return each.backward(array, axis) if back else each.forward(array, axis)


def _multiplied(step: Step, array: Array, table: Array, semiring: Semiring) -> Array:
    """The product of an array and a table, summed over the variables that go."""
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
    """An array with an axis for each of some variables, and some behind, of length one if new."""
    own, rest = array.shape[: len(labels)], array.shape[len(labels) :]
    array = array.reshape((*own, *(1,) * (behind - len(rest)), *rest))
    present = [x for x in axes if x in labels]
    order = [labels.index(x) for x in present]
    turned = array.transpose(*order, *range(len(labels), array.ndim))
    missing = tuple(k for k, x in enumerate(axes) if x not in labels)
    return np.expand_dims(turned, missing)
