"""Moves of mixtures: the sum of the moves of a mixture's parts, weighted by their probabilities.

A window is a span of cells along each axis; arrays are over the cells of a window. A `Step` is a
move of some states to a time step, made of operators: linear maps of the probabilities in a source
window to those in a target window. Where a move has less variance than its rounding to whole cells
needs, the lattice adds the rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from pgm.beliefs.grid.densities import EVEN, Dense, Uneven
from pgm.beliefs.grid.groups import Members
from pgm.beliefs.grid.lattice import Lattice, Window, spanned
from pgm.beliefs.grid.moves import Operator, Split
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.lattice import Span


@dataclass(frozen=True, eq=False)
class Step:
    """A move to a time step: operators applied in order, from a source to a target window."""

    source: Window
    target: Window
    operators: Sequence[Operator | Mixed]

    @property
    def split(self) -> frozenset[int]:
        """The axes moved by a `Split`, which spreads each cell over those nearest to its target."""
        each = [operator.axes for _, operator in self.leaves() if isinstance(operator, Split)]
        return frozenset().union(*each)

    @property
    def uneven(self) -> Uneven:
        """The operators' transition density whose sums over centres vary the most: an `Uneven`.

        The record has its share, its child and its step. The share is by how much the sums, which
        should be one, vary as the centres shift within a cell, times the probability of the
        mixture's part that has the density. Without any density the share is 0, the child None.
        """
        each = [
            operator.uneven._replace(share=weight * operator.uneven.share)
            for weight, operator in self.leaves()
            if isinstance(operator, Dense)
        ]
        return max(each, key=lambda found: found.share, default=EVEN)

    def leaves(self) -> Iterator[tuple[float, Operator]]:
        """All operators, mixtures taken apart, each as a pair (probability, operator).

        The probability is that of the mixture's part to which the operator belongs, or 1 outside
        mixtures. For a part of a mixture within a mixture it is the product of both probabilities.
        """
        for operator in self.operators:
            if isinstance(operator, Mixed):
                for weight, step in zip(operator.weights.tolist(), operator.steps, strict=True):
                    yield from ((weight * share, leaf) for share, leaf in step.leaves())
            else:
                yield 1.0, operator

    def forward(self, array: Array) -> tuple[Array, Array]:
        """The probabilities in the target window, and the variance that the lattice has added.

        The latter is along each axis, in squared cells, (axes,).
        """
        added = np.zeros(len(self.source))
        for operator in self.operators:
            if isinstance(operator, Mixed):
                array, more = operator.moved(array)
                added += more
                continue
            for axis, variance in operator.added(array).items():
                added[axis] += variance
            array = operator.forward(array)
        return array, added

    def backward(self, array: Array) -> Array:
        """The transpose: a backward message in the source window, from one in the target window."""
        for operator in reversed(self.operators):
            array = operator.backward(array)
        return array

    def sources(self, array: Array, places: Integers, rng: np.random.Generator) -> Integers:
        """Source cells drawn given target cells, through one operator after another, as places."""
        before = [array]
        for operator in self.operators[:-1]:
            if isinstance(operator, Mixed):
                before.append(operator.moved(before[-1])[0])
            else:
                before.append(operator.forward(before[-1]))
        for operator, own in zip(reversed(self.operators), reversed(before), strict=False):
            places = operator.sources(own, places, rng)
        return places


@dataclass(frozen=True, eq=False)
class Mixed:
    """The move by a mixture: the weighted sum of the moves by its parts, from the same window.

    weights: The probabilities of the parts, (parts,).
    steps: The move by each part.
    target: The window that contains the target windows of all these moves.
    """

    lattice: Lattice
    weights: Array
    steps: Sequence[Step]
    target: Window

    def moved(self, array: Array) -> tuple[Array, Array]:
        """The probabilities in the target window, and the variance that the lattice has added.

        The latter is along each axis, in squared cells, (axes,), averaged over the parts by their
        probabilities.
        """
        total, added = np.zeros([span.length for span in self.target]), np.zeros(array.ndim)
        for weight, step in zip(self.weights, self.steps, strict=True):
            part, more = step.forward(array)
            total[self._of(step)] += weight * part
            added += weight * more
        return total, added

    def backward(self, array: Array) -> Array:
        """The transpose: a backward message in the source window, from one in the target window."""
        parts = [
            weight * step.backward(array[self._of(step)])
            for weight, step in zip(self.weights, self.steps, strict=True)
        ]
        total: Array = np.sum(parts, axis=0)
        return total

    def sources(self, array: Array, places: Integers, rng: np.random.Generator) -> Integers:
        """Source cells drawn given target cells, each through a part that it came by, as places.

        Each part in turn takes over a draw by its share of the probability that the parts so far
        bring to the target cell.
        """
        found, total = places.copy(), np.zeros(places.shape[1])
        cells = np.array([axis.cells for axis in self.lattice.axes])[:, None]
        first = np.array([span.first for span in self.target])[:, None]
        for weight, step in zip(self.weights, self.steps, strict=True):
            start, length = (np.array(each)[:, None] for each in zip(*step.target, strict=True))
            own = (places + first - start) % cells
            inside = (own < length).all(axis=0)
            part, _ = step.forward(array)
            share = np.zeros(len(total))
            share[inside] = weight * part[tuple(own[:, inside])]
            total += share
            chosen = rng.random(len(total)) * total < share
            found[:, chosen] = step.sources(array, own[:, chosen], rng)
        return found

    def _of(self, step: Step) -> tuple[Integers, ...]:
        """The index of the target window of `step`, a part's move, in an array over `target`."""
        each = [
            (np.arange(own.length) + own.first - span.first) % axis.cells
            for own, span, axis in zip(step.target, self.target, self.lattice.axes, strict=True)
        ]
        return np.ix_(*each)


@dataclass(frozen=True, eq=False)
class MixedGroup(Members):
    """A group of one state whose CPD is a mixture, moved as the weighted sum of its parts' moves.

    parts: A group of that state alone for each part of the mixture.
    weights: The probabilities of the parts, (parts,).
    """

    parts: tuple[Members, ...] = ()
    weights: Array = field(default_factory=lambda: np.ones(1))

    def mixed(self, steps: Sequence[Step]) -> Mixed:
        """The sum of the moves by the parts, weighted by the parts' probabilities.

        `steps` are these moves, in the order of `parts`, all from the same source window. The sum's
        target is the smallest window that contains the targets of all of them.
        """
        target = []
        for k, axis in enumerate(self.lattice.axes):
            target.append(_around([step.target[k] for step in steps], axis.cells, axis.angle))
        return Mixed(self.lattice, self.weights, steps, tuple(target))


def _around(spans: Sequence[Span], cells: int, periodic: bool) -> Span:
    """The shortest span that covers all `spans`, on a line or (`periodic`) a circle of `cells`."""
    if all(span == spans[0] for span in spans):
        return spans[0]
    if not periodic:
        first = min(span.first for span in spans)
        return Span(first, max(span.first + span.length for span in spans) - first)
    used = np.zeros(cells, dtype=bool)
    for span in spans:
        used[np.arange(span.first, span.first + span.length) % cells] = True
    return spanned(used, periodic)
