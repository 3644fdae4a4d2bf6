"""The places of the hidden variables of a slice in its vectors: compiled once for all steps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from pgm.compile.machine import Compiled
from pgm.cpds import CPD, NonlinearGaussianCPD
from pgm.factors.scope import Scope, dimension, positions
from pgm.kernels.arrays import Index, Integers
from pgm.linearisers import FunctionTemplate
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable


class Place(NamedTuple):
    """The place of a CPD in the vector of a scope.

    hidden: The parents of its mean that no evidence gives.
    parents: Where these stand.
    child: Where its child stands; nowhere, if it is a measurement.
    angles, before: The child's components that are angles, and where those of the step before
        stand; empty where the child does not depend on itself.
    """

    hidden: Scope
    parents: Index
    child: slice
    angles: Integers
    before: Integers
    template: FunctionTemplate | None


@dataclass(frozen=True, eq=False)
class SliceLayout:
    """The vectors of a dynamic network's slice.

    A *slice* stacks the hidden variables of one step, states and controls, parents before
    children. A *pair* stacks the states of the step before, then the slice: the hidden scope of
    a cluster.
    """

    model: DynamicBayesianNetwork
    compiled: Compiled | None = None

    @cached_property
    def functions(self) -> dict[FunctionTemplate, Any]:
        """The functions that have been compiled, or why not."""
        return {}

    @cached_property
    def slice(self) -> Scope:
        """The hidden variables of a step, in the order of the slice vector."""
        return tuple(cpd.child for cpd in self.model.transition)

    @cached_property
    def states(self) -> Scope:
        """The states, in the order of the slice vector."""
        return self.model.states

    @cached_property
    def pair(self) -> Scope:
        """The states of the step before, then the slice."""
        return (*(state.previous for state in self.states), *self.slice)

    @cached_property
    def places(self) -> dict[Variable, Index]:
        """The place of each hidden variable in the slice vector."""
        return {variable: positions(self.slice, [variable]) for variable in self.slice}

    @cached_property
    def state_size(self) -> int:
        """Components of the states."""
        return dimension(self.states)

    @cached_property
    def slice_size(self) -> int:
        """Components of the slice."""
        return dimension(self.slice)

    @cached_property
    def state_places(self) -> Index:
        """The places of the states in the slice vector: all of it, where there are no controls."""
        return positions(self.slice, self.states)

    @cached_property
    def control_places(self) -> Integers:
        """The places of the controls in the slice vector."""
        everywhere = np.arange(self.slice_size)
        return np.setdiff1d(everywhere, everywhere[self.state_places])

    @cached_property
    def single(self) -> bool:
        """Whether one CPD makes the whole slice of the whole slice before."""
        return len(self.slice) == 1 and self.hidden(self.model.transition[0]) == self.pair[:1]

    @cached_property
    def probed(self) -> set[CPD]:
        """The CPDs whose functions have been called on trial."""
        return set()

    @cached_property
    def _places(self) -> dict[CPD, Place]:
        return {}

    def place(self, cpd: CPD, scope: Scope) -> Place:
        """The place of a CPD in the vector of the scope that it belongs to, found once."""
        found = self._places.get(cpd)
        if found is None:
            found = self._places[cpd] = self._find(cpd, scope)
        return found

    def _find(self, cpd: CPD, scope: Scope) -> Place:
        hidden = self.hidden(cpd)
        child, angles = slice(0, 0), np.flatnonzero(cpd.child.angle_mask)
        if cpd.child in scope:
            place = positions(scope, [cpd.child])
            assert isinstance(place, slice)
            child = place
        before = angles[:0]
        if cpd.child.previous in hidden:
            before = np.arange(dimension(scope))[positions(scope, [cpd.child.previous])][angles]
        return Place(
            hidden,
            positions(scope, hidden),
            child,
            angles[: before.size],
            before,
            cpd._template(hidden) if isinstance(cpd, NonlinearGaussianCPD) else None,
        )

    def hidden(self, cpd: CPD) -> Scope:
        """The parents of a CPD's mean that no evidence gives, in the order of its function."""
        slice_ = set(self.slice)
        return tuple(parent for parent in cpd.given if parent.template in slice_)
