"""A filter's sweep of a plan whose evidence lies on a card, into beliefs that stay there.

The plan is told with arrays that stand in for the card's: of the same shapes, with the numbers of
one row for all of them. Where these lie, and how, is told to the sweep in their place.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pgm.beliefs.moments.compiled.card import OnCard
from pgm.beliefs.moments.compiled.groups import groups_of
from pgm.beliefs.moments.compiled.named_table import NamedTable
from pgm.beliefs.moments.compiled.sweep import BEGIN, KNOWN, begun, told_ahead
from pgm.beliefs.moments.compiled.table import Record
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled, unknown
from pgm.beliefs.moments.steps.open_sensor import OpenSensor
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.evidence.on_card import Lying, Places
from pgm.kernels.arrays import Array, address, vacant
from pgm.kernels.machine.emitter.driver import Device, Held
from pgm.kernels.machine.sweeps import chain as sweeps
from pgm.kernels.machine.sweeps import told
from pgm.linearisation.family import Family
from pgm.resources import NUMBER
from pgm.schedules.schedule import ONCE
from pgm.variables import Variable


class Cells(NamedTuple):
    """Numbers on a card, (rows, cells, runs), the runs fastest: where they lie."""

    memory: Held
    rows: int
    cells: int
    runs: int

    @classmethod
    def empty(cls, device: Device, rows: int, cells: int, runs: int) -> Cells:
        """Room for so many."""
        return cls(device.held(NUMBER * rows * cells * runs), rows, cells, runs)

    @property
    def distances(self) -> tuple[int, int, int]:
        """The floats from row to row, from run to run, and from cell to cell."""
        return self.cells * self.runs, 1, self.runs

    def copy(self, runs: slice) -> Array:
        """The numbers of successive runs, copied to this machine's memory: (rows, cells, runs)."""
        found = np.empty((self.rows, self.cells, runs.stop - runs.start))
        self._move(self.memory.device.get, found, runs)
        return found

    def fill(self, numbers: Array, runs: slice) -> None:
        """Put numbers (rows, cells, runs) of successive runs there."""
        self._move(self.memory.device.put, np.ascontiguousarray(numbers), runs)

    def _move(self, move: Any, here: Array, runs: slice) -> None:
        width, lines = NUMBER * (runs.stop - runs.start), self.rows * self.cells
        place = self.memory.address + NUMBER * runs.start
        move(place, address(here), width, lines, width, NUMBER * self.runs)


@dataclass(frozen=True, eq=False)
class Known:
    """A filter's means, covariances and log-densities on a card, and what it told of each run.

    They are (T+1, n, runs), (T+1, n², runs) and (T+1, 1, runs); `ended` is as of `sweeps.TOLD`.
    """

    mean: Cells
    cov: Cells
    density: Cells
    ended: Array


class _Unseen(Sensor):
    """A sensor whose measurements lie on a card, where NaN marks what was not measured."""

    @property
    def marked(self) -> Array:
        """What stands in for the measurements."""
        return self.values


def with_missing(sensor: Sensor) -> Sensor:
    """A sensor, of whose measurements on a card some are missing, of which no array tells."""
    found = object.__new__(_Unseen)
    none = np.broadcast_to(False, (1, 1, sensor.height))
    found.__dict__.update(sensor.__dict__, taken=none)
    return found


def require_known(plan: ChainPlan, places: Places) -> None:
    """Raise an Uncompiled for a plan that is not swept where its evidence lies."""
    why = unknown(plan)
    if why is None and groups_of(plan, None, stored=False, controlled=False):
        why = "sightings of a step are grouped"
    for sensor in plan.read:
        if sensor.robust or isinstance(sensor, OpenSensor):
            why = why or f"{sensor.family.cpd!r} has robust noise"
    for key, family in _read(plan):
        for parent in family.inputs:
            if _lying(places, key, parent) is None:
                continue
            if family.template is None:
                why = why or f"{family.cpd!r} is linear in an input; make it a NonlinearGaussianCPD"
            if family.noisy:
                why = why or f"the noise of {family.cpd!r} depends on its inputs"
            if (np.diff(family.step) != 1).any() and (key, parent) not in places:
                why = why or f"give {parent!r} in the given= of the sightings of {key!r}"
    if why is not None:
        raise Uncompiled(why)


def sweep(plan: ChainPlan, places: Places, device: Device) -> Known:
    """Filter a plan into beliefs on the card; an Uncompiled says why it cannot be swept there."""
    require_known(plan, places)
    size, steps, runs = plan.layout.slice_size, plan.steps, plan.runs
    mean, cov, density = (Cells.empty(device, steps + 1, k, runs) for k in (size, size**2, 1))
    record: Record = dict(zip(BEGIN, begun(plan, ONCE, keep=False), strict=True))
    record |= zip(KNOWN, _standing(plan), strict=True)
    owners = *(family for _, family in _read(plan)), *plan.read, record
    table = NamedTable(plan, 1, owners, record, None)
    chain = told_ahead(plan, table, (), stored=False, keep=False, gate=None, controlled=False)
    numbers, arrays = table.filled(steps, runs, 1)
    ended = np.zeros((sweeps.TOLD, runs))
    numbers[told.ENDED] = address(ended)
    there = dict(_there(plan, chain, places, (mean, cov, density)))
    for place, (first, distances) in there.items():
        numbers[[place, place + told.DOWN, place + told.ACROSS, place + told.CELL]] = (
            first,
            *distances,
        )
    here = {place: array for place, array in arrays.items() if place not in there}
    OnCard(chain)(numbers, {**here, told.ENDED: ended}, runs, list(there))
    return Known(mean, cov, density, ended)


# The address of an array on the card, and its distances from row to row, run to run, cell to cell.
_Where = tuple[int, tuple[int, int, int]]


def _there(
    plan: ChainPlan, chain: told.Forward, places: Places, known: Sequence[Cells]
) -> Iterator[tuple[int, _Where]]:
    """Where the arrays of a chain lie that are on the card, by their places in its table."""
    for array, own in zip((*chain.known, chain.density), known, strict=True):
        yield array.place, (own.memory.address, own.distances)
    for sensor, told_sensor in zip(plan.read, chain.sensors, strict=True):
        found = places.get((sensor.variable, sensor.variable))
        if found is not None:
            yield told_sensor.readings.place, (found.address, found.distances)
    for (key, family), row in zip(_read(plan), (*chain.motions, *chain.sensors), strict=True):
        for parent, array in zip(_observed(family), row.inputs, strict=True):
            found = _lying(places, key, parent)
            if found is None:
                continue
            # Plain arrays begin at step 1, those of sightings at the first of them.
            skipped = 0 if (key, parent) in places else int(family.step[0]) - 1
            first = found.address + NUMBER * skipped * found.distances[0]
            yield array.place, (first, found.distances)


def _lying(places: Places, key: Variable, parent: Variable) -> Lying | None:
    """The numbers on the card of an observed parent of a CPD, whose child is `key`."""
    return places.get((key, parent)) or places.get((parent, parent))


def _read(plan: ChainPlan) -> list[tuple[Variable, Family]]:
    """The CPDs that a sweep linearises, by their children: of the transition, then of sensors."""
    families = [link.family for link in plan.transition]
    families += [sensor.family for sensor in plan.read]
    return [(family.cpd.child, family) for family in families]


def _observed(family: Family) -> list[Variable]:
    """The observed arguments of a CPD's function, in their order."""
    template = family.template
    if template is None:
        return []
    pairs = zip(template.given, template.places, strict=True)
    return [parent for parent, place in pairs if place is None]


def _standing(plan: ChainPlan) -> Iterator[Array]:
    """Arrays that stand in for means, covariances and log-densities, of one step's memory."""
    size = plan.layout.slice_size
    for own in ((size,), (size, size), ()):
        step = vacant((1, plan.runs), own)
        yield np.broadcast_to(step, (plan.steps + 1, *step.shape[1:]))
