"""Sensors whose sightings of a step have correlated errors, swept as one vector of them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.compiled.called import Asked, Call, Lines, Some
from pgm.beliefs.moments.compiled.gates import probability_of
from pgm.beliefs.moments.steps import gate as gates
from pgm.beliefs.moments.steps.open_sensor import OpenSensor
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile.machine import MOST
from pgm.kernels.arrays import Array, Integers, Mask, vacant
from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.sweeps import told
from pgm.variables import Variable


class Stored(NamedTuple):
    """Vectors of sightings with their linearisations, F, b and Q; see `Group`."""

    matrix: Array
    offset: Array
    noise: Array
    readings: Array


class Group:
    """A sensor as one vector of the sightings of a step, of K = `most`, as many as one has.

    A *row* is a step that has any: of S rows, K d components and R runs the arrays are (S, R,
    K d, ...). A step of fewer sightings repeats its last one, which is missing there.
    """

    def __init__(self, sensor: Sensor) -> None:
        self.sensor, self.family = sensor, sensor.family
        bounds = sensor.edges
        counts = np.diff(bounds)
        self.steps: Integers = np.flatnonzero(counts)
        self.most, self.counts = int(counts.max()), counts[self.steps]
        self.first: Integers = bounds[:-1][self.steps]
        self.edges: npt.NDArray[np.int64] = np.concatenate([[0], np.cumsum(counts > 0)])
        place = np.arange(self.most)
        self._there: Mask = place < self.counts[:, None]
        self._sightings = self.first[:, None] + np.minimum(place, self.counts[:, None] - 1)
        self.height = self.most * sensor.height

    def rows(self, row: int) -> tuple[int, int]:
        """The first sighting of a row, and the one behind its last."""
        first = int(self.first[row])
        return first, first + int(self.counts[row])

    def inputs(self, parent: Variable) -> Array:
        """The evidence of a parent, (S, runs or 1, K m)."""
        return self._beside(self.family.inputs[parent])

    @cached_property
    def readings(self) -> Array:
        """The values of the sightings, (S, runs or 1, K d), NaN where nothing was measured."""
        return self._readings(self.sensor.marked)

    @cached_property
    def own_noise(self) -> Array:
        """The covariance of the sensor's own noise, (S or 1, runs or 1, K d, K d)."""
        return self._independent(self.family.own_noise)

    @cached_property
    def known(self) -> Stored:
        """The sightings as they were linearised last."""
        family, sensor = self.family, self.sensor
        noise = self._independent(family.noise)
        for row, step in enumerate(self.steps.tolist()):
            between = sensor.cross.get(step)
            if between is not None:
                due = between.shape[-1]
                noise[row, :, :due, :due] += between
        matrix = family.matrix[self._sightings].swapaxes(1, 2)
        rows, runs, size = len(self.steps), *family.shape[1::2]
        return Stored(
            matrix.reshape(rows, runs, self.height, size),
            self._beside(family.offset),
            noise,
            self._readings(sensor.moved_marked),
        )

    @cached_property
    def matrix(self) -> Array:
        """Where F of the vector is kept, (S, runs, K d, n)."""
        return self._room(self.height, self.family.shape[3])

    @cached_property
    def offset(self) -> Array:
        """Where b is kept, (S, runs, K d)."""
        return self._room(self.height)

    @cached_property
    def noise(self) -> Array:
        """Where Q is kept, (S, runs, K d, K d)."""
        return self._room(self.height, self.height)

    @cached_property
    def moved(self) -> Array:
        """Where readings are kept, their angles on the branch of the linearisation."""
        return self._room(self.height)

    def keep(self) -> None:
        """Store what a sweep has kept with the sensor, sighting by sighting."""
        sensor, family = self.sensor, self.family
        family.keep_errors()
        rows, runs, height, size = len(self.steps), *family.shape[1:]
        shape = rows, runs, self.most, height
        family.matrix[...] = self._apart(self.matrix.reshape(*shape, size))
        family.offset[...] = self._apart(self.offset.reshape(shape))
        if sensor.variable.angles:
            sensor.moved[...] = self._apart(self.moved.reshape(shape))
        noise = self.noise.reshape(*shape, self.most, height)
        own = np.stack([noise[:, :, k, :, k] for k in range(self.most)], axis=2)
        family.noise[...] = self._apart(own)
        within = np.kron(np.eye(self.most), np.ones((height, height)))
        between = self.noise * (1.0 - within)
        for step, count, each in zip(self.steps.tolist(), self.counts, between, strict=True):
            if count > 1:
                due = int(count) * height
                sensor.cross[step] = each[:, :due, :due]

    def _readings(self, values: Array) -> Array:
        there = self._there[:, :, None, None]
        return _flat(np.where(there, values[self._sightings], np.nan))

    def _independent(self, noise: Array) -> Array:
        """Covariances (M or 1, runs or 1, d, d) of sightings on the diagonal of those of rows."""
        blocks = noise[self._sightings] if len(noise) > 1 else noise[:, None].repeat(self.most, 1)
        rows, most, runs, height, _ = blocks.shape
        found = np.zeros((rows, runs, most, height, most, height))
        for k in range(most):
            found[:, :, k, :, k] = blocks[:, k]
        return found.reshape(rows, runs, self.height, self.height)

    def _beside(self, values: Array) -> Array:
        """Values (M, runs, m) of sightings, those of a row beside each other: (S, runs, K m)."""
        return _flat(values[self._sightings])

    def _apart(self, values: Array) -> Array:
        """Values (S, runs, K, ...) of rows, sighting by sighting: (M, runs, ...)."""
        found: Array = np.moveaxis(values, 2, 1)[self._there]
        return found

    def _room(self, *own: int) -> Array:
        return vacant((len(self.steps), self.family.shape[1]), own)


def groups_of(
    plan: ChainPlan, gate: gates.Asked | None, *, stored: bool, controlled: bool
) -> list[Group]:
    """The sensors whose sightings of a step have correlated errors, to be swept as one vector.

    Of others the sightings are weighed, gated, or judged, one by one.
    """
    return [
        Group(sensor)
        for sensor in plan.read
        if sensor.is_correlated
        and not isinstance(sensor, OpenSensor)
        and sensor.family.hidden
        and not (
            sensor.robust or controlled or probability_of(sensor, gate, stored=stored) is not None
        )
        and max(np.diff(sensor.bounds)) * sensor.height <= MOST
    ]


class GroupCall(Call):
    """The function of a group, called for all sightings of a step; see `Call`."""

    def __init__(self, group: Group, count: int) -> None:
        super().__init__(group.family, count, 0)
        height, runs = group.family.shape[2], group.family.shape[1]
        cells = np.zeros((count, group.most, height, runs))
        self._group, self.values = group, cells.swapaxes(0, 1)
        self.told = cells.reshape(1, count, group.height, runs)

    def answer(self, asked: Asked, runs: Some) -> None:
        """Call the function at the sightings of a row, at the first points of some runs."""
        first, after = self._group.rows(asked.first)
        self._answer(Asked(first, after, 0, asked.points), runs)
        values, count = self.values[:, : asked.points], after - first
        values[count:][..., runs] = values[count - 1 : count][..., runs]


class GroupLines(Lines):
    """A group that is linearised here, by its lineariser; see `Lines`."""

    def __init__(self, group: Group) -> None:
        super().__init__(group.family, 1)
        self._group = group
        runs, size = group.family.shape[1], group.family.shape[3]
        self.value = np.zeros((1, group.height, runs))
        self.matrix = np.zeros((1, group.height, size, runs))
        self.error = np.zeros((1, group.height, group.height, runs))

    def answer(self, asked: Asked, runs: Some) -> None:
        """Linearise the sightings of a row, as one vector, for some runs."""
        assert self.error is not None
        first, after = self._group.rows(asked.first)
        line = self._line(Asked(first, after, 0, 0), runs)
        due = len(line.value)
        for cells, part in ((self.value, line.value), (self.matrix, line.matrix)):
            cells[0, due:][..., runs] = 0.0
            cells[0, :due][..., runs] = part
        self.error[0][..., runs] = 0.0
        if line.error is not None:
            self.error[0, :due, :due][..., runs] = line.error


def together(function: Function, widths: Sequence[int], count: int) -> Function:
    """A function at so many sightings, as one of a vector; the observed arguments lie side by side.

    Each argument has its width; component i of sighting k is the component k m + i of one of m.
    """
    size, operations = len(function.operations), []
    hidden = set(function.hidden)
    observed, value, slope = [], [], []
    for k in range(count):

        def column(argument: int, i: int, k: int = k) -> tuple[int, int]:
            return argument, i if (argument, i) in hidden else k * widths[argument] + i

        for name, *operands in function.operations:
            if name == "input":
                operands = column(*operands)
            elif name != "constant":
                operands = [operand + k * size for operand in operands]
            operations.append((name, *operands))
        observed += [column(*each) for each in function.observed]
        value += [place + k * size for place in function.value]
        slope += [None if place is None else place + k * size for place in function.slope]
    return Function(tuple(operations), tuple(value), tuple(slope), function.hidden, tuple(observed))


def widened(rule: told.Points, count: int) -> told.Points:
    """The points of a rule for so many sightings."""
    return replace(rule, variances=rule.variances * count)


def _flat(values: Array) -> Array:
    """Values (S, K, runs, m) of rows, side by side: (S, runs, K m)."""
    rows, most, runs, width = values.shape
    return values.swapaxes(1, 2).reshape(rows, runs, most * width)
