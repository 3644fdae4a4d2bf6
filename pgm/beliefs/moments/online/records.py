"""Records of a compiled step online, which stand behind the numbers of its belief.

They are the status of its iterations, the decisions of its gates, how its transition was
linearised, and its evidence; `kernels.machine.sweeps.online` says how they lie. They are read when
they are asked for.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from pgm.beliefs.moments.online.judged import Decided, decided
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.evidence import Sightings
from pgm.kernels.arrays import Array, Mask
from pgm.kernels.machine.sweeps import online, told
from pgm.posteriors.status import Status
from pgm.schedules.convergence import tell_online
from pgm.schedules.gates import gate_of
from pgm.schedules.schedule import Filtering
from pgm.variables import Variable


class Form(NamedTuple):
    """A variable of a step's evidence: a row, or sightings and the parents given with them.

    `parents` is None of a row (d,), else the parents that are given with the sightings (M, d).
    """

    variable: Variable
    parents: tuple[Variable, ...] | None


class Records:
    """The records of a kind of steps, made from the plan of its first one, and a schedule.

    `once` is the status of a belief after a step that settles nothing. `gates` are the
    probabilities of the gates that decide in it, by sensor; `iterated` says whether measurements
    are linearised again. `warns` says that steps may end unsettled, of which a call has to warn.
    `motions` are the CPDs of its transition, as machine code was told of them; `evidence` says how
    the values lie that the step was given.
    """

    motions: tuple[told.Motion, ...] = ()
    evidence: tuple[Form, ...] = ()

    def __init__(self, plan: ChainPlan, schedule: Filtering, once: Status) -> None:
        self._plan, self._schedule, self._once = plan, schedule, once
        asked = {each.variable: gate_of(schedule.gate, each.variable) for each in plan.read}
        self.gates = {variable: gate for variable, gate in asked.items() if gate is not None}
        again = schedule.iterations > 1
        self.iterated = again and any(sensor.family.template for sensor in plan.read)
        self._robust = bool(plan.robust)
        self.warns = again and (self.iterated or self._robust)

    def tell(self, found: bytes, size: int) -> None:
        """Warn, if a step has not settled, whose belief has `size` bytes of those `found`."""
        if self.warns:
            tell_online(self._converged(np.frombuffer(found, offset=size)), self._schedule)

    def status(self, numbers: Array) -> Status:
        """The status of a step that has left these numbers."""
        if not (self.iterated or self._robust):
            return self._once
        residuals = self._iterations(numbers)
        count = int(residuals[-2]) if self.iterated else 0
        return Status.of(list(residuals[:count, None]), self._converged(numbers), ())

    def decided(self, numbers: Array) -> tuple[Decided, ...]:
        """The decisions of gates in a step that has left these numbers."""
        found = []
        numbers = numbers[int(self._robust) + len(self._iterations(numbers)) :]
        for variable, gate in self.gates.items():
            count = int(numbers[0])
            square, rejected = numbers[1 : 1 + count], numbers[1 + count : 1 + 2 * count]
            found.append(decided(variable, gate, rejected != 0.0, square, np.arange(count)))
            numbers = numbers[1 + 2 * count :]
        return tuple(found)

    def transition(self, numbers: Array) -> ChainPlan:
        """The plan of a transition, as it was linearised by a step that has left these numbers.

        Offsets of affine CPDs with inputs are those of the kind's first step: no reversal reads
        them.
        """
        plan = self._plan.window(0, 1)
        for link, motion in zip(plan.transition, self.motions, strict=True):
            family = link.family
            if motion.kept is not None:
                family.keep_errors()
            rooms = family.matrix, family.offset, family.noise
            for array, room in zip(online.kept(motion), rooms, strict=False):
                count = math.prod(array.shape)
                room[0, 0] = numbers[:count].reshape(array.shape)
                numbers = numbers[count:]
        return plan

    def given(self, numbers: Array) -> dict[Variable, Any]:
        """The values that were given to a step that has left these numbers, by variable."""
        rest = numbers[len(numbers) - 1 - int(numbers[-1]) : -1]
        found: dict[Variable, Any] = {}
        for variable, parents in self.evidence:
            parts: dict[Variable, Array] = {}
            for each in (variable, *(parents or ())):
                count, width = int(rest[0]), each.dimension
                end = 1 + count * width
                parts[each], rest = rest[1:end].reshape(count, width), rest[end:]
            own = parts.pop(variable)
            found[variable] = own[0] if parents is None else Sightings(own, None, parts)
        return found

    def _converged(self, numbers: Array) -> Mask:
        settled = self._plan.linear
        if self.iterated:
            settled = self._iterations(numbers)[-1] == 0.0
        return np.array([settled and not (self._robust and numbers[0])])

    def _iterations(self, numbers: Array) -> Array:
        """The record of iterations (`settling`), empty without any."""
        first = int(self._robust)
        return numbers[first : first + (self._schedule.iterations + 1) * self.iterated]
