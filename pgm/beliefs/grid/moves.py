"""Operators that move probabilities on a lattice, and their exact transposes.

An operator turns an array of the probabilities at the cells of a source window into one at those of
a target window; probability that leaves an interval is lost. A window is a span of cells along each
axis. Displacements are in cells, variances in squared cells. A kernel is the distribution of a
displacement over whole numbers of cells; its weights are called taps. On a lattice a displacement
whose fractional part is f has at least the variance f(1 − f): where its own variance s² is less,
the lattice adds f(1 − f) − s². Noise that several displacements share is summed over the nodes of a
quadrature, each with a weight; the weights sum to one.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from pgm.kernels.arrays import Array, Integers
from pgm.kernels.lattice import Span, along, matrices
from pgm.kernels.stochastic import Dense

# The largest variance, in squared cells, of the three points that a displacement is split on.
SPLIT = 0.25
# So many weights of cells are drawn by at a time.
_AT_A_TIME = 2**22


class Operator(Protocol):
    """A linear map of the probabilities in a source window to those in a target window."""

    def forward(self, array: Array) -> Array:
        """The probabilities in the target window, from those in the source window."""
        ...

    def backward(self, array: Array) -> Array:
        """The transposed operator: from a message in the target window to one in the source's."""
        ...

    def added(self, array: Array) -> dict[int, float]:
        """By axis, the variance that the lattice adds, in squared cells.

        It is averaged over the source cells by `array`, their probabilities.
        """
        ...

    def sources(self, array: Array, places: Integers, rng: np.random.Generator) -> Integers:
        """Source cells drawn given target cells, by Bayes' rule, as places (axes, draws).

        Cells are given by their places along the axes of the windows. `array` are the probabilities
        of the source cells: p(source | target) ∝ p(source) p(target | source). A target cell has to
        be one that probability moves to.
        """
        ...


@dataclass(frozen=True, eq=False)
class Move:
    """A move along one axis, by a kernel for each cell of the axes on which its shift depends.

    axis: The index of the axis that is moved.
    by: The other axes on which the displacement depends, ascending; G is the number of the window's
        cells along these.
    first: The displacement, in whole cells, of each kernel's first weight: (nodes or 1, G, 1), or
        (nodes or 1, G, source cells) where it depends on the place along the moved axis too.
    weights: The kernels, (*first.shape, taps).
    added: The variance that the lattice adds, in squared cells, (nodes or 1, G, 1 or source cells).
    source, target: The span of the moved axis before and after.
    cells: The number of cells of the axis; a circle is `periodic`.
    """

    axis: int
    by: tuple[int, ...]
    first: Integers
    weights: Array
    added: Array
    source: Span
    target: Span
    cells: int
    periodic: bool

    @property
    def varies(self) -> bool:
        """Whether the kernels differ from node to node of the quadrature."""
        return len(self.first) > 1

    def matrix(self, node: int) -> Array:
        """The kernels of a node as matrices, (G, target cells, source cells)."""
        return self._only if not self.varies else self._at(node)

    @cached_property
    def _only(self) -> Array:
        """The matrices (G, target cells, source cells) of a move that is the same at all nodes."""
        return self._at(0)

    def _at(self, node: int) -> Array:
        """Make the matrices of a node's kernels, (G, target cells, source cells)."""
        return matrices(
            self.first[node],
            self.weights[node],
            self.source,
            self.target,
            self.cells,
            self.periodic,
        )

    def mean_added(self, array: Array, nodes: Array) -> float:
        """The variance that the lattice adds along the moved axis, in squared cells.

        It is averaged over `array`, the probabilities of the source cells, and over the nodes of
        the quadrature by their weights, `nodes` (nodes,). Where an earlier move has changed the
        window, so that `array` does not fit, all cells count alike.
        """
        if not self.added.any():
            return 0.0
        each = np.einsum("ngk,n->gk", self.added, nodes if self.varies else np.ones(1))
        kept = self.by + ((self.axis,) if each.shape[1] > 1 else ())
        others = tuple(k for k in range(array.ndim) if k not in kept)
        marginal = array.sum(axis=others).transpose(np.argsort(np.argsort(kept)))
        if marginal.size != each.size:  # the window has changed by an earlier move
            return float(each.mean())
        return float((each * marginal.reshape(each.shape)).sum() / max(marginal.sum(), 1e-300))

    def forward(self, array: Array, node: int = 0) -> Array:
        """The probabilities after the move along one axis, at a node of the quadrature."""
        return along(self.matrix(node), array, self.axis, self.by)

    def backward(self, array: Array, node: int = 0) -> Array:
        """The transposed move, of a backward message, at a node of the quadrature."""
        return along(self.matrix(node).swapaxes(-1, -2), array, self.axis, self.by)

    def sources(
        self, array: Array, places: Integers, rng: np.random.Generator, node: int = 0
    ) -> Integers:
        """Source cells drawn given target cells, at a node of the quadrature; see `Operator`."""
        matrix = self.matrix(node)
        lines = np.moveaxis(array, self.axis, -1)
        others = np.delete(places, self.axis, axis=0)
        group = np.zeros(places.shape[1], dtype=np.intp)
        for axis in self.by:
            group = group * array.shape[axis] + places[axis]
        found = places.copy()
        for some in blocks(places.shape[1], self.source.length):
            weights = matrix[group[some], places[self.axis, some]] * lines[tuple(others[:, some])]
            found[self.axis, some] = picked(weights, rng)
        return found


@dataclass(frozen=True, eq=False)
class Sweep:
    """An operator of moves along one axis after another, averaged over nodes of a quadrature.

    moves: The moves M_1 to M_K, in order; the operator is Σₙ wₙ M_K(n) … M_1(n), n being a node.
    nodes: The weights wₙ of the nodes, (nodes,), of sum one.
    """

    moves: Sequence[Move]
    nodes: Array

    def forward(self, array: Array) -> Array:
        """The probabilities after all moves, averaged over the nodes; see `Operator`."""
        return self._run(array, self.moves, lambda move, node, part: move.forward(part, node))

    def backward(self, array: Array) -> Array:
        """The transposed moves in reverse order, for backward messages; see `Operator`."""
        last_first = self.moves[::-1]
        return self._run(array, last_first, lambda move, node, part: move.backward(part, node))

    def added(self, array: Array) -> dict[int, float]:
        """By axis, the variance that the lattice adds, in squared cells.

        It is averaged over the source cells by `array`, their probabilities.
        """
        return {move.axis: move.mean_added(array, self.nodes) for move in self.moves}

    def _run(
        self, array: Array, moves: Sequence[Move], apply: Callable[[Move, int, Array], Array]
    ) -> Array:
        """The weighted sum over nodes of one move after another: Σₙ wₙ M_K(n) … M_1(n) array.

        moves: M_1 to M_K, in the order in which they are applied.
        apply: Applies one move, at a node, to an array, forwards or backwards.

        Moves at the beginning and at the end of the sequence that are the same at all nodes are
        made once, outside the sum.
        """
        start, end = _varying(moves)
        for move in moves[:start]:
            array = apply(move, 0, array)
        if start < end:
            total: Array | None = None
            for node, weight in enumerate(self.nodes):
                part = array
                for move in moves[start:end]:
                    part = apply(move, node, part)
                total = weight * part if total is None else total + weight * part
            assert total is not None
            array = total
        for move in moves[end:]:
            array = apply(move, 0, array)
        return array

    def sources(self, array: Array, places: Integers, rng: np.random.Generator) -> Integers:
        """Source cells drawn given target cells, through one move after another; see `Operator`.

        Where moves differ from node to node, a node is drawn with them: each in turn takes over a
        draw by its share of the probability that the nodes so far bring to the target cell.
        """
        start, end = _varying(self.moves)
        first, last = self.moves[:start], self.moves[end:]
        head = _passed(array, first, 0)
        middle = self.moves[start:end]
        if not middle:
            return _traced(head, first, 0, places, rng)
        parts = (_passed(head[-1], middle, node)[-1] for node in range(len(self.nodes)))
        whole = sum(weight * part for weight, part in zip(self.nodes, parts, strict=True))
        places = _traced(_passed(np.asarray(whole), last, 0), last, 0, places, rng)
        found, total = places.copy(), np.zeros(places.shape[1])
        for node, weight in enumerate(self.nodes):
            arrays = _passed(head[-1], middle, node)
            share = weight * arrays[-1][tuple(places)]
            total += share
            own = rng.random(len(total)) * total < share
            found[:, own] = _traced(arrays, middle, node, places[:, own], rng)
        return _traced(head, first, 0, found, rng)


def _varying(moves: Sequence[Move]) -> tuple[int, int]:
    """The first move that differs from node to node, and the one after the last; none at the end.

    Moves that are the same at all nodes are made once, before those that differ, or after.
    """
    differ = [k for k, move in enumerate(moves) if move.varies]
    return (differ[0], differ[-1] + 1) if differ else (len(moves), len(moves))


def _passed(array: Array, moves: Sequence[Move], node: int) -> list[Array]:
    """The probabilities before each of some moves, at a node, and after all of them."""
    found = [array]
    for move in moves:
        found.append(move.forward(found[-1], node))
    return found


def _traced(
    arrays: Sequence[Array],
    moves: Sequence[Move],
    node: int,
    places: Integers,
    rng: np.random.Generator,
) -> Integers:
    """Source cells drawn through moves at a node, from the last back; `arrays` as of `_passed`."""
    for array, move in zip(arrays[-2::-1], moves[::-1], strict=True):
        places = move.sources(array, places, rng, node)
    return places


class Split:
    """An operator that moves each source cell by a shift of its own, onto three cells an axis.

    The three are the cell nearest to the target of the shift and that cell's two neighbours. Let
    the target lie μ cells from the centre of the nearest, −½ ≤ μ ≤ ½, and let s² ≤ ¼ be the
    variance of the noise. The three points then have exactly the mean μ, and the variance max(s²,
    |μ|(1 − |μ|)). If the noise has a larger variance, s² is ¼, and a `Sweep` afterwards blurs by
    the rest, which is the same everywhere.

    axes: The axes that are moved.
    place: A function of a node, which gives the targets of all source cells, (axes moved, source
        cells): places in cells, with fractions, counted from the first cell of the lattice.
    variance: The variance s² along each moved axis, in squared cells, (axes moved,).
    nodes: The weights of the quadrature's nodes, (nodes,).
    source, target: The windows before and after.
    cells, periodic: The number of cells of each axis of the lattice, and whether it is a circle.
    """

    def __init__(
        self,
        axes: tuple[int, ...],
        place: Callable[[int], Array],
        variance: Array,
        nodes: Array,
        source: tuple[Span, ...],
        target: tuple[Span, ...],
        cells: tuple[int, ...],
        periodic: tuple[bool, ...],
    ) -> None:
        self.axes, self.place, self.variance, self.nodes = axes, place, variance, nodes
        self.source, self.target, self.cells, self.periodic = source, target, cells, periodic

    @cached_property
    def _rest(self) -> Integers:
        """The part of each source cell's target index that its place along resting axes makes up.

        The target index is a flat index in the target window, a sum of one term an axis; resting
        axes are those that are not moved. The result is (source cells,).
        """
        counts = [span.length for span in self.target]
        strides = [int(np.prod(counts[k + 1 :])) for k in range(len(counts))]
        total = np.zeros((1,) * len(counts), dtype=np.intp)
        for k, span in enumerate(self.source):
            own = np.zeros(span.length) if k in self.axes else np.arange(span.length) * strides[k]
            shape = [1] * len(counts)
            shape[k] = span.length
            total = total + own.astype(np.intp).reshape(shape)
        return total.reshape(-1)

    def _taps(self, node: int) -> list[list[tuple[Integers, Array]]]:
        """The three points that each cell is split on along each moved axis, at a node.

        For each axis there are three pairs (index, weight), both (source cells,): of the cell
        before the one nearest to the target, of the nearest, and of the one after. The index is the
        contribution of the point's place along the axis to its flat index in the target window. The
        weight is zero outside of the window.
        """
        counts = [span.length for span in self.target]
        found = []
        for target, axis, variance in zip(self.place(node), self.axes, self.variance, strict=True):
            nearest = np.rint(target)
            part = target - nearest
            spread = np.maximum(variance, np.abs(part) * (1.0 - np.abs(part))) + part * part
            weights = (0.5 * (spread - part), 1.0 - spread, 0.5 * (spread + part))
            span, stride = self.target[axis], int(np.prod(counts[axis + 1 :]))
            taps = []
            for offset, weight in zip((-1, 0, 1), weights, strict=True):
                index = nearest.astype(np.intp) + offset
                if self.periodic[axis]:
                    inside, index = index == index, (index - span.first) % self.cells[axis]
                else:
                    inside = (index >= 0) & (index < self.cells[axis])
                    index = index - span.first
                # A point of no weight may be next to the window.
                inside &= (index >= 0) & (index < span.length)
                taps.append((np.where(inside, index * stride, 0), np.where(inside, weight, 0.0)))
            found.append(taps)
        return found

    def forward(self, array: Array) -> Array:
        """The probabilities after each cell is split on its neighbours; see `Operator`."""
        counts = tuple(span.length for span in self.target)
        size, values = int(np.prod(counts)), array.reshape(-1)
        total = np.zeros(size)
        for node, share in enumerate(self.nodes):
            for taps in itertools.product(*self._taps(node)):
                index, weight = self._rest, share * values
                for place, each in taps:
                    index, weight = index + place, weight * each
                total += np.bincount(index, weights=weight, minlength=size)
        return total.reshape(counts)

    def backward(self, array: Array) -> Array:
        """The transposed splitting, for backward messages; see `Operator`."""
        values = np.ascontiguousarray(array).reshape(-1)
        total = np.zeros(self._rest.size)
        for node, share in enumerate(self.nodes):
            for taps in itertools.product(*self._taps(node)):
                index, weight = self._rest, np.full(total.size, share)
                for place, each in taps:
                    index, weight = index + place, weight * each
                total += weight * values[index]
        return total.reshape(tuple(span.length for span in self.source))

    def added(self, array: Array) -> dict[int, float]:
        """By axis, the variance that the lattice adds, in squared cells.

        It is averaged over the source cells by `array`, their probabilities.
        """
        values, found = array.reshape(-1), dict.fromkeys(self.axes, 0.0)
        for node, share in enumerate(self.nodes):
            target = self.place(node)
            part = np.abs(target - np.rint(target))
            more = np.maximum(part * (1.0 - part) - self.variance[:, None], 0.0)
            for axis, mean in zip(self.axes, more @ values, strict=True):
                found[axis] += share * float(mean) / max(float(values.sum()), 1e-300)
        return found

    def sources(self, array: Array, places: Integers, rng: np.random.Generator) -> Integers:
        """Source cells drawn given target cells, among those split on them; see `Operator`."""
        target = np.ravel_multi_index(tuple(places), [span.length for span in self.target])
        wanted = np.zeros(math.prod(span.length for span in self.target), dtype=bool)
        wanted[target] = True
        values = array.reshape(-1)
        cells, sources, weights = list[Integers](), list[Integers](), list[Array]()
        for node, share in enumerate(self.nodes):
            for taps in itertools.product(*self._taps(node)):
                index, weight = self._rest, share * values
                for place, each in taps:
                    index, weight = index + place, weight * each
                (own,) = np.nonzero(wanted[index] & (weight > 0.0))
                cells.append(index[own])
                sources.append(own)
                weights.append(weight[own])
        cell, source = np.concatenate(cells), np.concatenate(sources)
        order = np.argsort(cell, kind="stable")
        sums = np.cumsum(np.concatenate(weights)[order])
        ends = np.searchsorted(cell[order], target, side="right")
        starts = np.searchsorted(cell[order], target, side="left")
        below = np.concatenate([[0.0], sums])
        level = below[starts] + rng.random(len(target)) * (below[ends] - below[starts])
        drawn = np.clip(np.searchsorted(sums, level, side="right"), starts, ends - 1)
        found = np.unravel_index(source[order][drawn], [span.length for span in self.source])
        return np.stack(found)


def picked(weights: Array, rng: np.random.Generator) -> Integers:
    """An index of each row of weights (draws, n), drawn by them."""
    return Dense(weights).draw(np.arange(len(weights)), rng)


def blocks(count: int, width: int) -> Iterator[slice]:
    """The draws, so many in all, in blocks whose weights, `width` of each draw, fit memory."""
    each = max(1, _AT_A_TIME // max(width, 1))
    return (slice(first, first + each) for first in range(0, count, each))
