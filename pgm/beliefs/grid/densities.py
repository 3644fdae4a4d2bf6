"""Moves by a transition density, which is evaluated from each cell to each cell.

A source cell is a cell at the step before, a target cell one at the step itself. The *moved axes*
are those of the states that move. The weight of a target cell is the transition density at its
centre times the volume of a cell along the moved axes.

The sum of a source cell's weights approximates an integral that is one. Its error is judged by how
much the sum varies as the target centres are shifted by parts of a cell. For a source cell near the
bounds of the grid the sum is taken over centres beyond the bounds as well. If the sum differs from
one by no more than this variation explains, the weights are divided by it. If more is missing, it
has left the bounds, and stays missing.

A window is a span of cells along each axis. Arrays of probabilities, and of backward messages, are
over the cells of a window.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pgm.beliefs.grid.groups import Members
from pgm.beliefs.grid.lattice import Window
from pgm.beliefs.grid.moves import blocks, picked
from pgm.beliefs.grid.values import (
    at_a_time,
    gaussian_parts,
    log_density_at,
    require_noise,
    settled,
)
from pgm.cpds import CPD
from pgm.errors import ModelError
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.lattice import Span
from pgm.resources import require_memory
from pgm.variables import Variable

# Numbers of kernels that are kept for all steps, where they are the same.
_KEPT = 1 << 24
# A share of the weights at the bounds above which some may be beyond.
_EDGE = 1e-14
# How many source cells' sums are taken over shifted centres, and the shifts in parts of a cell: of
# cells spread over all, and of those whose sums are the furthest from one.
_SHIFTED = 16
_FEW = np.arange(1, 4) / 4.0
_MANY = np.arange(1, 16) / 16.0
# A sum that is off one by this is one but for rounding.
_ROUNDING = 1e-9
# Above this variation of its sums a density is too narrow for the lattice.
_UNEVEN = 0.5


class Uneven(NamedTuple):
    """How much a transition density's sum over centres varies as the centres shift within a cell.

    share: The largest difference between such sums, each of which approximates one.
    variable: The child of the density; None if there is no density.
    step: The step of the transition.
    """

    share: float
    variable: Variable | None
    step: int


EVEN = Uneven(0.0, None, 0)


@dataclass(frozen=True, eq=False)
class Dense:
    """Transition weights from every cell to every cell along some axes.

    There is a matrix of weights for each cell of the other axes on which the density depends.

    axes: The axes that are moved.
    by: The other axes depended on, ascending; G is the number of the window's cells along these.
    weights: (G, S, T): S source cells along `axes`, or 1 where the density does not depend on
        these, and T target cells along `axes`, both flat in the order of `axes`.
    source, target: The windows in which the probabilities stand before and after.
    uneven: How much sums of the density over centres vary.
    """

    axes: tuple[int, ...]
    by: tuple[int, ...]
    weights: Array
    source: Window
    target: Window
    uneven: Uneven

    def forward(self, array: Array) -> Array:
        """The probabilities in the target window, from those in the source window."""
        lines = self._lines(array)
        if self.weights.shape[1] < lines.shape[2]:
            lines = lines.sum(axis=2, keepdims=True)
        return self._whole(lines @ self.weights, self.target)

    def backward(self, array: Array) -> Array:
        """The transpose: a backward message in the source window, from one in the target window."""
        lines = self._lines(array) @ self.weights.swapaxes(1, 2)
        count = math.prod(self.source[k].length for k in self.axes)
        return self._whole(np.broadcast_to(lines, (*lines.shape[:2], count)), self.source)

    def added(self, array: Array) -> dict[int, float]:
        """An empty mapping, whatever the `array` of probabilities is.

        Other operators give here, by axis, the variance that the finite width of cells adds to a
        move; of a density it is not known.
        """
        return {}

    def sources(self, array: Array, places: Integers, rng: np.random.Generator) -> Integers:
        """Source cells drawn given target cells, by the density between them; see `Operator`."""
        lines = self._lines(array)
        moved = {*self.axes, *self.by}
        rest = tuple(k for k in range(len(self.source)) if k not in moved)

        def flat(axes: Sequence[int], window: Window) -> Integers:
            found = np.zeros(places.shape[1], dtype=np.intp)
            for k in axes:
                found = found * window[k].length + places[k]
            return found

        group, still = flat(self.by, self.target), flat(rest, self.target)
        target = flat(self.axes, self.target)
        drawn = np.empty(places.shape[1], dtype=np.intp)
        for some in blocks(places.shape[1], lines.shape[2]):
            weights = self.weights[group[some], :, target[some]] * lines[group[some], still[some]]
            drawn[some] = picked(weights, rng)
        found = places.copy()
        found[list(self.axes)] = np.unravel_index(drawn, [self.source[k].length for k in self.axes])
        return found

    @property
    def _order(self) -> tuple[int, ...]:
        """All axes in the order of `_lines`: `by`, then resting axes, then `axes`.

        Resting axes are those that are neither moved nor depended on.
        """
        moved = {*self.axes, *self.by}
        return (*self.by, *(k for k in range(len(self.source)) if k not in moved), *self.axes)

    def _lines(self, array: Array) -> Array:
        """An array over a window as lines (G, cells of resting axes, cells of moved axes).

        Resting axes are those that are neither moved nor depended on.
        """
        count = math.prod(array.shape[k] for k in self.axes)
        groups = math.prod(array.shape[k] for k in self.by)
        return np.ascontiguousarray(array.transpose(self._order)).reshape(groups, -1, count)

    def _whole(self, lines: Array, window: Window) -> Array:
        """Lines (G, cells of resting axes, cells of moved axes) as an array over a window.

        Resting axes are those that are neither moved nor depended on.
        """
        shape = [window[k].length for k in self._order]
        found: Array = lines.reshape(shape).transpose(np.argsort(self._order))
        return found


@dataclass(frozen=True, eq=False)
class DensityGroup(Members):
    """States that move together, from every cell to every cell, by the densities of their CPDs.

    The CPDs may be of any kind. A hidden control among the parents is refused by a ModelError.

    kept: The weights between all cells, of groups whose weights are the same at all steps, by the
        key that identifies a group. New ones are added; groups may share the mapping.
    """

    kept: dict[tuple[object, ...], Dense] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for cpd in self.states:
            for parent in cpd.parents:
                known = parent in self.known[cpd.child]
                if not known and parent.template not in self.lattice.of:
                    raise ModelError(
                        f"{cpd!r} depends on {parent!r}, a hidden control, over which a grid sums "
                        "the displacements of Gaussian CPDs alone; make it a state, with a prior",
                        variable=cpd.child,
                        cpd=cpd,
                    )

    def depends(self) -> tuple[set[int], set[int]]:
        """The axes on which the densities depend: a set of the step before, a set of this step."""
        before, after = set[int](), set[int]()
        for cpd in self.states:
            for parent in cpd.parents:
                if parent.template in self.lattice.of:
                    (before if parent.lag else after).update(self.lattice.of[parent.template])
        return before, after

    def move(self, step: int, run: int, window: Window) -> Dense:
        """The weights of a step in a run, from the cells of a window to all cells of moved axes.

        Where the weights are the same at all steps, and no more than 2^24 in number, they are made
        once for all source cells, kept, and cut to the window.
        """
        before, after = self.depends()
        cells = math.prod(self.lattice.shape[k] for k in self.axes)
        others = (before | after) - set(self.axes)
        size = math.prod(self.lattice.shape[k] for k in others) * cells
        size *= cells if before & set(self.axes) else 1
        steady = not self.prior and not any(self.known[cpd.child] for cpd in self.states)
        if not steady or size > _KEPT:
            return _Maker(self, step, run, window).made()
        if self.key not in self.kept:
            self.kept[self.key] = _Maker(self, step, run, self.lattice.whole).made()
        return self._cut(self.kept[self.key], window)

    def _cut(self, dense: Dense, window: Window) -> Dense:
        """Weights between all cells, `dense`, cut to the source cells of a window."""
        lattice = self.lattice
        own = dense.weights.shape[1] > 1
        each = (*dense.by, *self.axes) if own else dense.by
        weights = dense.weights.reshape(*(lattice.shape[k] for k in each), -1)
        for place, k in enumerate(each):
            if window[k] != (0, lattice.shape[k]):
                weights = weights[(slice(None),) * place + (lattice.axes[k].within(window[k]),)]
        groups = math.prod(window[k].length for k in dense.by)
        target = list(window)
        for k in self.axes:
            target[k] = dense.target[k]
        weights = weights.reshape(groups, -1, dense.weights.shape[2])
        return Dense(dense.axes, dense.by, weights, window, tuple(target), dense.uneven)


class _Maker:
    """The maker of a group's weights at a step of a run, from the cells of a window to all cells.

    by: The axes depended on that are not moved, ascending.
    own: All moved axes, if the density depends on one of them at the step before; otherwise none.
    share: The largest difference found so far between sums of a source cell's weights over centres
        shifted within a cell, each of which approximates one.

    A source cell is one of the window's places along `by` and `own`, numbered flat in this order.
    Singular noise of a Gaussian part is refused by a ModelError.
    """

    def __init__(self, group: DensityGroup, step: int, run: int, window: Window) -> None:
        self.group, self.step, self.run, self.window = group, step, run, window
        self.lattice = group.lattice
        before, after = group.depends()
        self.by = tuple(sorted((before | after) - set(group.axes)))
        self.own = group.axes if before & set(group.axes) else ()
        self.known = {cpd.child: group.inputs(cpd.child, step, run) for cpd in group.states}
        self.cpds: list[CPD] = [
            settled(cpd, self.known[cpd.child], step, run) for cpd in group.states
        ]
        for cpd in self.cpds:
            for part in gaussian_parts(cpd):
                require_noise(part, part._lower, step)
        self.share = 0.0

    def made(self) -> Dense:
        """The weights from the window's cells to all cells of the moved axes, normalised.

        Weights that memory would not hold, a density too narrow for the cells and one whose
        integral is above one are refused by a ModelError.
        """
        group, lattice, window = self.group, self.lattice, self.window
        used = (*self.by, *self.own)
        count = math.prod(window[k].length for k in used)
        cells = math.prod(lattice.shape[k] for k in group.axes)
        require_memory(
            2 * count * cells,
            f"the density of {[cpd.child for cpd in group.states]} from each of {count:,} cells to "
            f"each of {cells:,}",
            "take wider cells or closer bounds, states of fewer components each, a mixture of "
            "Gaussian CPDs, which is moved by displacements, or belief=pgm.Particles(...)",
            variable=group.states[0].child,
            cpd=group.states[0],
        )
        rows = np.arange(count)
        weights = np.exp(self._logs(rows, self._places()))
        self._normalise(weights)
        target = list(window)
        for k in group.axes:
            target[k] = Span(0, lattice.axes[k].cells)
        weights = weights.reshape(math.prod(window[k].length for k in self.by), -1, cells)
        uneven = Uneven(self.share, group.states[0].child, self.step)
        return Dense(group.axes, self.by, weights, window, tuple(target), uneven)

    def _places(self, shift: float = 0.0, beyond: bool = False) -> list[Array]:
        """The centres along each moved axis, shifted by a fraction of a cell, one array an axis.

        With `beyond`, the centres of an interval go on past either end by half as many cells as it
        has.
        """
        found = []
        for k in self.group.axes:
            axis = self.lattice.axes[k]
            more = -(-axis.cells // 2) if beyond and not axis.angle else 0
            outer = np.arange(1, more + 1) * axis.width
            centres = [axis.offsets[0] - outer[::-1], axis.offsets, axis.offsets[-1] + outer]
            found.append(axis.reference + np.concatenate(centres) + shift * axis.width)
        return found

    def _logs(self, rows: Integers, places: Sequence[Array]) -> Array:
        """The logarithms of weights, (rows, targets): of the density times a cell's volume.

        The volume is that along the moved axes.

        rows: Flat indices of source cells.
        places: Coordinates along each moved axis, one array an axis; the targets are all their
            combinations, the last axis varying fastest.
        """
        group, window, lattice = self.group, self.window, self.lattice
        mesh = np.meshgrid(*places, indexing="ij")
        targets = np.stack([part.reshape(-1) for part in mesh], axis=-1)
        used = (*self.by, *self.own)
        indices = lattice.indices(window)
        lengths = [window[k].length for k in used]
        middle = np.array(lattice.shape) // 2
        found = np.empty((len(rows), len(targets)))
        flat = found.reshape(-1)
        block = min(at_a_time(cpd) for cpd in self.cpds)
        for first in range(0, flat.size, block):
            pairs = np.arange(first, min(first + block, flat.size))
            row, target = np.divmod(pairs, len(targets))
            each = np.unravel_index(rows[row], lengths) if used else ()
            here = [np.full(len(pairs), place) for place in middle]
            for k, place in zip(used, each, strict=True):
                here[k] = indices[k][place]
            base = lattice.points(here)
            later = base.copy()
            later[:, list(group.axes)] = targets[target]
            flat[pairs] = self._log_density(base, later)
        found += float(np.log(group.widths).sum())
        return found

    def _log_density(self, base: Array, later: Array) -> Array:
        """The sum of the log-densities of the group's CPDs, ln p(later | base), (n,).

        base: Points of the step before, (n, axes of the lattice).
        later: Points of the step, (n, axes of the lattice), at which the children and parents of
            the same step stand.
        """
        points = dict(self.lattice.values(later))
        children = dict(points)
        points |= {v.previous: a for v, a in self.lattice.values(base).items()}
        total = np.zeros(len(base))
        for cpd in self.cpds:
            total += log_density_at(
                cpd, children[cpd.child], points, self.known[cpd.child], self.step, self.run
            )
        return total

    def _normalise(self, weights: Array) -> None:
        """Divide weights (rows, targets), in place, by their sums over the targets.

        The sum of a source cell near the bounds includes targets beyond them. The attribute
        `share`, by how much sums vary as centres shift, is found here. A row whose sum is within 2
        `share` of one is divided by the sum; a row with a smaller sum has lost the rest to the
        bounds, and stays. A larger sum, or a share above ½, is refused by a ModelError.
        """
        sums = weights.sum(axis=1)
        near = self._near_bounds(weights) > _EDGE * sums
        (rows,) = np.nonzero(near)
        whole = sums.copy()
        if rows.size:
            whole[rows] = self._sums(rows, 0.0, True)
        if len(whole):
            some = np.linspace(0, len(whole) - 1, _SHIFTED).astype(np.intp)
            self._shift(np.unique(some), whole, near, _FEW)
        off = np.abs(whole - 1.0) - self._allowed
        if (off > 0.0).any():
            self._shift(np.argsort(-off)[:_SHIFTED], whole, near, _MANY)
        if self.share > _UNEVEN:
            raise self._error(
                "is too narrow for the cells",
                f": its sum over their centres differs by {self.share:.2g} with where between "
                "centres it stands; take narrower cells, or a Gaussian CPD, or a mixture of such, "
                "which is moved by displacements",
            )
        if (whole - 1.0 > self._allowed).any():
            raise self._error(
                f"has an integral of {whole.max():.6g}",
                ", as the sum over the centres of cells: it is no density; let log_density= be "
                "the logarithm of one whose integral over the child is one",
            )
        # What is missing by more than sums differ has left the bounds, and is not made up for.
        weights /= np.where(np.abs(whole - 1.0) <= self._allowed, whole, 1.0)[:, None]

    @property
    def _allowed(self) -> float:
        """The most by which a sum of weights may differ from one: twice `share`, plus rounding."""
        return 2.0 * self.share + _ROUNDING

    def _error(self, found: str, reason: str) -> ModelError:
        """The ModelError for the group's densities, to be raised.

        Its text is "the density of ... {found} at step ..., run ...{reason}": `found` is a
        predicate, and `reason` begins with its own comma or colon.
        """
        states = self.group.states
        named = " and ".join(f"the density of {cpd!r}" for cpd in states)
        return ModelError(
            f"{named} {found} at step {self.step}, run {self.run}{reason}",
            variable=states[0].child,
            cpd=states[0],
            step=self.step,
            run=self.run,
        )

    def _near_bounds(self, weights: Array) -> Array:
        """The sum (rows,) of each row's weights in targets at an end of an axis that is no angle.

        The weights are (rows, targets).
        """
        shape = [self.lattice.shape[k] for k in self.group.axes]
        inner = np.zeros(shape, dtype=bool)
        angles = (self.lattice.axes[k].angle for k in self.group.axes)
        inner[tuple(slice(None) if angle else slice(1, -1) for angle in angles)] = True
        found: Array = weights[:, ~inner.reshape(-1)].sum(axis=1)
        return found

    def _sums(self, rows: Integers, shift: float, beyond: bool) -> Array:
        """The sums (rows,) of weights over centres shifted by a fraction of a cell, for some rows.

        `rows` are flat indices of source cells. With `beyond` the sums go on past the bounds.
        """
        places = self._places(shift, beyond)
        length = max(_KEPT // 16 // math.prod(len(each) for each in places), 1)
        parts = [rows[k : k + length] for k in range(0, len(rows), length)]
        return np.concatenate([np.exp(self._logs(part, places)).sum(axis=1) for part in parts])

    def _shift(self, rows: Integers, whole: Array, near: Array, parts: Array) -> None:
        """Raise `self.share` to how much some rows' sums vary as centres shift by parts of a cell.

        rows: The rows looked at, given as flat indices of source cells.
        whole: The sums of all rows over centres that are not shifted, (source cells,).
        near: The mask (source cells,) of rows with weights at the bounds, whose sums go on beyond
            these.
        parts: The shifts, as fractions of a cell.
        """
        for beyond in (False, True):
            some = rows[near[rows] == beyond]
            if some.size:
                shifted = (self._sums(some, part, beyond) for part in parts.tolist())
                every = np.stack([whole[some], *shifted])
                self.share = max(self.share, float(np.ptp(every, axis=0).max()))
