"""Displacements of states that move together."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.cpds import CPD, ConditionalGaussian
from pgm.inference.grid.lattice import Lattice
from pgm.inference.grid.values import Known, covariance_of, mean_at, root_of
from pgm.kernels.arrays import Array
from pgm.variables import Variable

# A correlation below this is rounding.
_UNCORRELATED = 1e-14


class Spread(NamedTuple):
    """The noise of a group at a step.

    variance: (axes,): what each axis has of its own, in cells; infinite where nothing is known.
    roots: Of each hidden control, and of each state whose noise is correlated: (d, r), by which
        white noise of its own enters.
    """

    variance: Array
    roots: Mapping[Variable, Array]
    size: int


@dataclass(frozen=True, eq=False)
class Members:
    """CPDs of states that are moved together, and of the hidden controls that they share.

    known: By child, the values (rows, runs or 1, d) of its observed parents.
    prior: Whether this is step 0: displacements are counted from the first cell then.
    first: The step before the first row of these values.
    place: Of a part of a mixture, where it stands in it.
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
        """The states and their place, which tell these members from others of their model."""
        return (*(cpd.child for cpd in self.states), *self.place)

    @property
    def axes(self) -> tuple[int, ...]:
        """The axes that are moved, in the order of the displacements."""
        return tuple(k for cpd in self.states for k in self.lattice.of[cpd.child])

    @property
    def later(self) -> frozenset[int]:
        """The axes of parents at the same step."""
        given = {v for cpd in (*self.controls, *self.states) for v in cpd.given if not v.lag}
        return frozenset(k for v in given if v in self.lattice.of for k in self.lattice.of[v])

    @property
    def widths(self) -> Array:
        """The widths of cells along these axes."""
        return np.array([self.lattice.axes[k].width for k in self.axes])

    def inputs(self, child: Variable, step: int, run: int) -> Known:
        """The values (d,) of a child's observed parents at a step."""
        return {
            v: values[step - 1 - self.first, run if values.shape[1] > 1 else 0]
            for v, values in self.known[child].items()
        }


@dataclass(frozen=True, eq=False)
class Group(Members):
    """Gaussian CPDs, which move by displacements and their noise."""

    states: tuple[ConditionalGaussian, ...]

    def spread(self, step: int, run: int) -> Spread:
        """The noise at a step."""
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
        """The displacements (n, axes), in cells, at points of the step before and of this one.

        before, after: (n, axes of the lattice).
        noise: (n, size): values of the white noise.
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
        """Displacements (n, axes), those of angles within half a circle."""
        for k, axis in enumerate(self.axes):
            if self.lattice.axes[axis].angle:
                count = self.lattice.axes[axis].cells
                cells[..., k] -= count * np.rint(cells[..., k] / count)
        return cells


def parted(cpd: ConditionalGaussian, cov: Array, step: int) -> tuple[Array, Array]:
    """Noise as variances (d,) of the components alone, and the root (d, r) of the rest.

    As large a share of all variances as the correlations leave is the components' own: the least
    eigenvalue of their correlation matrix.
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
