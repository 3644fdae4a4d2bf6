"""A filter, or a smoother that linearises once, bound to memory."""

from __future__ import annotations

import numpy as np

from pgm.beliefs.moments.bound.bound import Bound
from pgm.beliefs.moments.bound.call import Made
from pgm.beliefs.moments.bound.outcome import BoundOutcome
from pgm.beliefs.moments.bound.passes import Passes, Went
from pgm.beliefs.moments.bound.room import Room, Sweeps
from pgm.beliefs.moments.bound.tables import Tables
from pgm.beliefs.moments.bound.traces import checks
from pgm.beliefs.moments.compiled.sweep import Swept
from pgm.beliefs.moments.steps.plan import Blank, ChainPlan
from pgm.compile import DynamicGraph
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import address
from pgm.posteriors.belief_kind import FILTERED, SMOOTHED
from pgm.posteriors.status import Status


class BoundOnce(Bound):
    """A filter, or a smoother that linearises once, of evidence of one form, bound.

    `plan` is that of a call with such evidence that went the general way. An `Uncompiled` says why
    it cannot be bound.
    """

    def __init__(
        self, blank: Blank, plan: ChainPlan, evidence: BoundEvidence, made: Sweeps
    ) -> None:
        super().__init__(plan, back=made.back)
        self._blank, self._linear, self._room = blank, plan.linear, Room(plan, made)
        # The status of a call whose sweeps settle nothing.
        self._status: Status | None = None
        if made.back or not (self._room.residuals or plan.robust):
            settled = np.full(plan.runs, plan.exact if made.back else plan.linear)
            self._status = self.told([], settled, evidence)
        mine, other = self._made(evidence), self._made(evidence.mapped(np.copy))
        mine.trace(plan)
        self._tables = tables = Tables(mine, other)
        self._passes = Passes(mine.plan, self._room, tables, stored=False)
        self.checks = checks(mine, tables.numbers, again=made.schedule.iterations > 1)
        tables.bind()

    def __call__(self, graph: DynamicGraph, evidence: BoundEvidence) -> BoundOutcome | None:
        """The posterior given evidence of the form; None where that has to go the general way."""
        found = self.swept(evidence)
        if found is None:
            return None
        self.prove()
        made, went = found
        kind = SMOOTHED if self._room.sweeps.back else FILTERED
        return BoundOutcome.of(graph, self._status or self._told_of(made), kind, made, went)

    def swept(self, evidence: BoundEvidence) -> tuple[Made, Went] | None:
        """The arrays of a call, swept, and how the sweeps went; None if in doubt."""
        made = self._made(evidence)
        known = self._tables.of(made)
        if known is None:
            return None
        self._room.begin(evidence, made.blocks)
        table = address(known[0])
        went = self._passes.run(made, table)
        if went is None or not all(check.clears(made, table) for check in self.checks):
            return None
        return made, went

    def _made(self, evidence: BoundEvidence) -> Made:
        """The plan and the arrays of a call for evidence of the form."""
        return Made(self._blank, self._room, evidence)

    def _told_of(self, made: Made) -> Status:
        """How the iterations of a call's sweep went, or its weights."""
        went = Swept.told([], made.ended[0], made.residuals, linear=self._linear)
        return self.told(went.residuals, went.converged, made.evidence)
