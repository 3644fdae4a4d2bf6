"""Groups of states that move together, their displacements, and the noise of displacements.

A displacement is how far a state moves, in cells along each of its axes: to the mean of its CPD,
and by the noise that several displacements share, because of a hidden control or of correlations.
The shared noise is linear in white noise: independent standard normal numbers, of which a group has
`Spread.size`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.beliefs.grid.lattice import Lattice
from pgm.beliefs.grid.values import Known, covariance_of, mean_at, root_of
from pgm.cpds import CPD, ConditionalGaussian
from pgm.kernels.arrays import Array
from pgm.variables import Variable

# A correlation below this is rounding.
_UNCORRELATED = 1e-14


class Spread(NamedTuple):
    """The noise of a group's displacements at a step.

    variance: The variance of the noise that each axis of the group has by itself, in squared cells,
        (axes of the group,); infinite where nothing is known of the place along the axis.
    roots: By variable, for each hidden control and each state whose noise is correlated, a matrix L
        (d, r): L w is the shared noise of the variable, in its units. w are r numbers of the white
        noise that enter no other variable; variables take their numbers in the order of the
        mapping.
    size: How many numbers the white noise has.
    """

    variance: Array
    roots: Mapping[Variable, Array]
    size: int


@dataclass(frozen=True, eq=False)
class Members:
    """A group of states that move together, with the hidden controls that they share; a base class.

    controls: The CPDs of the hidden controls.
    states: The CPDs of the states.
    known: By child and then parent, the values (rows, runs or 1, d) of observed parents, a row for
        each step.
    prior: Whether the CPDs are a prior's, at step 0: displacements then count from the first cell.
    first: The step before that of the first row of `known`: row r is for step first + 1 + r.
    place: Of a part of a mixture, its index there; of a mixture in a mixture, one index a level;
        empty otherwise.
    """

    lattice: Lattice
    controls: tuple[ConditionalGaussian, ...]
    states: tuple[CPD, ...]
    known: Mapping[Variable, Mapping[Variable, Array]]
    prior: bool
    first: int = 0
    place: tuple[int, ...] = ()

    @property
    def key(self) -> tuple[object, ...]:
        """The states, then the indices of `place`: a key that no other group of the model has."""
        return (*(cpd.child for cpd in self.states), *self.place)

    @property
    def axes(self) -> tuple[int, ...]:
        """The indices of the axes that are moved, in the order of the displacements."""
        return tuple(k for cpd in self.states for k in self.lattice.of[cpd.child])

    @property
    def later(self) -> frozenset[int]:
        """The indices of the axes of the states on which these CPDs depend at the same step."""
        given = {v for cpd in (*self.controls, *self.states) for v in cpd.given if not v.lag}
        return frozenset(k for v in given if v in self.lattice.of for k in self.lattice.of[v])

    @property
    def widths(self) -> Array:
        """The widths of the cells along the axes that are moved, (axes of the group,)."""
        return np.array([self.lattice.axes[k].width for k in self.axes])

    def inputs(self, child: Variable, step: int, run: int) -> Known:
        """By variable, the values (d,) of a child's observed parents at a step of a run."""
        return {
            v: values[step - 1 - self.first, run if values.shape[1] > 1 else 0]
            for v, values in self.known[child].items()
        }


@dataclass(frozen=True, eq=False)
class Group(Members):
    """A group of states whose CPDs are Gaussian, moved by displacements and blurred by noise."""

    states: tuple[ConditionalGaussian, ...]

    def spread(self, step: int, run: int) -> Spread:
        """The noise of the displacements at a step of a run."""
        variances, found = [], {}
        for cpd in self.controls:
            cov = covariance_of(cpd, self.inputs(cpd.child, step, run), step, run)
            lower = root_of(cpd, cov, step)
            found[cpd.child] = lower[:, lower.any(axis=0)]
        for cpd in self.states:
            cov = covariance_of(cpd, self.inputs(cpd.child, step, run), step, run)
            own, shared = parted(cpd, cov, step)
            variances.append(own)
            if shared.size:
                found[cpd.child] = shared
        size = sum(root.shape[1] for root in found.values())
        return Spread(np.concatenate(variances) / self.widths**2, found, size)

    def displacement(
        self, before: Array, after: Array, noise: Array, spread: Spread, step: int, run: int
    ) -> Array:
        """The displacements (n, axes of the group), in cells, of n cells; along angles wrapped.

        before, after: Points (n, axes of the lattice) of the step before, from which states move,
            and of this one, at which parents of the same step stand.
        noise: Values of the white noise, (n, size), which enter by the roots of the `spread`.
        spread: The noise of the displacements at the step, as the method `spread` gives it.
        """
        points = dict(self.lattice.values(after))
        if not self.prior:
            points |= {v.previous: a for v, a in self.lattice.values(before).items()}
        entered, first = {}, 0
        for variable, root in spread.roots.items():
            entered[variable] = noise[:, first : first + root.shape[1]] @ root.T
            first += root.shape[1]
        for cpd in self.controls:
            known = self.inputs(cpd.child, step, run)
            given = {v: points[v] for v in cpd.given if v in points} or {cpd.child: before}
            points[cpd.child] = mean_at(cpd, given, known, step, run) + entered[cpd.child]
        found = []
        for cpd in self.states:
            child, known = cpd.child, self.inputs(cpd.child, step, run)
            if self.prior:
                origin = before[:, list(self.lattice.of[child])]
                moved = mean_at(cpd, points, known, step, run) - origin
            else:
                moved = mean_at(cpd, points, known, step, run, less=child.previous)
            found.append(moved + entered[child] if child in entered else moved)
        cells: Array = np.concatenate(found, axis=1) / self.widths
        return self.wrapped(cells)

    def wrapped(self, cells: Array) -> Array:
        """Displacements (..., axes of the group), in cells, wrapped in place along angles.

        They are then half a circle at the most.
        """
        for k, axis in enumerate(self.axes):
            if self.lattice.axes[axis].angle:
                count = self.lattice.axes[axis].cells
                cells[..., k] -= count * np.rint(cells[..., k] / count)
        return cells


def parted(cpd: ConditionalGaussian, cov: Array, step: int) -> tuple[Array, Array]:
    """A noise covariance as diag(v) + L Lᵀ: variances v (d,) and a root L (d, r) of the rest.

    Of components that are correlated, v has the largest equal share of their variances that leaves
    the rest semidefinite: the least eigenvalue of their correlation matrix. Of uncorrelated
    components v has all of the variance, and L a row of zeros; r is 0 if none are correlated. L is
    not triangular. A covariance that is not semidefinite is refused by a NumericalError, which
    names the CPD and the step.
    """
    own = np.diagonal(cov).copy()
    finite = np.isfinite(own) & (own > 0.0)
    block = cov[np.ix_(finite, finite)]
    deviation = np.sqrt(own[finite])
    correlation = block / np.multiply.outer(deviation, deviation)
    np.fill_diagonal(correlation, 1.0)
    mixed = (np.abs(correlation) > _UNCORRELATED).sum(axis=1) > 1
    places = np.flatnonzero(finite)[mixed]
    if not places.size:
        return own, np.zeros((len(own), 0))
    root_of(cpd, cov[np.ix_(places, places)], step)  # refused, if it is none
    values, vectors = np.linalg.eigh(correlation[np.ix_(mixed, mixed)])
    share = max(float(values[0]), 0.0)
    rest = np.maximum(values - share, 0.0)
    keep = rest > 1e-12 * values[-1]
    root = np.zeros((len(own), int(keep.sum())))
    root[places] = deviation[mixed][:, None] * vectors[:, keep] * np.sqrt(rest[keep])
    # What the two leave exactly, so that variances add up to those asked for.
    own[places] -= (root[places] ** 2).sum(axis=1)
    return np.maximum(own, 0.0), root
