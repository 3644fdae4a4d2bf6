"""One sensor of a chain: measurements by step, their linearisation, gate decisions.

A *sighting* is one measurement by a sensor, of which a step may have several. A sensor has M
sightings, the *rows*, sorted by step, of d components each. The k sightings of a step together have
D = k d components. Arrays by row are (M, runs, ...), the runs of length one where all have the
same. A *slice* is the vector of all hidden variables of a step, of n components. The *branch* of a
measured angle is its value among those that differ by whole turns.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.kernels import roots, step
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import (
    Array,
    Index,
    Integers,
    Kind,
    Mask,
    apply,
    block,
    components_first,
    components_last,
    independent,
    tiled,
)
from pgm.kernels.dense import Stack
from pgm.linearisation.family import Family
from pgm.linearisation.rows import At
from pgm.linearisation.weights import Weights
from pgm.linearisers import BoundFunction, Taylor
from pgm.posteriors.gate_record import GateRecord
from pgm.variables import Variable


class Seen(NamedTuple):
    """Some linearised sightings z = F x + b + noise of a sensor, x being its parents.

    `matrix` is F (k, runs, d, m), the parents having m components; `offset` is b and `value` z,
    (k, runs, d), angles of z on the branch nearest the CPD's value; `noise` (k, runs, d, d) is the
    covariance of the noise. A missing component says nothing: it has unit variance, and zeros in
    F, b and z. `taken` (k, runs or 1, d) marks the components measured, None if none is missing.
    """

    matrix: Array
    offset: Array
    value: Array
    noise: Array
    taken: Mask | None

    @property
    def missing(self) -> Integers:
        """The number of missing components of each measurement, (k, runs or 1)."""
        none: Integers = np.zeros((1, 1), dtype=np.intp)
        return none if self.taken is None else (~self.taken).sum(axis=-1)


@dataclass(eq=False)
class Sensor:
    """A sensor: its CPD at all rows, and its measured `values` (M, runs or 1, d) sorted by step.

    `family` is the CPD with its evidence and linearisations. `parents` are the places of the CPD's
    hidden parents in the slice; `whole` says whether they are all of it. Row k is row order[k] of
    the user's evidence; rows bounds[t] to bounds[t + 1] are of step t. `taken` (M, runs or 1, d)
    marks the components measured, None for all; where there is a gate it is an array of its own, to
    be written to. The sightings of a step are linearised as one vector if the CPD is grouped:
    `cross` then has by step the covariances (runs, D, D) between the approximation errors of
    different sightings. `gated` has the decisions of its gate, if there is one.
    """

    family: Family
    parents: Index
    order: Integers
    taken: Mask | None
    values: Array
    bounds: list[int]
    cross: dict[int, Array]
    whole: bool
    gated: GateRecord | None = None

    def emptied(self) -> Sensor:
        """The sensor with evidence of the same shape that takes no memory, to be `renewed`."""
        part = copy(self)
        part.family, part.taken = self.family.emptied(), None
        part.values = np.broadcast_to(0.0, self.values.shape)
        assert part.edges is not None  # which all that are made of it have in common
        return part

    def renewed(self, family: Family, values: Array, taken: Mask | None) -> Sensor:
        """The sensor with other measurements at the same steps; `family` has their evidence."""
        part = object.__new__(Sensor)
        part.__dict__.update(self.__dict__, family=family, values=values, taken=taken, cross={})
        if family.noisy:
            part.__dict__.pop("exact", None)
        return part

    @property
    def grouped(self) -> bool:
        """Whether the sightings of a step are linearised as one vector."""
        return self.family.grouped

    @property
    def correlates(self) -> bool:
        """Whether errors of several sightings of a step are correlated; Taylor's rule has none."""
        return self.grouped and type(self.family.lineariser) is not Taylor

    @property
    def is_correlated(self) -> bool:
        """Whether the errors of a step's sightings may be correlated, as it has several."""
        return self.correlates and bool(max(np.diff(self.bounds), default=0) > 1)

    @cached_property
    def robust(self) -> bool:
        """Whether the CPD's noise is robust, so that sightings are weighed by their residuals."""
        return self.family.cpd.noise is not None

    @cached_property
    def weights(self) -> Weights:
        """The weights of all sightings of a robust sensor, one at first."""
        shape = self.family.shape[0], self.family.shape[1]
        return Weights.of(self.family.cpd, self.family.own_noise, self.taken, shape)

    @cached_property
    def moved(self) -> Array:
        """The measured values (M, runs, d), angles on the branch where linearisations put them.

        At first they are as given. With angles it is an array of its own, to be written to.
        """
        shape = self.family.shape[:3]
        wide = self.values
        if wide.shape != shape:
            wide = np.broadcast_to(wide, shape)
        return wide.copy("K") if self.variable.angles else wide

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of sightings and of runs."""
        return len(self.values), self.family.shape[1]

    @property
    def marked(self) -> Array:
        """The measured values, NaN where nothing was measured, or a gate has rejected it."""
        return _marked(self.values, self.taken)

    @property
    def given_marked(self) -> Array:
        """The measured values, NaN where nothing was measured, whatever the gate has decided."""
        assert self.gated is not None
        return _marked(self.values, self.gated.given)

    @property
    def moved_marked(self) -> Array:
        """The values as `moved`, NaN as of `marked`."""
        return _marked(self.moved, self.taken)

    @cached_property
    def edges(self) -> npt.NDArray[np.int64]:
        """The rows at which each step's sightings begin, (T + 2,), as `bounds`."""
        return np.array(self.bounds, dtype=np.int64)

    @cached_property
    def height(self) -> int:
        """The number d of components of a sighting."""
        return self.variable.dimension

    @cached_property
    def exact(self) -> bool:
        """Whether the noise covariance R of some sighting is singular."""
        return bool(roots.determined(roots.root(self.family.own_noise)).any())

    def rows(self, step: int) -> slice:
        """The rows of a step's sightings; steps are counted from the plan's first one."""
        return slice(self.bounds[step], self.bounds[step + 1])

    @cached_property
    def variable(self) -> Variable:
        """The measurement's variable."""
        return self.family.cpd.child

    def turning(self, height: int) -> list[int]:
        """The places of angles in a vector of stacked sightings with `height` components in all."""
        if not self._angles or height == self.height:
            return self._angles
        return [first + angle for first in range(0, height, self.height) for angle in self._angles]

    @cached_property
    def _angles(self) -> list[int]:
        """The places of angles among the components of a sighting."""
        return [int(k) for k in np.flatnonzero(self.variable.angle_mask)]

    def at(self, step: int, *, stored: bool) -> tuple[At, Array, Mask | None] | None:
        """The CPD at a step's sightings, their values and mask `taken`; None without sightings.

        Values and `taken` are (D, *batch): the batch is () for one run, else one axis of runs, of
        length one where all have the same. `taken` marks the components measured, None for all.
        With `stored` the CPD has its stored linearisation, and angles are where it moved them.
        """
        first, last = self.bounds[step], self.bounds[step + 1]
        if first == last:
            return None
        taken = None if self.taken is None else self._taken(slice(first, last))
        flat = None if taken is None else self._flat(taken)
        family = self.family
        if not stored:
            if last - first == 1:
                return family.at(first, last), self._by_row[first], flat
            return family.at(first, last), self._flat(self.values[first:last]), flat
        at = family.stored_at(first, last)
        cross = self.cross.get(step)
        if cross is not None:
            at = at._replace(
                noise=at.noise + (components_first(cross, 2) if family.batch else cross[0])
            )
        return at, self._flat(self.moved[first:last]), flat

    def sighting(self, row: int) -> tuple[At, Array, Mask | None]:
        """The CPD at one sighting, to be linearised, its values and mask; as of `at`."""
        own = slice(row, row + 1)
        taken = self._taken(own)
        flat = None if taken is None else self._flat(taken)
        return self.family.at(row, row + 1), self._flat(self.values[own]), flat

    @cached_property
    def _by_row(self) -> list[Array]:
        """Each row's measured values, (d, *batch), as of `at`."""
        values = self.values
        return list(values.transpose(0, 2, 1) if self.family.batch else values[:, 0])

    def _flat(self, rows: npt.NDArray[Kind]) -> npt.NDArray[Kind]:
        """Rows (k, runs or 1, d) stacked to one vector, (k d, *batch)."""
        if not self.family.batch:
            return rows.reshape(-1)
        return rows.transpose(0, 2, 1).reshape(-1, rows.shape[1])

    def keep(self, at: At, reading: Array, noise: Array | None) -> None:
        """Store where angles were moved to, and the covariances between sightings' errors.

        `at` is the CPD at a step's sightings, `reading` (D, *batch) their values with angles moved,
        `noise` (D, D, *batch) their noise with the approximation error, None without an error; the
        batch is () or (runs,).
        """
        count, height = at.last - at.first, self.height
        if self._angles and count == 1 and not self.family.batch:
            self.moved[at.first, 0] = reading
        elif self._angles:
            wide = reading.reshape(count, height, *(reading.shape[1:] or (1,)))
            self.moved[at.first : at.last] = wide.transpose(0, 2, 1)
        if noise is None or count == 1 or not self.grouped:
            return
        within = np.kron(np.eye(count), np.ones((height, height)))
        runs = noise.transpose(2, 0, 1) if noise.ndim > 2 else noise[None]
        self.cross[int(np.searchsorted(self.bounds, at.first, side="right")) - 1] = runs * (
            1.0 - within
        )

    def window(self, first: int, last: int, *, after: bool) -> Sensor:
        """The sensor with the measurements at steps `first` to `last`, its linearisations copied.

        With `after` the measurements at step `first` are left out; that step is still the window's
        step 0.
        """
        begin = self.bounds[first + after]
        rows, part = slice(begin, self.bounds[last + 1]), copy(self)
        for name in ("_by_row", "edges"):
            part.__dict__.pop(name, None)
        if self.robust:
            part.weights = self.weights.rows(rows)
        part.family = self.family.window(rows.start, rows.stop)
        part.order = self.order[rows]
        part.values, part.moved = self.values[rows], self.moved[rows].copy("K")
        part.taken = None if self.taken is None else self.taken[rows]
        part.gated = None if self.gated is None else self.gated.window(rows)
        part.bounds = [max(bound - begin, 0) for bound in self.bounds[first : last + 2]]
        steps = range(first + after, last + 1)
        part.cross = {k - first: self.cross[k] for k in steps if k in self.cross}
        return part

    def copies(self, count: int) -> Sensor:
        """The sensor with all its runs so many times, as of `Family.copies`, without its gate."""
        part = copy(self)
        for name in ("_by_row", "weights"):
            part.__dict__.pop(name, None)
        part.family, part.gated = self.family.copies(count), None
        alone = self.shape[1] == 1
        part.values, part.moved = (
            tiled(array, count, alone=alone) for array in (self.values, self.moved)
        )
        part.taken = None if self.taken is None else tiled(self.taken, count, alone=alone)
        part.cross = {step: np.concatenate([own] * count) for step, own in self.cross.items()}
        return part

    def without(self, rows: Integers) -> Sensor:
        """Of as many copies as rows, each without one of these sightings."""
        part, shape = copy(self), self.moved.shape
        taken = np.broadcast_to(True if self.taken is None else self.taken, shape).copy()
        by_copy = taken.reshape(len(taken), len(rows), -1, shape[-1])
        by_copy[rows, np.arange(len(rows))] = False
        part.taken = taken
        return part

    def put(self, first: int, part: Sensor, *, after: bool) -> None:
        """Copy into this sensor the linearisations, weights and gate decisions of a window `part`.

        `first` and `after` are the arguments with which `window` has made it.
        """
        row = self.bounds[first + after]
        self.family.put(slice(row, row + part.family.step.size), part.family)
        if self.variable.angles:
            self.moved[row : row + len(part.moved)] = part.moved
        if self.robust:
            self.weights.put(slice(row, row + len(part.values)), part.weights)
        if self.gated is not None and part.gated is not None:
            self.gated.put(row, part.gated)
            assert self.taken is not None
            self.taken[row : row + len(part.moved)] = part.taken
        self.cross.update({first + k: between for k, between in part.cross.items()})

    def move(self, rows: slice, predicted: Array, active: Mask | None = None) -> None:
        """Move the measured angles of some rows, in `moved`, to the branch nearest to `predicted`.

        `predicted` (rows, runs, d) are the CPD's values at the point of linearisation. Runs that
        are not `active` (runs,) keep their branches; None means all are active.
        """
        if not self.variable.angles:
            return
        moved = nearest_branch(self.values[rows], predicted, self.variable.angle_mask)
        if active is not None:
            moved = np.where(active[:, None], moved, self.moved[rows])
        self.moved[rows] = moved

    def reading(self, rows: slice | Integers) -> Seen:
        """Some rows with their stored linearisations, for passes over all steps at once."""
        family = self.family
        matrix, offset, value = family.matrix[rows], family.offset[rows], self.moved[rows]
        noise, taken = family.noise[rows], self._taken(rows)
        if taken is None:
            return Seen(matrix, offset, value, noise, None)
        found = step.seen(taken, Stack.column(value), Stack(matrix), Stack(noise))
        parts = found.matrix.array, np.where(taken, offset, 0.0), found.residual.vector
        return Seen(*parts, found.noise.array, taken)

    def noise(self, rows: slice | Integers) -> Array:
        """The noise covariances (k, runs, d, d) of rows; missing components have unit variance."""
        noise, taken = self.family.noise[rows], self._taken(rows)
        return noise if taken is None else independent(noise, taken)

    def between(self, step: int) -> Array | None:
        """The covariances between the errors of a step's sightings, (runs, D, D), if there are any.

        None if none are stored in `cross`. They are of different sightings alone: zero in each
        sighting's own block (d, d), and for missing components.
        """
        cross, taken = self.cross.get(step), self._taken(self.rows(step))
        if cross is None or taken is None:
            return cross
        seen = taken.swapaxes(0, 1).reshape(taken.shape[1], -1)
        return np.where(seen[..., None] & seen[..., None, :], cross, 0.0)

    def _taken(self, rows: slice | Integers) -> Mask | None:
        """The mask of measured components in some rows, (k, runs or 1, d); None for all."""
        if self.taken is None or (taken := self.taken[rows]).all():
            return None
        return taken


def linearise_grouped(
    sensor: Sensor, steps: Integers, mean: Array, cov: Array, active: Mask | None = None
) -> None:
    """Linearise the sightings of steps that have equally many, at beliefs over the slices.

    `steps` (G,) have k sightings each, which are linearised as one vector of D = k d components;
    beliefs are (G, runs, n) and (G, runs, n, n). The sensor's family stores the linearisations, and
    the sensor the covariances between sightings' errors; runs that are not `active` (runs,) keep
    theirs, and None means all.
    """
    family, parents = sensor.family, sensor.parents
    template = family.template
    assert template is not None
    bounds = np.array(sensor.bounds)
    count = int(bounds[steps[0] + 1] - bounds[steps[0]])
    rows = bounds[steps][:, None] + np.arange(count)
    known = [
        np.moveaxis(family.inputs[parent][rows], 1, 2) if place is None else None
        for parent, place in zip(template.given, template.places, strict=True)
    ]
    at = mean[..., parents]
    numbers = family.step[rows[:, 0]]
    told = int(numbers[0]) if numbers.size == 1 else np.broadcast_to(numbers[:, None], at.shape[:2])
    function = BoundFunction(template, known, 2, told, count, True, family.source)
    line = family.checked(function, at, block(cov, parents, parents))
    value, error = components_last(line.value, 1), line.error
    groups, runs, height = len(steps), at.shape[1], template.child.dimension
    full = (groups, runs, count, height)

    def each(stacked: Array) -> Array:
        """An array (G, runs, k, ...) with one sighting a row: (G k, runs, ...)."""
        return np.moveaxis(stacked, 2, 1).reshape(groups * count, runs, *stacked.shape[3:])

    matrix = components_last(line.matrix, 2)
    offset = value - apply(matrix, at)
    own = None
    if error is not None:
        error = components_last(error, 2)
        own = each(np.einsum("grkikj->grkij", error.reshape(*full, count, height)))
    family.store(
        rows.reshape(-1),
        each(matrix.reshape(*full, at.shape[-1])),
        each(offset.reshape(full)),
        own,
        active,
    )
    if error is None or not error.any():
        return
    between = np.kron(1.0 - np.eye(count), np.ones((height, height)))
    for index, number in enumerate(steps.tolist()):
        new = error[index] * between
        if active is not None:
            new = np.where(active[:, None, None], new, sensor.cross.get(number, 0.0))
        sensor.cross[number] = new


def _marked(values: Array, taken: Mask | None) -> Array:
    """Values (M, runs or 1, d), NaN where not taken."""
    if taken is None or taken.all():
        return values
    found: Array = np.where(taken, values, np.nan)
    return found
