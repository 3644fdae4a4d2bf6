"""Results that know a forward pass: innovations, what gates rejected, where beliefs were lost."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property

import numpy as np

from pgm.inference.associations import Found
from pgm.inference.chain.forward import Forward
from pgm.inference.chain.innovations import BySensor, Innovations, by_step, innovations
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.lost import Lost, Read
from pgm.inference.rejections import Rejections, RejectionsBySensor
from pgm.kernels.arrays import quiet
from pgm.variables import Variable


class Innovated(ABC):
    """Base of results that hold a forward pass; computes innovations and such when asked for.

    `_planned` is the plan as it stands, whose linearisations may not all be kept; `associations`
    are the decisions about sightings that left open what was seen, by the sensor's variable.
    """

    _planned: ChainPlan
    associations: Found

    @property
    @abstractmethod
    def _forward(self) -> Forward:
        """The forward pass."""

    @property
    @abstractmethod
    def _plan(self) -> ChainPlan:
        """The plan `_planned`, with the linearisations of the forward pass."""

    @cached_property
    @quiet()
    def innovations(self) -> Mapping[Variable, Innovations]:
        """The innovations of each sensor with evidence, by the sensor's variable."""
        plan, forward = self._plan, self._forward
        return BySensor({s.variable: innovations(plan, s, forward) for s in plan.sensors})

    @property
    def rejected(self) -> Mapping[Variable, Rejections]:
        """The decisions of the schedule's gates, by the variable of each sensor that has a gate."""
        plan = self._planned
        return RejectionsBySensor(
            {
                s.variable: Rejections.of(s.gated, s.family.step, s.order, plan.lead)
                for s in plan.sensors
                if s.gated is not None
            }
        )

    @cached_property
    @quiet()
    def lost(self) -> Lost:
        """The steps at which the belief was probably wrong, by its NIS and by rejections."""
        plan = self._plan
        nis, dof = by_step(plan, plan.read, self._forward)
        rejected, judged = np.zeros_like(dof), np.zeros_like(dof)
        for sensor in plan.read:
            found = None if sensor.gated is None else sensor.gated.judged
            found = sensor.weights.judged(found) if sensor.robust else found
            if found is not None:
                np.add.at(rejected, sensor.family.step, found[0])
                np.add.at(judged, sensor.family.step, found[1])
        read = Read(np.nan_to_num(nis), dof, rejected, judged)
        gated = {sensor.variable for sensor in plan.read if sensor.gated is not None}
        for variable, each in self.associations.items():
            strange, opened = np.zeros_like(dof), np.zeros_like(dof)
            for total, rows in zip(
                (strange, opened), each.judged(gated=variable in gated), strict=True
            ):
                np.add.at(total, each.step, rows)
            read = read.and_(Read.of_open(strange, opened, each.outliers))
        return Lost.of(read, plan.lead)
