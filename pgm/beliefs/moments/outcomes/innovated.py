"""The base class of results that hold a forward pass.

From that pass it finds the innovations, the gates' rejections, and the steps at which beliefs were
lost, which is to say wrong by more than their covariance admits.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property

import numpy as np

from pgm.beliefs.moments.outcomes.innovations import by_step, innovations, measured
from pgm.beliefs.moments.passes.forward import Filtered, Forward
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels.arrays import Array, Integers, quiet
from pgm.posteriors.associations import Found
from pgm.posteriors.innovations import BySensor, Innovations
from pgm.posteriors.lost import Lost, Read
from pgm.posteriors.rejections import Rejections, RejectionsBySensor
from pgm.variables import Variable


class Innovated(ABC):
    """Base of results that hold a forward pass; its properties are computed when asked for.

    `_planned` is the plan of the pass, in which the pass may have left no linearisations, and
    `_swept` the pass as it was made, which may have kept no predicted beliefs.
    `associations` are, by the sensor's variable, the decisions about sightings (single measurements
    of a sensor) of unknown identity, such as of which landmark of a map.
    """

    _planned: ChainPlan
    _swept: Forward | Filtered
    associations: Found

    @property
    @abstractmethod
    def _forward(self) -> Forward:
        """The forward pass."""

    @property
    @abstractmethod
    def _plan(self) -> ChainPlan:
        """The plan `_planned` with the linearisations of the forward pass.

        If that pass left none in it, it is made again first.
        """

    @cached_property
    @quiet()
    def innovations(self) -> Mapping[Variable, Innovations]:
        """The innovations of each sensor with evidence, by the sensor's variable."""
        plan, forward = self._plan, self._forward
        return BySensor({s.variable: innovations(plan, s, forward) for s in plan.sensors})

    @property
    @quiet()
    def _squares(self) -> Mapping[Variable, tuple[Array, Integers]]:
        """The NIS of each sensor with evidence by step, and its degrees of freedom.

        They are those that the sweep has kept, else those of `innovations`.
        """
        plan, kept = self._planned, self._swept.squares
        none, shape = np.zeros((plan.steps + 1, plan.runs)), (*plan.lead, plan.steps + 1)
        if kept:
            own = dict(zip((s.variable for s in plan.read), kept, strict=True))
            found = {
                s.variable: (own.get(s.variable, none), measured(plan, s)) for s in plan.sensors
            }
        else:
            plan, forward = self._plan, self._forward
            found = {s.variable: by_step(plan, [s], forward) for s in plan.sensors}
        return {z: (nis.T.reshape(shape), dof.T.reshape(shape)) for z, (nis, dof) in found.items()}

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
        """The steps at which the belief was probably wrong.

        They are found by tests of the NIS (normalised innovation squared) and of how many sightings
        were rejected by gates and robust noise, or associated with no candidate.
        """
        if self._swept.nis is None:
            plan = self._plan
            nis, dof = by_step(plan, plan.read, self._forward)
        else:
            plan, nis = self._planned, self._swept.nis
            dof = measured(plan)
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

    @property
    def _held(self) -> bool | None:
        """Whether the sweep itself tells that its belief was never lost; None if it has no verdict.

        Of sightings of unknown identity it knows nothing.
        """
        return None if self.associations else self._swept.held
