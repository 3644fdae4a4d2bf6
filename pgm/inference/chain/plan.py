"""Plans: what a schedule on a chain will do, laid out once, before any number flows.

A sweep goes through rounds, one a step; a round is a few batched kernel calls on rows of arrays
that have the time axis first and the runs second. Reversing a chain, and relinearising it, is one
round for all steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.compile import DynamicGraph, SliceLayout
from pgm.compile.layout import Place
from pgm.cpds import AffineCPD
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence, Reading
from pgm.evidence.dynamic_layout import Inputs
from pgm.factors.scope import Scope
from pgm.inference.family import Family
from pgm.inference.rows import At
from pgm.kernels import along_runs, roots
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import (
    Array,
    Index,
    Integers,
    Kind,
    Mask,
    components_first,
    cut,
    independent,
)
from pgm.linearisers import Lineariser
from pgm.variables import Variable


@dataclass(eq=False)
class Link:
    """A family in place: where its hidden parents and its child stand.

    For the prior both stand in the vector of states, for the transition in that of the pair.

    Attributes
    ----------
    family : Family
    parents, child : Index
    angles, before : ndarray of int
        The child's components that are angles, and where those of the step before stand; empty
        where the child does not depend on itself.
    """

    family: Family
    parents: Index
    child: slice
    angles: Integers
    before: Integers

    @cached_property
    def turning(self) -> list[tuple[int, int]]:
        """Each of these angles, and where that of the step before stands."""
        return list(zip(self.angles.tolist(), self.before.tolist(), strict=True))


class Seen(NamedTuple):
    """Some readings of a sensor as it is linearised, z = F x + b + n.

    A missing component is one of unit variance that says nothing: zero in F, b and z.

    Attributes
    ----------
    matrix, offset, value, noise : ndarray
        F, b, z with angles moved, and the noise: (k, runs, ...).
    taken : ndarray of bool or None
        (k, runs or 1, d): which components are there; None where none is missing.
    """

    matrix: Array
    offset: Array
    value: Array
    noise: Array
    taken: Mask | None

    @property
    def missing(self) -> Integers:
        """How many components of each reading are missing, (k, runs or 1)."""
        none: Integers = np.zeros((1, 1), dtype=np.intp)
        return none if self.taken is None else (~self.taken).sum(axis=-1)


@dataclass(eq=False)
class Sensor:
    """A sensor's family in place, with its readings sorted by step.

    Attributes
    ----------
    parents : Index
        Where its hidden parents stand in the slice vector.
    taken : ndarray of bool or None
        (M, runs or 1, d): which components were; None where none is missing.
    values : ndarray
        (M, runs or 1, d), as given.
    bounds : list of int
        The readings of step t are the rows bounds[t] to bounds[t + 1].
    cross : dict of int to ndarray
        By step, the covariances between different sightings' approximation errors, (runs, D, D),
        of a grouped sensor.
    whole : bool
        Whether its hidden parents are all of the slice.
    """

    family: Family
    parents: Index
    order: Integers
    taken: Mask | None
    values: Array
    bounds: list[int]
    cross: dict[int, Array]
    whole: bool

    @property
    def grouped(self) -> bool:
        """Whether the sightings of a step are linearised as one vector."""
        return self.family.grouped

    @cached_property
    def moved(self) -> Array:
        """The values, angles moved to the branch nearest the CPD's value where linearised.

        (M, runs, d); a copy where there are angles, to be written to.
        """
        count, runs, height, _ = self.family.shape
        wide = np.broadcast_to(self.values, (count, runs, height))
        return wide.copy("K") if self.variable.angles else wide

    @cached_property
    def height(self) -> int:
        """Components of a sighting."""
        return self.variable.dimension

    @cached_property
    def plain(self) -> bool:
        """Whether it reads the whole slice, with some noise."""
        return self.whole and not self.exact

    @cached_property
    def exact(self) -> bool:
        """Whether the noise of some reading is singular."""
        return bool(roots.determined(roots.root(self.family.own_noise)).any())

    def rows(self, step: int) -> slice:
        """The readings of a step."""
        return slice(self.bounds[step], self.bounds[step + 1])

    @cached_property
    def variable(self) -> Variable:
        """The reading's variable."""
        return self.family.cpd.child

    def turning(self, height: int) -> list[int]:
        """The places of angles among so many components of sightings."""
        if not self._angles or height == self.height:
            return self._angles
        return [first + angle for first in range(0, height, self.height) for angle in self._angles]

    @cached_property
    def _angles(self) -> list[int]:
        return [int(k) for k in np.flatnonzero(self.variable.angle_mask)]

    def sharpness(self, noise: Array) -> Array | None:
        """The `along_runs.sharpness` of a noise that is the same at all steps."""
        return self._sharpness if noise is self._constant else None

    @cached_property
    def _constant(self) -> Array | None:
        return self.family._own(0, 1) if len(self.family.own_noise) == 1 else None

    @cached_property
    def _sharpness(self) -> Array:
        assert self._constant is not None
        return along_runs.sharpness(self._constant)

    def at(self, step: int, *, stored: bool) -> tuple[At, Array, Mask | None] | None:
        """The CPD at a step's readings, their values, and which components are there.

        The latter two, (D, *batch), one for all with a batch of one; None where nothing is read.
        Stored readings are as they were linearised, their angles where they were moved to.
        """
        first, last = self.bounds[step], self.bounds[step + 1]
        if first == last:
            return None
        taken = self._taken(slice(first, last))
        flat = None if taken is None else self._flat(taken)
        if not stored:
            return self.family.at(first, last), self._flat(self.values[first:last]), flat
        at = self.family.stored_at(first, last)
        cross = self.cross.get(step)
        if cross is not None:
            at = at._replace(
                noise=at.noise + (components_first(cross, 2) if self.family.batch else cross[0])
            )
        return at, self._flat(self.moved[first:last]), flat

    def _flat(self, rows: npt.NDArray[Kind]) -> npt.NDArray[Kind]:
        """Some rows (k, runs or 1, d) as one vector, (k d, *batch)."""
        if not self.family.batch:
            return rows.reshape(-1)
        return rows.transpose(0, 2, 1).reshape(-1, rows.shape[1])

    def keep(self, at: At, reading: Array, noise: Array | None) -> None:
        """Keep where angles were moved to, and the covariances between sightings' errors."""
        count, height = at.last - at.first, self.height
        if self._angles:
            wide = reading.reshape(count, height, *(reading.shape[1:] or (1,)))
            self.moved[at.first : at.last] = wide.transpose(0, 2, 1)
        if noise is None or count == 1 or not self.grouped:
            return
        within = np.kron(np.eye(count), np.ones((height, height)))
        runs = noise.transpose(2, 0, 1) if noise.ndim > 2 else noise[None]
        self.cross[int(np.searchsorted(self.bounds, at.first, side="right")) - 1] = runs * (
            1.0 - within
        )

    def move(self, rows: slice, predicted: Array, active: Mask | None = None) -> None:
        """Move angles to the branch nearest the CPD's values at the point of linearisation."""
        if not self.variable.angles:
            return
        moved = nearest_branch(self.values[rows], predicted, self.variable.angle_mask)
        if active is not None:
            moved = np.where(active[:, None], moved, self.moved[rows])
        self.moved[rows] = moved

    def reading(self, rows: slice | Integers) -> Seen:
        """Some rows, for beliefs to be conditioned on."""
        family = self.family
        matrix, offset, value = family.matrix[rows], family.offset[rows], self.moved[rows]
        noise, taken = family.noise[rows], self._taken(rows)
        if taken is None:
            return Seen(matrix, offset, value, noise, None)
        return Seen(
            np.where(taken[..., None], matrix, 0.0),
            np.where(taken, offset, 0.0),
            np.where(taken, value, 0.0),
            independent(noise, taken),
            taken,
        )

    def noise(self, rows: slice | Integers) -> Array:
        """The noise of some rows, of unit variance where components are missing."""
        noise, taken = self.family.noise[rows], self._taken(rows)
        return noise if taken is None else independent(noise, taken)

    def between(self, step: int) -> Array | None:
        """The covariances between a step's sightings, (runs, D, D), zero where one is missing."""
        cross, taken = self.cross.get(step), self._taken(self.rows(step))
        if cross is None or taken is None:
            return cross
        seen = taken.swapaxes(0, 1).reshape(taken.shape[1], -1)
        return np.where(seen[..., None] & seen[..., None, :], cross, 0.0)

    def _taken(self, rows: slice | Integers) -> Mask | None:
        """Which components of some rows were taken, (k, runs or 1, d); None for all."""
        if self.taken is None or (taken := self.taken[rows]).all():
            return None
        return taken


@dataclass(eq=False)
class ChainPlan:
    """A chain of slices with its evidence, ready to be swept.

    Attributes
    ----------
    layout : SliceLayout
    steps, runs : int
        T, and the number of runs, flattened to one axis.
    lead : tuple of int
        The axes of runs as the user gave them.
    prior, transition : list of Link
    sensors : list of Sensor
    first : int
        The number of the plan's first step: other than zero online, where it is the only one.
    """

    layout: SliceLayout
    steps: int
    lead: tuple[int, ...]
    prior: list[Link]
    transition: list[Link]
    sensors: list[Sensor]
    first: int = 0

    @cached_property
    def linear(self) -> bool:
        """Whether no sensor that is read needs a linearisation."""
        return all(s.family.exact for s in self.sensors if s.family.step.size)

    @cached_property
    def runs(self) -> int:
        """Number of runs."""
        return math.prod(self.lead)

    @cached_property
    def batch(self) -> tuple[int, ...]:
        """The axes of runs in a sweep: none of one run."""
        return () if self.runs == 1 else (self.runs,)

    @property
    def families(self) -> list[Family]:
        """All families."""
        links = [link.family for link in (*self.prior, *self.transition)]
        return links + [sensor.family for sensor in self.sensors]

    @property
    def exact(self) -> bool:
        """Whether every CPD is affine."""
        return all(family.exact for family in self.families)

    def of(self, runs: slice) -> ChainPlan:
        """The plan of some runs, with views of these arrays; what is linearised is its own."""

        def links(every: list[Link]) -> list[Link]:
            return [replace(link, family=link.family.of(runs)) for link in every]

        sensors = [
            replace(
                sensor,
                family=sensor.family.of(runs),
                taken=None if sensor.taken is None else cut(sensor.taken, runs),
                values=cut(sensor.values, runs),
                cross={},
            )
            for sensor in self.sensors
        ]
        lead = (runs.stop - runs.start,)
        return replace(
            self,
            lead=lead,
            prior=links(self.prior),
            transition=links(self.transition),
            sensors=sensors,
        )

    @classmethod
    def make(
        cls,
        graph: DynamicGraph,
        bound: BoundEvidence,
        lineariser: Lineariser,
        *,
        first: int = 0,
        prior: bool = True,
        probe: bool = True,
    ) -> ChainPlan:
        """Lay out the families of a graph with evidence, and probe their functions.

        Online, where a plan is for one step alone, `first` is that step.
        """
        layout, lead = graph.layout, bound.lead

        def family(cpd: Any, place: Place, step: Integers, inputs: Inputs) -> Family:
            return Family.make(
                cpd,
                place.hidden,
                step,
                inputs,
                lineariser,
                lead,
                template=place.template,
                first_run=bound.first_run,
            )

        def link(cpd: Any, scope: Scope, step: Integers, inputs: Inputs) -> Link:
            place = layout.place(cpd, scope)
            turning = slice(0 if isinstance(cpd, AffineCPD) else None)
            return Link(
                family(cpd, place, step, inputs),
                place.parents,
                place.child,
                place.angles[turning],
                place.before[turning],
            )

        def sensor(reading: Reading) -> Sensor:
            place = layout.place(reading.cpd, layout.slice)
            made = family(reading.cpd, place, reading.step + first, reading.inputs)
            return _sensor(made, place, reading, layout, bound.steps)

        start, later = np.zeros(1, dtype=np.intp), np.arange(bound.steps) + max(first, 1)
        priors = layout.model.prior if prior else ()
        links = [link(cpd, layout.states, start, {}) for cpd in priors]
        transition = [
            link(cpd, layout.pair, later, inputs)
            for cpd, inputs in zip(layout.model.transition, bound.transition, strict=False)
        ]
        sensors = [sensor(reading) for reading in bound.readings]
        plan = cls(layout, bound.steps, lead, links, transition, sensors, first)
        if not probe:
            return plan
        means = {
            cpd.child: cpd.offset.reshape(-1, cpd.child.dimension)[0]
            for cpd in layout.model.prior
            if isinstance(cpd, AffineCPD)
        }
        for made in plan.families:
            # A graph is probed once; what comes back is checked in every call.
            if made.cpd not in layout.probed:
                made.probe(means)
                layout.probed.update([made.cpd] * bool(made.step.size))
        return plan


def _sensor(
    family: Family, place: Place, reading: Reading, layout: SliceLayout, steps: int
) -> Sensor:
    number = int(family.step[0]) if family.step.size else 1
    for parent in family.hidden:
        if number == 0 and parent not in layout.states:
            raise EvidenceError(
                f"a sighting of {family.cpd.child!r} at step 0, where its parent {parent!r} does "
                "not exist; controls begin at step 1",
                variable=family.cpd.child,
                cpd=family.cpd,
                step=0,
            )
    bounds = np.searchsorted(reading.step, np.arange(steps + 2)).tolist()
    return Sensor(
        family,
        place.parents,
        reading.order,
        None if reading.taken.all() else reading.taken,
        reading.values,
        bounds,
        {},
        isinstance(place.parents, slice) and place.parents == slice(0, layout.slice_size),
    )
