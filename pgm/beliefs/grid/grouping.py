"""The CPDs of a model in the groups in which a grid moves them.

A group is one state, or several that have to move together, since they depend on one hidden control
and share its noise, or depend on one another in such a way that none can move first. Values of
observed parents are (rows, runs or 1, d): a row for each step of a transition, none for a prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pgm.beliefs.grid.densities import Dense, DensityGroup
from pgm.beliefs.grid.groups import Group, Members
from pgm.beliefs.grid.lattice import Lattice
from pgm.beliefs.grid.mixture_moves import MixedGroup
from pgm.cpds import CPD, ConditionalGaussian, MixtureCPD
from pgm.errors import ModelError
from pgm.kernels.arrays import Array
from pgm.variables import Variable

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
    """The groups of a prior's or a transition's CPDs, in which a grid moves the states.

    States that depend on the same hidden control are in one group.
    A hidden control whose CPD is not Gaussian, or has robust noise, is refused by a ModelError.

    cpds: The CPDs of the states and of the hidden controls.
    known: For each CPD, in the order of `cpds`, the values of its observed parents, by parent.
    kept: The weights from every cell to every cell, of groups that are moved by densities, by the
        key that identifies a group; groups add to it and share it.
    prior: Whether the CPDs are a prior's.
    first: The step before that of the first row of known values: row r is for step first + 1 + r.
    """
    values = {cpd.child: given for cpd, given in zip(cpds, known, strict=True)}
    states = [cpd for cpd in cpds if cpd.child in lattice.of]
    controls = {cpd.child: _gaussian(cpd) for cpd in cpds if cpd.child not in lattice.of}

    def needed(cpd: CPD) -> set[Variable]:
        """The hidden controls that a CPD depends on, through other controls too."""
        found = {v for v in cpd.given if v in controls}
        return found.union(*(needed(controls[v]) for v in found))

    def made(cpd: CPD, place: tuple[int, ...]) -> Members:
        """The group of one state, moved by its CPD, or by a part of its CPD if that is a mixture.

        place: () of a whole CPD; (k,) of part k of a mixture; (k, l) of part l of the mixture that
            is itself part k of another; and so on.
        """
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
    """Several groups as one: moved by displacements if all are Gaussian, otherwise by density.

    One group alone is returned as it is. `kept` has the weights from every cell to every cell, of
    groups that are moved by density, by the key that identifies a group; groups add to it and share
    it.
    """
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
    """A hidden control's CPD itself; a ModelError refuses one not Gaussian or of robust noise."""
    if not isinstance(control, ConditionalGaussian) or control.noise is not None:
        raise ModelError(
            f"{control!r} is that of a hidden control, over which a grid sums where it is "
            "Gaussian; make it a state, with a prior, or take belief=pgm.Particles(...)",
            variable=control.child,
            cpd=control,
        )
    return control
