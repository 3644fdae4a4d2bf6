"""The motion of a grid: the transition of a step as operators along the axes.

States move in groups, one group after another; a group is one state, or several that have to move
together. A displacement is how far a state moves along an axis, in cells. It is found at the
centres, and with it the axes on which it depends. Where these axes can be put in an order, each
axis being moved before those on which it depends, a step is products of matrices along one axis
after another: of one matrix, where the displacement is the same everywhere; of one matrix for each
heading, where it depends on the heading alone. Otherwise each cell is split: its probability is
shared by the cells nearest to its target, and the result is blurred by the rest of the variance.
Noise that enters through hidden controls, and correlated noise, is summed over the nodes of a
quadrature. A window is a span of cells along each axis.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pgm.beliefs.grid.densities import DensityGroup
from pgm.beliefs.grid.dependence import MOVED, Dependence, within
from pgm.beliefs.grid.grouping import Kept, joined
from pgm.beliefs.grid.groups import Group, Members, Spread
from pgm.beliefs.grid.lattice import Axis, Lattice, Window
from pgm.beliefs.grid.mixture_moves import Mixed, MixedGroup, Step
from pgm.beliefs.grid.moves import SPLIT, Move, Operator, Split, Sweep
from pgm.beliefs.grid.quadrature import quadrature
from pgm.beliefs.grid.wide_prior import wide
from pgm.errors import ModelError
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.lattice import REACH, Span, kernels, reached, tap_count
from pgm.resources import require_memory

# Numbers of the matrices of one move at the most; more are split cell by cell.
_MATRICES = 1 << 24
# Numbers of all its kernels, at all nodes of a quadrature; more are split node by node.
_KERNELS = 1 << 24
# Noise with a standard deviation of so many circles is flat on a circle, to e^(−2π²·9).
_CIRCLES = 3.0
# Noise with a standard deviation of so many times the bounds leaves a fiftieth within them.
_BOUNDS = 20.0


@dataclass(eq=False)
class Motion:
    """The motion by a prior or a transition: groups of states that are moved one after another.

    A group is identified by its key, `Members.key`; both mappings by key are added to.

    known: By key, the axes on which the displacements of a group depend, as far as tested.
    kept: By key, the weights between all cells of a group that is moved by a density, where they
        are the same at all steps.
    """

    lattice: Lattice
    groups: list[Members]
    known: dict[tuple[object, ...], Dependence] = field(default_factory=dict)
    kept: Kept = field(default_factory=dict)

    def at(self, step: int, run: int, source: Window) -> Step:
        """The transition to a step of a run, or the prior at step 0, as operators in order.

        `source` is the window of the belief at the step before. A prior is a move, too: of all
        probability from the first cell of the lattice, which is then the source.
        """
        window, operators = source, list[Operator | Mixed]()
        for group in self._ordered(step, run, source):
            made = self._step(group, step, run, source, window)
            window = made.target
            operators += made.operators
        return Step(source, window, operators)

    def _step(self, group: Members, step: int, run: int, source: Window, window: Window) -> Step:
        """The move of one group: its operators, and the windows from and to which they lead.

        source: The window of the belief at the step before.
        window: The window that the groups moved before have reached, from which this one starts.
        """
        if isinstance(group, MixedGroup):
            parts = [self._step(part, step, run, source, window) for part in group.parts]
            mixed = group.mixed(parts)
            return Step(window, mixed.target, [mixed])
        if isinstance(group, DensityGroup):
            made = group.move(step, run, window)
            return Step(window, made.target, [made])
        assert isinstance(group, Group)
        dense = wide(group, run, window) if group.prior else None
        if dense is not None:
            return Step(window, dense.target, [dense])
        target, operators = _Maker(self, group, step, run, source).operators(window)
        return Step(window, target, operators)

    def _depends(
        self, group: Members, step: int, run: int, source: Window
    ) -> tuple[set[int], set[int]]:
        """The axes on which a group's move depends: a set of the step before, a set of this step.

        `source` is the window of the belief at the step before, in which the dependence is tested.
        """
        if isinstance(group, DensityGroup):
            return group.depends()
        before, after = set[int](), set[int]()
        if isinstance(group, MixedGroup):
            each = [self._depends(part, step, run, source) for part in group.parts]
            return before.union(*(b for b, _ in each)), after.union(*(a for _, a in each))
        assert isinstance(group, Group)
        found = self.dependence(group, group.spread(step, run), step, run, source)
        return before.union(*found.before), after.union(*found.after)

    def dependence(
        self, group: Group, spread: Spread, step: int, run: int, source: Window
    ) -> Dependence:
        """The axes on which a group's displacements depend, tested anew at this step.

        The record has, for each axis of the group, a set of axes of the step before and one of this
        step. Displacements are tested without noise, and also with two draws of the noise that they
        share, if `spread` has such. The tests are at random cells, at cells of `source`, the window
        of the belief at the step before, and, where these show anything new, at every centre.
        """
        found = self.known.setdefault(group.key, Dependence(self.lattice))
        drawn = np.random.default_rng(step).standard_normal((2, spread.size))
        noises = [np.zeros(spread.size), *(drawn if spread.size else ())]

        def values(before: Array, after: Array) -> Array:
            """The displacements of n points, (n, noises, axes of the group), in cells.

            They are found at each of the `noises`: without shared noise, then, if the group has
            such noise, at two draws of it.

            before, after: Points (n, axes of the lattice) of the step before and of this one.
            """
            shape = len(before), spread.size
            each = [
                group.displacement(before, after, np.broadcast_to(noise, shape), spread, step, run)
                for noise in noises
            ]
            return np.stack(each, axis=1)

        slack = _slack(self.lattice, group)

        def differ(one: Array, other: Array) -> Mask:
            """The mask of displacements that differ by more than rounding, angles wrapped.

            Like the displacements it is (n, noises, axes of the group).
            """
            different: Mask = np.abs(group.wrapped(one - other)) > slack
            return different

        some = within(self.lattice, source, MOVED, 3 * step + 2)
        found.look(values, differ, group.later, 3 * step + 1, some)
        return found

    def _ordered(self, step: int, run: int, source: Window) -> list[Members]:
        """The groups in an order in which they can be moved one after another.

        A group that depends on an axis of the step before is moved before that axis is; one that
        depends on an axis of its own step, after it. Groups that have no such order among
        themselves are joined to one, here and at all later steps.
        """
        if len(self.groups) == 1:
            return self.groups
        import networkx as nx  # here, since it is slow to import

        while True:
            graph = nx.DiGraph()
            graph.add_nodes_from(range(len(self.groups)))
            mover = {axis: k for k, group in enumerate(self.groups) for axis in group.axes}
            for k, group in enumerate(self.groups):
                before, after = self._depends(group, step, run, source)
                graph.add_edges_from((k, mover[a]) for a in before if mover[a] != k)
                graph.add_edges_from((mover[a], k) for a in after if mover[a] != k)
            parts = [sorted(part) for part in nx.strongly_connected_components(graph)]
            if all(len(part) == 1 for part in parts):
                order = nx.lexicographical_topological_sort(graph)
                return [self.groups[k] for k in order]
            self.groups = [
                joined([self.groups[k] for k in part], self.kept) for part in sorted(parts)
            ]
            if len(self.groups) == 1:
                return self.groups


def _slack(lattice: Lattice, group: Group) -> Array:
    """How far displacements may differ by rounding alone, in cells, (axes of the group,)."""
    largest = [
        max(abs(lattice.axes[k].low), lattice.axes[k].width * lattice.axes[k].cells)
        for k in group.axes
    ]
    return 1e-9 + 256.0 * np.finfo(np.float64).eps * np.array(largest) / group.widths


class _Maker:
    """The maker of the operators that move a group of Gaussian CPDs, at a step of a run.

    Among its arguments is `source`, the window of the belief at the step before, in which the
    dependence is tested. Its attributes are:

    spread: The noise of the displacements at the step.
    dependence: The axes on which the group's displacements depend.
    noise: The nodes of a quadrature over the white noise that displacements share: (nodes, numbers
        of the noise).
    nodes: The weights of these nodes, (nodes,).
    """

    def __init__(
        self,
        motion: Motion,
        group: Group,
        step: int,
        run: int,
        source: Window,
    ) -> None:
        self.lattice, self.group, self.step, self.run = motion.lattice, group, step, run
        self.spread = self._within(group.spread(step, run))
        self.dependence = motion.dependence(group, self.spread, step, run, source)
        self.noise, self.nodes = quadrature(group, self.spread, step, run)

    def operators(self, window: Window) -> tuple[Window, list[Operator]]:
        """The window that the group's move reaches from `window`, and the operators leading there.

        `window` is that which the groups moved before have reached. Where nothing moves, it is
        returned as it is, without operators.
        """
        order = self._order()
        if order is None:
            return self._split(window)
        moves, spans = [], list(window)
        for k in order:
            move = self._move(k, tuple(spans))
            if move is not None:
                spans[move.axis] = move.target
                moves.append(move)
        return tuple(spans), [Sweep(moves, self.nodes)] if moves else []

    def _within(self, spread: Spread) -> Spread:
        """The same `spread`, with an infinite variance along angles whose noise is very wide.

        An infinite variance stands for equal probability of all cells; noise is very wide with a
        standard deviation of more than three circles. Along an interval a standard deviation of
        more than twenty times its length, but finite, is refused by a ModelError.
        """
        variance = spread.variance.copy()
        for k, axis in enumerate(self.lattice.axes[a] for a in self.group.axes):
            deviation = math.sqrt(variance[k]) / axis.cells
            if axis.angle and deviation > _CIRCLES:
                variance[k] = np.inf
            elif _BOUNDS < deviation < math.inf:
                high = axis.low + axis.cells * axis.width
                raise ModelError(
                    f"the noise of {axis.label} at step {self.step}, run {self.run}, deviates by "
                    f"{deviation:.2g} times what the grid covers, {axis.low:.6g} to {high:.6g}: "
                    "hardly any of it is inside; widen the bounds, or, of a prior, give the "
                    "variance np.inf, which is flat within them",
                    variable=axis.variable,
                    step=self.step,
                    run=self.run,
                )
        return spread._replace(variance=variance)

    def _order(self) -> list[int] | None:
        """The order in which the group's axes are moved one at a time; None where cells are split.

        Axes are given by their indices among the group's. Cells are split where the axes have no
        such order, or matrices or kernels would be too large. Where an axis depends on another of
        the group at the same step, cells cannot be split: a ModelError then refuses axes without an
        order, matrices that are too large, and kernels that memory would not hold.
        """
        import networkx as nx  # here, since it is slow to import

        group, found = self.group, self.dependence
        place = {axis: k for k, axis in enumerate(group.axes)}
        graph = nx.DiGraph()
        graph.add_nodes_from(range(len(place)))
        after, most = False, 0
        for k, axis in enumerate(group.axes):
            graph.add_edges_from((k, place[a]) for a in found.before[k] if a in place and a != axis)
            graph.add_edges_from((place[a], k) for a in found.after[k] if a in place)
            after = after or any(a in place for a in found.after[k])
            others = (found.before[k] | found.after[k]) - {axis}
            size = math.prod(self.lattice.shape[a] for a in others)
            if size * self.lattice.shape[axis] ** 2 > _MATRICES:
                graph.add_edge(k, k)
            if axis in found.before[k]:
                size *= self.lattice.shape[axis]
            variance = float(self.spread.variance[k])
            if np.isfinite(variance):
                most = max(most, len(self.nodes) * size * tap_count(variance))
        if most > _KERNELS:
            if not after:
                return None
            require_memory(most, f"the kernels of {self.group.states}", "take wider cells")
        if nx.is_directed_acyclic_graph(graph):
            return list(nx.lexicographical_topological_sort(graph))
        if after:
            children = [cpd.child for cpd in group.states]
            raise ModelError(
                f"the transition of {children} cannot be moved on a grid: they depend on one "
                "another at the same step and at the step before, so that no order of their axes "
                "serves; let them depend on the step before (.previous) alone",
                variable=children[0],
                step=self.step,
            )
        return None

    def _values(self, cells: Sequence[Integers], before: set[int], after: set[int]) -> Array:
        """The displacements (nodes, n, axes of the group) at n cells of the lattice.

        cells: Their places (n,) along each axis of the lattice.
        before, after: The axes of the step before, and of this step, on which the displacements
            depend; along all other axes the cells are moved to the middle of the lattice.
        """
        here = np.stack(cells, axis=-1)
        reduced = self.dependence.reduced
        base = self.lattice.points(list(reduced(here, before).T))
        own = self.lattice.points(list(reduced(here, after).T))
        nodes, count = len(self.nodes), len(here)
        found = self.group.displacement(
            np.tile(base, (nodes, 1)),
            np.tile(own, (nodes, 1)),
            np.repeat(self.noise, count, axis=0),
            self.spread,
            self.step,
            self.run,
        )
        return found.reshape(nodes, count, -1)

    def _move(self, k: int, window: Window) -> Move | None:
        """The move along the k-th of the group's axes, from a window; None where nothing moves."""
        axis, lattice = self.group.axes[k], self.lattice
        before, after = self.dependence.before[k], self.dependence.after[k]
        by = tuple(sorted((before | after) - {axis}))
        own = axis in before
        variance = float(self.spread.variance[k])
        source = window[axis]
        if np.isinf(variance):
            return _flat(lattice.axes[axis], axis, source)
        used = [*by, axis] if own else list(by)
        indices = lattice.indices(window)
        flat = [np.zeros(math.prod(window[a].length for a in used), dtype=np.intp)] * len(window)
        mesh = np.meshgrid(*(indices[a] for a in used), indexing="ij")
        for a, part in zip(used, mesh, strict=True):
            flat[a] = part.reshape(-1)
        shift = self._values(flat, before, after)[..., k]
        if len(shift) > 1 and float(np.ptp(shift, axis=0).max()) <= 1e-12:
            shift = shift[:1]  # the same at all nodes
        if variance == 0.0 and not shift.any():
            return None
        shape = (len(shift), math.prod(window[a].length for a in by), source.length if own else 1)
        return _along(lattice.axes[axis], axis, by, shift.reshape(shape), variance, source)

    def _split(self, window: Window) -> tuple[Window, list[Operator]]:
        """Split each cell on those nearest to its target, then blur by the rest of the variance.

        Splitting takes up to ¼ squared cell of an axis's variance. Returned are the target window
        and the operators that lead there from `window`.
        """
        group, lattice = self.group, self.lattice
        indices = lattice.indices(window)
        mesh = np.meshgrid(*indices, indexing="ij")
        cells = [part.reshape(-1) for part in mesh]
        noise = self.noise

        def place(node: int) -> Array:
            """The places to which all cells of the window move at a node, (axes moved, cells).

            They are in cells, counted from the first cell of the lattice, with their fractions, and
            may be beyond either end of an axis.
            """
            base = lattice.points(cells)
            white = np.broadcast_to(noise[node], (len(base), noise.shape[1]))
            shift = group.displacement(base, base, white, self.spread, self.step, self.run)
            return shift.T + np.stack([cells[a] for a in group.axes])

        spans = list(window)
        low = np.full(len(group.axes), np.inf)
        high = -low
        for node in range(len(self.nodes)):
            target = place(node)
            low = np.minimum(low, np.rint(target.min(axis=1)) - 1.0)
            high = np.maximum(high, np.rint(target.max(axis=1)) + 1.0)
        for axis, first, last in zip(group.axes, low, high, strict=True):
            count = lattice.axes[axis].cells
            if lattice.axes[axis].angle:
                length = int(last - first) + 1
                whole = length >= count
                spans[axis] = Span(0, count) if whole else Span(int(first) % count, length)
            else:
                start = int(np.clip(first, 0, count - 1))
                stop = int(np.clip(last + 1.0, 1, count))
                spans[axis] = Span(start, max(stop - start, 1))
        split = Split(
            group.axes,
            place,
            np.minimum(self.spread.variance, SPLIT),
            self.nodes,
            window,
            tuple(spans),
            lattice.shape,
            tuple(axis.angle for axis in lattice.axes),
        )
        moves = []
        for axis, variance in zip(group.axes, self.spread.variance, strict=True):
            if variance > SPLIT:
                still, rest, own = np.zeros((1, 1, 1)), float(variance - SPLIT), lattice.axes[axis]
                if np.isinf(rest):
                    move = _flat(own, axis, spans[axis])
                else:
                    move = _along(own, axis, (), still, rest, spans[axis])
                spans[axis] = move.target
                moves.append(move)
        return tuple(spans), [split, *([Sweep(moves, np.ones(1))] if moves else [])]


def _flat(axis: Axis, place: int, source: Span) -> Move:
    """The move by noise of infinite variance: from each source cell to all cells alike.

    `place` is the index of the axis, and `source` the span in which the probabilities stand.
    """
    cells = axis.cells
    # From every source cell: the first weight is at cell 0 wherever it comes from.
    first = -(source.first + np.arange(source.length)).reshape(1, 1, -1)
    weights = np.full((1, 1, source.length, cells), 1.0 / cells)
    added = np.zeros((1, 1, source.length))
    return Move(place, (), first, weights, added, source, Span(0, cells), cells, axis.angle)


def _along(
    axis: Axis, place: int, by: tuple[int, ...], shift: Array, variance: float, source: Span
) -> Move:
    """The move along one axis by displacements in cells, with noise of a variance in squared cells.

    place: The index of the axis.
    by: The other axes on which the displacement depends, ascending.
    shift: The displacements, (nodes or 1, cells of `by`, 1); where they depend on the place along
        the axis, (nodes or 1, cells of `by`, source cells).
    source: The span in which the probabilities stand.
    """
    cells = axis.cells
    if not axis.angle:  # from further away nothing comes back
        most = 2.0 * cells + 2.0 * REACH * math.sqrt(variance)
        shift = np.clip(shift, -most, most)
    made = kernels(shift.reshape(-1), variance)
    first, count = made.first.reshape(shift.shape), made.weights.shape[-1]
    if shift.shape[-1] > 1:
        start = source.first + first + np.arange(source.length)
        low, high = int(start.min()), int(start.max())
    else:
        low = source.first + int(first.min())
        high = source.first + source.length - 1 + int(first.max())
    return Move(
        place,
        by,
        first,
        made.weights.reshape(*shift.shape, count),
        made.added.reshape(shift.shape),
        source,
        reached(low, high + count, cells, axis.angle),
        cells,
        axis.angle,
    )
