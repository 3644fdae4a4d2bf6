"""On which axes of a lattice functions depend: tested at its centres, not assumed.

A function takes n points of the step before and n points of its own step, both (n, axes), and has m
values for each pair. A value depends on the axes `before` of the step before, and on the axes
`after` of its own step. A window is a span of cells along each axis.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Set
from dataclasses import dataclass, field

import numpy as np

from pgm.beliefs.grid.lattice import Lattice, Window
from pgm.kernels.arrays import Array, Integers, Mask

# Places at which every call is tested; all centres are, when something is first depended on.
PROBES = 128
# Cells of the belief's window at which a known dependence is tried: of a motion in each step, and
# of a sensor with each measurement.
MOVED = 4096
MEASURED = 512
# Centres that a user's function is handed at a time where all are tested.
BLOCK = 1 << 16
_TRIES = 3


def places(lattice: Lattice, count: int, seed: int) -> Integers:
    """A random sample of a lattice's cells, with replacement: their places, (count, axes)."""
    return np.random.default_rng(seed).integers(0, lattice.shape, (count, len(lattice.axes)))


def within(lattice: Lattice, window: Window, most: int, seed: int) -> Integers:
    """A random sample of `most` of a window's cells, or all if there are no more, (n, axes).

    The sample is with replacement; cells are given by their places on the lattice.
    """
    lengths = [span.length for span in window]
    count = math.prod(lengths)
    flat = np.arange(count)
    if count > most:
        flat = np.random.default_rng(seed).integers(0, count, most)
    first = np.array([span.first for span in window])
    found: Integers = (np.stack(np.unravel_index(flat, lengths), axis=-1) + first) % lattice.shape
    return found


def blocks(lattice: Lattice) -> Iterator[Integers]:
    """Yield all cells of a lattice, by their places (n, axes), in blocks of n ≤ 2^16."""
    for first in range(0, lattice.size, BLOCK):
        flat = np.arange(first, min(first + BLOCK, lattice.size))
        yield np.stack(np.unravel_index(flat, lattice.shape), axis=-1)


def centres(lattice: Lattice, cells: Integers) -> Array:
    """The coordinates (n, axes) of the centres of n cells, given by their places (n, axes)."""
    return lattice.points(list(cells.T))


class Reduced:
    """A table of a function over the axes on which it depends; the others stay at their middle.

    axes: The axes on which the function depends; sorted, as an attribute.
    values: As an argument the function, from points (n, axes) to values (n, ...); as an attribute
        the table, (cells along `axes`, ...), flat in their order.
    shape: The number of cells along each of the `axes`.
    """

    def __init__(
        self, lattice: Lattice, axes: Iterable[int], values: Callable[[Array], Array]
    ) -> None:
        self.axes = sorted(axes)
        self.shape = [lattice.shape[k] for k in self.axes]
        count, found = math.prod(self.shape), []
        middle = np.array(lattice.shape) // 2
        for first in range(0, count, BLOCK):
            flat = np.arange(first, min(first + BLOCK, count))
            cells = np.repeat(middle[None], len(flat), axis=0)
            if self.axes:
                cells[:, self.axes] = np.stack(np.unravel_index(flat, self.shape), axis=-1)
            found.append(values(centres(lattice, cells)))
        self.values = np.concatenate(found)

    def at(self, cells: Integers) -> Array:
        """The values (n, ...) at cells (n, axes); (1, ...) if the function depends on no axis."""
        if not self.axes:
            return self.values[:1]
        flat = np.ravel_multi_index(tuple(cells[:, self.axes].T), self.shape)
        found: Array = self.values[flat]
        return found


@dataclass(eq=False)
class Dependence:
    """The record of the axes on which each of m values of a function depends, as far as tested.

    The function is tested at the centres of a lattice. Axes are only added: a dependence found at
    one step is taken to hold at all steps, and the function is probed anew at every step.

    before: The axes of the step before, a set for each value; empty before the first `look`.
    after: The axes of its own step, likewise.
    _sure: Whether the dependence has been tested at every centre.

    Arguments of several methods are:

    values: The function, from points (n, axes) of the step before and of its own to values (n,
        ..., m).
    differ: A function of two results of `values`, to the mask (n, ..., m) of entries that differ.
    later: The axes of its own step on which it may depend at all.
    seed: The seed of the cells that are drawn.
    """

    lattice: Lattice
    before: list[set[int]] = field(default_factory=list)
    after: list[set[int]] = field(default_factory=list)
    _sure: bool = False

    def look(
        self,
        values: Callable[[Array, Array], Array],
        differ: Callable[[Array, Array], Mask],
        later: frozenset[int],
        seed: int,
        some: Integers | None = None,
    ) -> None:
        """Probe a function at a step, and add the axes on which its values are found to depend.

        It is probed at random cells. The known dependence is then tested at every centre if this is
        the first call, if the probe has found a new axis, or if the dependence fails at the cells
        `some`. Where that test fails, all centres are searched for further axes, twice at the most.
        If it still fails, as where differences too small to be seen add up, each value is taken to
        depend on all axes that it may depend on.

        some: Cells (n, axes) of the belief, at which the known dependence is tested too; None for
            no such test.
        """
        sure = not self._probed(values, differ, later, seed) and self._sure
        if sure and some is not None:
            sure = self._holds(values, differ, later, seed, some)
        if not sure:
            tries = 0
            while not self._holds(values, differ, later, seed):
                tries += 1
                if tries < _TRIES:
                    self._probed(values, differ, later, seed + tries, everywhere=True)
                else:  # differences that add up
                    self.before = [set(range(len(self.lattice.axes))) for _ in self.before]
                    self.after = [set(later) for _ in self.after]
            self._sure = True

    def reduced(self, cells: Integers, depended: Set[int]) -> Integers:
        """Cells (n, axes) moved to the lattice's middle along all axes but those depended on."""
        middle = np.array(self.lattice.shape) // 2
        keep = np.array([k in depended for k in range(len(middle))])
        return np.where(keep, cells, middle)

    def _probed(
        self,
        values: Callable[[Array, Array], Array],
        differ: Callable[[Array, Array], Mask],
        later: frozenset[int],
        seed: int,
        everywhere: bool = False,
    ) -> bool:
        """Whether an axis is found on which a value was not known to depend; such axes are added.

        At random cells, or at all of them (`everywhere`), each axis of the step before, and each of
        its own step that may be depended on (`later`), is moved to another cell; a value that
        differs depends on that axis.
        """
        lattice, grown = self.lattice, False
        sets = blocks(lattice) if everywhere else iter([places(lattice, PROBES, seed)])
        for here in sets:
            there = places(lattice, len(here), seed + 1)
            other = places(lattice, len(here), seed + 2)
            base, own = centres(lattice, here), centres(lattice, other)
            pairs = [(base, own)]
            for k in range(len(lattice.axes)):
                moved = base.copy()
                moved[:, k] = lattice.axes[k].centres[there[:, k]]
                pairs.append((moved, own))
            for k in sorted(later):
                moved = own.copy()
                moved[:, k] = lattice.axes[k].centres[there[:, k]]
                pairs.append((base, moved))
            found = values(*(np.concatenate(each) for each in zip(*pairs, strict=True)))
            first, *rest = np.split(found, len(pairs))
            if not self.before:
                self.before = [set() for _ in range(found.shape[-1])]
                self.after = [set() for _ in range(found.shape[-1])]
            owners = [(self.before, k) for k in range(len(lattice.axes))]
            owners += [(self.after, k) for k in sorted(later)]
            for (owner, k), changed in zip(owners, rest, strict=True):
                different = differ(changed, first).reshape(-1, first.shape[-1])
                for m in np.flatnonzero(different.any(axis=0)):
                    grown = grown or k not in owner[m]
                    owner[m].add(k)
        return grown

    def _holds(
        self,
        values: Callable[[Array, Array], Array],
        differ: Callable[[Array, Array], Mask],
        later: frozenset[int],
        seed: int,
        cells: Integers | None = None,
    ) -> bool:
        """Whether each value stays the same without the axes on which it is not known to depend.

        Cells are moved to the middle of the lattice along these axes. This is tested at `cells` (n,
        axes), or, if they are None, at every centre.
        """
        lattice = self.lattice
        kinds = {(frozenset(a), frozenset(b)) for a, b in zip(self.before, self.after, strict=True)}
        kinds = {pair for pair in kinds if len(pair[0]) < len(lattice.axes) or pair[1] < later}
        tables = (
            {}
            if later or cells is not None
            else {
                before: Reduced(lattice, before, lambda points: values(points, points))
                for before, _ in kinds
            }
        )
        sets = blocks(lattice) if cells is None else iter([cells])
        for here in sets if kinds else ():
            other = places(lattice, len(here), seed + 3) if later else here
            found = values(centres(lattice, here), centres(lattice, other))
            for before, after in kinds:
                if before in tables:
                    few = tables[before].at(here)
                else:
                    base = centres(lattice, self.reduced(here, before))
                    few = values(base, centres(lattice, self.reduced(other, after)))
                own = set(before), set(after)
                of = [pair == own for pair in zip(self.before, self.after, strict=True)]
                if differ(few, found)[..., of].any():
                    return False
        return True
