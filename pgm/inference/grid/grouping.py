"""The CPDs of a model in the groups in which a grid moves them: of a mixture, one by chance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pgm.cpds import CPD, ConditionalGaussian, MixtureCPD
from pgm.errors import ModelError
from pgm.inference.grid.densities import EVEN, Dense, DensityGroup, Uneven
from pgm.inference.grid.groups import Group, Members
from pgm.inference.grid.lattice import Lattice, Window, spanned
from pgm.inference.grid.moves import Operator, Split
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.lattice import Span
from pgm.variables import Variable


@dataclass(frozen=True, eq=False)
class Step:
    """Operators one after another, from one window to another."""

    source: Window
    target: Window
    operators: Sequence[Operator | Mixed]

    @property
    def split(self) -> frozenset[int]:
        """The axes that are moved cell by cell."""
        each = [operator.axes for _, operator in self.leaves() if isinstance(operator, Split)]
        return frozenset().union(*each)

    @property
    def uneven(self) -> Uneven:
        """The least even density, by its share in all."""
        each = [
            operator.uneven._replace(share=weight * operator.uneven.share)
            for weight, operator in self.leaves()
            if isinstance(operator, Dense)
        ]
        return max(each, key=lambda found: found.share, default=EVEN)

    def leaves(self) -> Iterator[tuple[float, Operator]]:
        """The operators and their weights, those of mixtures too."""
        for operator in self.operators:
            if isinstance(operator, Mixed):
                for weight, step in zip(operator.weights.tolist(), operator.steps, strict=True):
                    yield from ((weight * share, leaf) for share, leaf in step.leaves())
            else:
                yield 1.0, operator

    def forward(self, array: Array) -> tuple[Array, Array]:
        """The probabilities in the target window, and the variance added by the lattice.

        That is along each of its axes, in cells.
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
        """The transpose."""
        for operator in reversed(self.operators):
            array = operator.backward(array)
        return array


@dataclass(frozen=True, eq=False)
class Mixed:
    """The weighted sum of several steps from one window.

    target: The window that holds those of all steps.
    """

    lattice: Lattice
    weights: Array
    steps: Sequence[Step]
    target: Window

    def moved(self, array: Array) -> tuple[Array, Array]:
        """The probabilities after it, and the variance that the lattice has added on the way."""
        total, added = np.zeros([span.length for span in self.target]), np.zeros(array.ndim)
        for weight, step in zip(self.weights, self.steps, strict=True):
            part, more = step.forward(array)
            total[self._of(step)] += weight * part
            added += weight * more
        return total, added

    def backward(self, array: Array) -> Array:
        """The transpose."""
        parts = [
            weight * step.backward(array[self._of(step)])
            for weight, step in zip(self.weights, self.steps, strict=True)
        ]
        total: Array = np.sum(parts, axis=0)
        return total

    def _of(self, step: Step) -> tuple[Integers, ...]:
        each = [
            (np.arange(own.length) + own.first - span.first) % axis.cells
            for own, span, axis in zip(step.target, self.target, self.lattice.axes, strict=True)
        ]
        return np.ix_(*each)


@dataclass(frozen=True, eq=False)
class MixedGroup(Members):
    """A mixture, part by part."""

    parts: tuple[Members, ...] = ()
    weights: Array = field(default_factory=lambda: np.ones(1))

    def mixed(self, steps: Sequence[Step]) -> Mixed:
        """The sum of the steps of its parts."""
        target = []
        for k, axis in enumerate(self.lattice.axes):
            target.append(_around([step.target[k] for step in steps], axis.cells, axis.angle))
        return Mixed(self.lattice, self.weights, steps, tuple(target))


def _around(spans: Sequence[Span], cells: int, periodic: bool) -> Span:
    if all(span == spans[0] for span in spans):
        return spans[0]
    if not periodic:
        first = min(span.first for span in spans)
        return Span(first, max(span.first + span.length for span in spans) - first)
    used = np.zeros(cells, dtype=bool)
    for span in spans:
        used[np.arange(span.first, span.first + span.length) % cells] = True
    return spanned(used, periodic)


# Weights between all cells, by the key of a group.
Kept = dict[tuple[object, ...], Dense]


def groups(
    lattice: Lattice,
    cpds: Sequence[CPD],
    known: Sequence[Mapping[Variable, Array]],
    kept: Kept,
    *,
    prior: bool,
    first: int = 0,
) -> list[Members]:
    """The groups of a prior or transition: states whose CPDs depend on one control are together."""
    values = {cpd.child: given for cpd, given in zip(cpds, known, strict=True)}
    states = [cpd for cpd in cpds if cpd.child in lattice.of]
    controls = {cpd.child: _gaussian(cpd) for cpd in cpds if cpd.child not in lattice.of}

    def needed(cpd: CPD) -> set[Variable]:
        found = {v for v in cpd.given if v in controls}
        return found.union(*(needed(controls[v]) for v in found))

    def made(cpd: CPD, place: tuple[int, ...]) -> Members:
        """The group of one CPD, or of one part of a mixture."""
        own = tuple(control for control in controls.values() if control.child in needed(cpd))
        family = {each.child: values[each.child] for each in own}
        family[cpd.child] = {v: a for v, a in values[cpd.child].items() if v in cpd.parents}
        about = family, prior, first, place
        if isinstance(cpd, ConditionalGaussian) and cpd.noise is None:
            return Group(lattice, own, (cpd,), *about)
        if isinstance(cpd, MixtureCPD):
            parts = tuple(made(part, (*place, k)) for k, part in enumerate(cpd.parts))
            return MixedGroup(lattice, own, (cpd,), *about, parts, cpd.weights)
        return DensityGroup(lattice, (), (cpd,), *about, kept)

    alike: list[tuple[set[Variable], list[CPD]]] = []
    for cpd in states:
        need, members = needed(cpd), [cpd]
        for other in [pair for pair in alike if pair[0] & need]:
            alike.remove(other)
            need, members = need | other[0], other[1] + members
        alike.append((need, members))
    return [joined([made(cpd, ()) for cpd in members], kept) for _, members in alike]


def joined(some: Sequence[Members], kept: Kept) -> Members:
    """One group of several: of displacements, if all are Gaussian, else by their density."""
    one = some[0]
    if len(some) == 1:
        return one
    controls = tuple(dict.fromkeys(cpd for group in some for cpd in group.controls))
    known = {v: values for group in some for v, values in group.known.items()}
    states = tuple(cpd for group in some for cpd in group.states)
    plain = (c for c in states if isinstance(c, ConditionalGaussian) and c.noise is None)
    gaussian = tuple(plain)
    if len(gaussian) == len(states):
        return Group(one.lattice, controls, gaussian, known, one.prior, one.first)
    return DensityGroup(one.lattice, (), states, known, one.prior, one.first, (), kept)


def _gaussian(control: CPD) -> ConditionalGaussian:
    if not isinstance(control, ConditionalGaussian) or control.noise is not None:
        raise ModelError(
            f"{control!r} is that of a hidden control, over which a grid sums where it is "
            "Gaussian; make it a state, with a prior, or take belief=pgm.Particles(...)",
            variable=control.child,
            cpd=control,
        )
    return control
