"""A smoother of several iterations, by Gauss–Newton steps in machine code, bound to memory."""

from __future__ import annotations

import numpy as np

from pgm.beliefs.moments.bound.bound import Bound
from pgm.beliefs.moments.bound.call import Made
from pgm.beliefs.moments.bound.once import BoundOnce
from pgm.beliefs.moments.bound.outcome import BoundOutcome
from pgm.beliefs.moments.bound.passes import Passes
from pgm.beliefs.moments.bound.room import Room, Sweeps
from pgm.beliefs.moments.bound.tables import Tables
from pgm.beliefs.moments.bound.traces import laid_out_again
from pgm.beliefs.moments.compiled.judged import diagonal
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.beliefs.moments.smoothers.compiled_newton import Equations, Newton, agree
from pgm.beliefs.moments.steps.account import Account
from pgm.beliefs.moments.steps.plan import Blank, ChainPlan
from pgm.compile import DynamicGraph
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import address, deviation
from pgm.posteriors.belief_kind import SMOOTHED
from pgm.schedules.iteration import iterate
from pgm.schedules.schedule import ONCE, Smoothing


class BoundIterated(Bound):
    """A smoother that linearises again about its means, bound.

    It begins with one that linearises once, goes on by Gauss–Newton steps, and ends with a sweep
    forward and back by the last linearisations.
    """

    def __init__(
        self, blank: Blank, plan: ChainPlan, evidence: BoundEvidence, schedule: Smoothing
    ) -> None:
        super().__init__(plan, back=True)
        if any(family.needs_cov for family in plan.families) or schedule.gate is not None:
            raise Uncompiled("Gauss–Newton steps do not make all iterations")
        self._schedule, self._blank, self._runs = schedule, blank, plan.runs
        once = Sweeps(ONCE, back=True, keep=True)
        self._once = BoundOnce(blank, plan, evidence, once)
        self._room = Room(plan, once, like=True)
        mine, other = self._made(evidence), self._made(evidence.mapped(np.copy))
        mine.trace(plan)
        # Those of the passes are of another time: of readings that steps have moved.
        self._steps, self._tables = Tables(mine, other), Tables(mine, other)
        self._equations = Equations(mine.plan, self._steps.owners, has_lines=True)
        self._steps.add(self._equations.table)
        self._passes = Passes(mine.plan, self._room, self._tables, stored=True)
        for tables in (self._steps, self._tables):
            tables.bind()
        self._again = laid_out_again(mine)
        self.checks = [*self._once.checks, *self._again]

    def __call__(self, graph: DynamicGraph, evidence: BoundEvidence) -> BoundOutcome | None:
        """The posterior given evidence of the form; None where that has to go the general way."""
        once, made = self._once.swept(evidence), self._made(evidence)
        if once is None:
            return None
        first, settled = once[0].beliefs, np.zeros(self._runs, dtype=bool)
        self._room.begin(evidence, made.blocks)
        try:
            stepping = self._steps.of(made)
            if stepping is None:
                return None
            newton = Newton(self._equations, stepping[0], Account())
            solution = newton.start(first.mean, first.cov)
            result = iterate(newton, solution, self._schedule, settled)
        except Uncompiled:
            return None
        known = self._tables.of(made)
        went = None if known is None else self._passes.run(made, address(known[0]))
        if went is None:
            return None
        std = deviation(made.beliefs.cov)
        if not agree(result.solution, made.beliefs, std):
            return None
        at = newton.at, diagonal(std)
        if not all(check.clears_at(made, at, at) for check in self._again):
            return None
        self.prove()
        status = self.told(result.residuals, result.converged, evidence)
        return BoundOutcome.of(graph, status, SMOOTHED, made, went)

    def _made(self, evidence: BoundEvidence) -> Made:
        """The plan and the arrays of a call's last sweeps."""
        return Made(self._blank, self._room, evidence)
