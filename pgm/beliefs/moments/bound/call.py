"""The plan and the arrays of one bound call, each made when it is first asked for."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from pgm.beliefs.moments.bound.room import Pair, Room
from pgm.beliefs.moments.compiled import sweep
from pgm.beliefs.moments.compiled.gates import decided
from pgm.beliefs.moments.compiled.sweep import Swept
from pgm.beliefs.moments.compiled.table import Record
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.beliefs.moments.passes.backward import Beliefs, transition
from pgm.beliefs.moments.passes.forward import Filtered, Forward
from pgm.beliefs.moments.steps import gate
from pgm.beliefs.moments.steps.account import Account
from pgm.beliefs.moments.steps.plan import Blank, ChainPlan
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import Array
from pgm.tracing import Judge


class Made:
    """The plan and the arrays of a call, each made when it is first asked for.

    A sweep takes their addresses alone, and few who call ask for more than means and covariances.
    """

    def __init__(self, blank: Blank, room: Room, evidence: BoundEvidence) -> None:
        self.evidence, self.blocks = evidence, room.blocks
        self._blank, self._room = blank, room

    @cached_property
    def plan(self) -> ChainPlan:
        """The plan, with the arrays that a sweep fills."""
        plan = self._blank.renewed(self.evidence)
        plan.account = Account(due=True, compiled=1 + self._room.sweeps.back)
        gate.prepare(plan, self._room.sweeps.schedule.gate)
        self._room.give(plan, self.blocks)
        return plan

    def trace(self, like: ChainPlan) -> None:
        """Have the traces stand in for functions that do so in another plan."""
        for own, theirs in zip(self.plan.families, like.families, strict=True):
            own.compiled = theirs.compiled

    @cached_property
    def swept(self) -> ChainPlan:
        """The plan as a sweep has left it, with its linearisations and decisions."""
        plan = self.plan
        decided(plan, self._room.record(self.blocks))
        if self._room.sweeps.keep:
            plan.settle()
        else:  # which is swept again if more is asked for
            plan.trace(Judge())
        return plan

    @cached_property
    def owners(self) -> list[Any]:
        """The owners of all arrays of the sweeps; those of the plan may vary from call to call."""
        plan, back = self.plan, self._room.sweeps.back
        families = [link.family for link in plan.transition]
        families += [sensor.family for sensor in plan.read]
        moved = transition(plan) if back else None
        return [*families, *plan.read, moved, self.record, self.forward() if back else None]

    @property
    def record(self) -> Record:
        """By name the arrays that sweeps read or fill beside those of CPDs and sensors."""
        room, blocks = self._room, self.blocks
        begin = self.plan.layout.begun
        if not begin:
            raise Uncompiled("the belief to begin with depends on evidence")
        record = room.record(blocks) | dict(zip(sweep.BEGIN, begin[0], strict=True))
        record |= zip(sweep.KNOWN, (*self.known, self.density), strict=True)
        record |= zip(sweep.PREDICTED, self.predicted, strict=True)
        record |= zip(("ended", "ended back"), self.ended, strict=False)
        residuals = self.residuals
        if residuals is not None:
            record |= {"residuals": residuals, "settings": room.settings}
        if room.sweeps.back:
            record |= zip(sweep.SMOOTHED, (self.beliefs.mean, self.beliefs.cov), strict=True)
        return record

    @property
    def residuals(self) -> Array | None:
        """The residuals of iterations, as of `Swept.told`; None where nothing is iterated."""
        view = self._room.residuals
        return None if view is None else view.of(self.blocks)

    @property
    def known(self) -> Pair:
        """The means and covariances given the measurements up to each step."""
        mean, cov = self._room.known
        return mean.of(self.blocks), cov.of(self.blocks)

    @property
    def predicted(self) -> Pair:
        """The means and covariances given the measurements before each step."""
        mean, cov = self._room.predicted
        return mean.of(self.blocks), cov.of(self.blocks)

    @property
    def density(self) -> Array:
        """The log-densities of each step's measurements."""
        return self._room.density.of(self.blocks)

    @property
    def ended(self) -> list[Array]:
        """The arrays in which each of the sweeps tells of its end."""
        return [each.of(self.blocks) for each in self._room.ended]

    @property
    def beliefs(self) -> Beliefs:
        """The means and covariances that users ask for first."""
        mean, cov = self._room.shown
        return Beliefs(mean.of(self.blocks), cov.of(self.blocks), kept=self._room.sweeps.back)

    def forward(self, closest: float = 0.0, held: bool | None = None) -> Forward | Filtered:
        """The sweep forward, which went so; see `Forward`."""
        known, made = (*self.known, self.density), self._room.sweeps
        if made.keep:
            return Forward(*self.predicted, *known, closest, far=False, held=held)
        settled = np.ones(known[2].shape[1], dtype=bool)
        went = Swept([], [], settled, closest, far=False, held=held)
        return Filtered.by(self.swept, made.schedule, known, went)
