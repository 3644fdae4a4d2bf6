"""The lattice of a grid: its axes, matched with the components of a model's states.

An axis is a component of a state; the axis of an angle is a full circle. The cells of an axis are
numbered from 0: a cell's number is its place along the axis, and its centre the value of the
component there. A cell of the lattice has a place along each axis. A window is the part of the
lattice that is in use: along each axis a `Span`, a first cell and a number of cells, which on a
circle may go on from the last cell to cell 0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.beliefs.grid.settings import Extent, GridSettings
from pgm.errors import ModelError
from pgm.factors.scope import Scope, listed
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.lattice import Span
from pgm.variables import Variable


@dataclass(frozen=True, eq=False)
class Axis:
    """One axis of the grid, a component of a state.

    component: The index of the component in its variable.
    label: The component's name; "x.east", x being the variable, where several states have a
        component of this name.
    low: The lower end of the first cell; on a circle, which begins at −π, the centre of the first
        cell.
    width: The width of each of the `cells`, in units of the component.
    angle: Whether the axis is a full circle.
    """

    variable: Variable
    component: int
    label: str
    low: float
    width: float
    cells: int
    angle: bool

    @cached_property
    def offsets(self) -> Array:
        """The cells' centres less `reference`, (cells,): exact however large coordinates are."""
        half = self.cells // 2 if self.angle else 0.5 * (self.cells - 1)
        return np.asarray((np.arange(self.cells) - half) * self.width, dtype=np.float64)

    @cached_property
    def reference(self) -> float:
        """The middle of the axis, from which `offsets` count; on a circle a centre close to 0.

        On a circle it is the centre of the middle cell, which lies within half a cell of 0.
        """
        half = self.cells // 2 if self.angle else 0.5 * self.cells
        return self.low + half * self.width

    @cached_property
    def centres(self) -> Array:
        """The centres of the cells, (cells,)."""
        found = self.reference + self.offsets
        found.flags.writeable = False
        return found

    def within(self, span: Span) -> slice | Integers:
        """The index that takes the cells of a span from an array along this axis.

        It is a slice, or the cells' places (length,) where the span goes past the last cell of a
        circle.
        """
        if span.first + span.length <= self.cells:
            return slice(span.first, span.first + span.length)
        return np.arange(span.first, span.first + span.length) % self.cells


# The cells of a lattice that are in use: a span of each axis.
Window = tuple[Span, ...]


@dataclass(frozen=True, eq=False)
class Lattice:
    """The lattice of a grid: an axis for each component of its states, the axes of angles first."""

    states: Scope
    axes: tuple[Axis, ...]

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """The number of cells along each axis."""
        return tuple(axis.cells for axis in self.axes)

    @cached_property
    def size(self) -> int:
        """The number of cells."""
        return math.prod(self.shape)

    @cached_property
    def whole(self) -> Window:
        """The window of all cells."""
        return tuple(Span(0, axis.cells) for axis in self.axes)

    @cached_property
    def of(self) -> Mapping[Variable, tuple[int, ...]]:
        """By state, the indices of its components' axes, in the order of the components."""
        places = {(axis.variable, axis.component): k for k, axis in enumerate(self.axes)}
        return {v: tuple(places[v, k] for k in range(v.dimension)) for v in self.states}

    @cached_property
    def angles(self) -> tuple[int, ...]:
        """The indices of the axes that are circles."""
        return tuple(k for k, axis in enumerate(self.axes) if axis.angle)

    def like(self, other: Lattice) -> bool:
        """Whether another lattice has the same axes: labels, lower ends, widths and cells."""
        each = [(axis.label, axis.low, axis.width, axis.cells) for axis in self.axes]
        return each == [(axis.label, axis.low, axis.width, axis.cells) for axis in other.axes]

    def indices(self, window: Window) -> list[Integers]:
        """The places (length,) of a window's cells along each axis, a list of one array an axis."""
        return [
            np.arange(span.first, span.first + span.length) % axis.cells
            for span, axis in zip(window, self.axes, strict=True)
        ]

    def cut(self, array: Array, window: Window) -> Array:
        """The entries of an array (*shape) at a window's cells, (*lengths of its spans)."""
        for k, (span, axis) in enumerate(zip(window, self.axes, strict=True)):
            if span.length < axis.cells or span.first:
                array = array[(slice(None),) * k + (axis.within(span),)]
        return array

    def put(self, part: Array, window: Window) -> Array:
        """An array (*shape) with `part` (*lengths) at a window's cells, and zeros elsewhere."""
        if all(span == (0, axis.cells) for span, axis in zip(window, self.axes, strict=True)):
            return np.ascontiguousarray(part)
        whole = np.zeros(self.shape)
        index = [axis.within(span) for span, axis in zip(window, self.axes, strict=True)]
        if all(isinstance(each, slice) for each in index):
            whole[tuple(index)] = part
        else:
            whole[np.ix_(*self.indices(window))] = part
        return whole

    def points(self, places: Sequence[Integers]) -> Array:
        """The centres (n, axes) of n cells, given by their places (n,) along each axis."""
        return np.stack(
            [axis.centres[place] for axis, place in zip(self.axes, places, strict=True)], axis=-1
        )

    def values(self, points: Array) -> dict[Variable, Array]:
        """By state, its values (n, d) at points (n, axes) of the lattice."""
        return {v: points[..., list(places)] for v, places in self.of.items()}


def spanned(used: Mask, periodic: bool) -> Span:
    """The shortest span that contains all cells of an axis marked in `used`, (cells,).

    If no cell is marked, the span is the whole axis. On a circle (`periodic`) it is the circle
    without the widest gap between marked cells.
    """
    cells = len(used)
    places: Integers = np.flatnonzero(used)
    if not places.size:
        return Span(0, cells)
    if not periodic:
        return Span(int(places[0]), int(places[-1] - places[0]) + 1)
    gaps = np.diff(np.append(places, places[0] + cells))
    widest = int(gaps.argmax())
    first = int(places[(widest + 1) % len(places)])
    return Span(first, cells - int(gaps[widest]) + 1)


def resolve(grid: GridSettings, states: Scope) -> Lattice:
    """The lattice of a grid over some states, each component of which has to have exactly one axis.

    Names that fit no component or several, a component named twice and one left out are refused by
    a ModelError.
    """
    components = [(v, k) for v in states for k in range(v.dimension)]
    names = [v.components[k] for v, k in components]
    found: dict[tuple[Variable, int], Axis] = {}
    for key, extent in grid.cells.items():
        variable, place = _component(key, states, components, names)
        if (variable, place) in found:
            raise ModelError(
                f"the grid has {key!r} twice: as {found[variable, place].label!r} too",
                variable=variable,
            )
        name = variable.components[place]
        label = name if names.count(name) == 1 else f"{variable.name}.{name}"
        found[variable, place] = _axis(variable, place, label, extent)
    missing = [f"{v.name}.{v.components[k]}" for v, k in components if (v, k) not in found]
    if missing:
        raise ModelError(
            f"the grid lacks {listed(missing)}: it must cover every component of the states "
            f"{listed(states)}; what is known is given as evidence of an input"
        )
    axes = [found[each] for each in components]
    return Lattice(states, tuple(sorted(axes, key=lambda axis: not axis.angle)))


def _component(
    key: str | Variable,
    states: Scope,
    components: Sequence[tuple[Variable, int]],
    names: Sequence[str],
) -> tuple[Variable, int]:
    """The state, and the index of its component, that a key of the user's grid names.

    A key is a scalar variable, its name, or a component's name, alone ("east") or after that of its
    variable ("x.east"). `components` are all components of the states, and `names` their names in
    the same order. A key that fits none or several is refused by a ModelError.
    """
    if isinstance(key, Variable):
        if key not in states:
            raise ModelError(
                f"the grid has {key!r}, which is no state of the network; those are "
                f"{listed(states)}",
                variable=key,
            )
        if key.dimension != 1:
            raise ModelError(
                f"the grid has {key!r}, which has {key.dimension} components; name each of them, "
                f"like {key.name + '.' + key.components[0]!r}",
                variable=key,
            )
        return key, 0
    at = [k for k, name in enumerate(names) if name == key]
    dotted = [k for k, (v, i) in enumerate(components) if f"{v.name}.{v.components[i]}" == key]
    scalar = [k for k, (v, _) in enumerate(components) if v.dimension == 1 and v.name == key]
    every = sorted({*at, *dotted, *scalar})
    if len(every) == 1:
        return components[every[0]]
    choices = [f"{components[k][0].name}.{names[k]}" for k in every or range(len(names))]
    if every:
        raise ModelError(f"the grid's {key!r} may be {listed(choices)}; name it so")
    raise ModelError(
        f"the grid has {key!r}, which is no component of the states; those are {listed(choices)}"
    )


def _axis(variable: Variable, place: int, label: str, extent: Extent) -> Axis:
    """The axis of a component, in cells of equal width; of an angle it is the full circle.

    `place` is the index of the component in its variable. The `extent` of an angle has to be a
    number of cells, that of any other component (lo, hi, cells); one of the wrong kind is refused
    by a ModelError.
    """
    angle = variable.components[place] in variable.angles
    if angle != isinstance(extent, int):
        due = (
            "an angle, which takes a number of cells, of its full circle"
            if angle
            else "no angle; it takes (lo, hi, cells)"
        )
        raise ModelError(f"the grid's {label!r} has {extent!r}, but is {due}", variable=variable)
    if isinstance(extent, int):
        return Axis(variable, place, label, -math.pi, TURN / extent, extent, True)
    low, high, cells = extent
    return Axis(variable, place, label, low, (high - low) / cells, cells, False)
