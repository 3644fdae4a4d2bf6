"""The memory of a bound call: which arrays a sweep fills, and where they lie in three blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import NamedTuple

import numpy as np
from numpy.lib.array_utils import byte_bounds

from pgm.beliefs.moments.compiled.gates import rejected_by, undecided
from pgm.beliefs.moments.compiled.key import keeps_errors
from pgm.beliefs.moments.compiled.sweep import is_iterated, settings
from pgm.beliefs.moments.compiled.table import Record
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import Array, vacant
from pgm.kernels.machine.sweeps import chain as sweeps
from pgm.linearisation.family import Family
from pgm.schedules.schedule import Filtering

# A mean and a covariance of each step.
Pair = tuple[Array, Array]


class Sweeps(NamedTuple):
    """The sweeps of a call: forward, by the schedule of a filter, and back if it smooths.

    `keep` says whether the linearisations and the predicted beliefs are part of its outcome.
    """

    schedule: Filtering
    back: bool
    keep: bool


class View(NamedTuple):
    """An array in one of a call's blocks of memory."""

    block: int
    begin: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]

    def of(self, blocks: Sequence[Array]) -> Array:
        """The array in these blocks."""
        return np.ndarray(self.shape, float, blocks[self.block], self.begin, self.strides)

    def numbers(self, blocks: Sequence[Array]) -> list[float]:
        """The numbers of an array that has no gaps, in a third of the time."""
        first = self.begin // 8
        found: list[float] = blocks[self.block][first : first + prod(self.shape)].tolist()
        return found


class _Owned(NamedTuple):
    """An array that a plan has: who owns it there, its name, and where it lies."""

    of: Callable[[ChainPlan], object]
    name: str
    view: View


class Room:
    """The arrays of a call in three blocks.

    Two are the means and the covariances that users ask for first, and keep; the other has the
    rest. Linearisations lie `like` those of the plan, or with the runs side by side.
    """

    def __init__(self, plan: ChainPlan, made: Sweeps, *, like: bool = False) -> None:
        self.sweeps, self._sizes = made, [0, 0, 0]
        size, own = plan.layout.slice_size, made.schedule
        steps = plan.steps + 1, plan.runs
        belief = (steps, (size,)), (steps, (size, size))
        self.shown = [self._take(*each, block) for block, each in enumerate(belief, 1)]
        self.predicted = [self._take(*each) for each in belief]
        self.known = [self._take(*each) for each in belief] if made.back else self.shown
        self.density = self._take(steps)
        self.ended = [self._take((sweeps.TOLD, plan.runs)) for _ in range(1 + made.back)]
        self.residuals: View | None = None
        self.settings = settings(own)
        if is_iterated(plan, own):
            self.residuals = self._take((own.iterations + 1, plan.runs))
        # By its name in a record what a gate decides; by the number of a sensor moved readings.
        record = undecided(plan, own.gate, stored=False)
        self._decided = {name: self._take(each.shape) for name, each in record.items()}
        self._moved: dict[int, View] = {}
        # The numbers of the families whose noise has errors of linearisations.
        self._uncertain: list[int] = []
        self._owned: list[_Owned] = []
        for k, family in enumerate(plan.families):
            if made.keep and family.step.size:
                self._keep_lines(k, family, like=like)
        for k, sensor in enumerate(plan.sensors):
            if sensor.family.step.size:
                self._keep_readings(k, sensor)

    def _keep_lines(self, k: int, family: Family, *, like: bool) -> None:
        """Take memory for the linearisations of a CPD, by its number."""
        lead, own = family.shape[:2], family.shape[2:]

        def of(plan: ChainPlan) -> Family:
            return plan.families[k]

        if like and not family.exact:
            for name in ("matrix", "offset"):
                self._owned.append(_Owned(of, name, self._take_like(getattr(family, name))))
        elif not family.exact:
            self._own(of, "matrix", lead, own)
            self._own(of, "offset", lead, own[:1])
        if keeps_errors(family):
            self._own(of, "noise", lead, own[:1] * 2)
            self._uncertain.append(k)

    def _keep_readings(self, k: int, sensor: Sensor) -> None:
        """Take memory for moved readings, weights, and squares of a sensor, by its number."""
        if self.sweeps.keep and sensor.variable.angles:
            lead, own = sensor.family.shape[:2], sensor.family.shape[2:3]
            self._moved[k] = self._own(lambda plan: plan.sensors[k], "moved", lead, own)
        if sensor.robust:
            for name in ("weight", "square"):
                self._own(lambda plan: plan.sensors[k].weights, name, sensor.shape)
        if rejected_by(sensor) in self._decided:
            self._own(lambda plan: plan.sensors[k].gated, "square", sensor.shape)

    def _own(
        self,
        of: Callable[[ChainPlan], object],
        name: str,
        lead: tuple[int, ...],
        own: tuple[int, ...] = (),
    ) -> View:
        """Take memory for an array that a plan has, by its owner and its name there."""
        self._owned.append(_Owned(of, name, self._take(lead, own)))
        return self._owned[-1].view

    def _take_like(self, array: Array) -> View:
        """Take memory for an array that lies as another one."""
        first, last = byte_bounds(array)
        if last - first != array.nbytes:
            raise Uncompiled("linearisations have gaps")
        begin = self._sizes[0]
        self._sizes[0] += array.size
        return View(0, 8 * begin, array.shape, array.strides)

    def _take(self, lead: tuple[int, ...], own: tuple[int, ...] = (), block: int = 0) -> View:
        begin, length = self._sizes[block], prod(lead) * prod(own)
        self._sizes[block] += length
        like = vacant(lead, own)
        return View(block, 8 * begin, like.shape, like.strides)

    @property
    def blocks(self) -> list[Array]:
        """New blocks."""
        return list(map(np.empty, self._sizes))

    def give(self, plan: ChainPlan, blocks: Sequence[Array]) -> None:
        """Give a plan its arrays in some blocks."""
        for of, name, view in self._owned:
            setattr(of(plan), name, view.of(blocks))
        families = plan.families
        for k in self._uncertain:
            families[k].approximate = True

    def record(self, blocks: Sequence[Array]) -> Record:
        """By name what gates decide in some blocks."""
        return {name: view.of(blocks) for name, view in self._decided.items()}

    def begin(self, evidence: BoundEvidence, blocks: Sequence[Array]) -> None:
        """Write what a sweep changes: the readings that it moves, as they are before; residuals."""
        for k, view in self._moved.items():
            view.of(blocks)[...] = evidence.readings[k].values
        if self.residuals is not None:
            self.residuals.of(blocks)[...] = 0.0
