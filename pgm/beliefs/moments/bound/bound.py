"""Filters and smoothers bound to memory: what a call in machine code needs, found once for many.

A sweep of sixty steps takes machine code as long as a few lines take Python. Nearly all of a call's
time then goes into what is the same for all evidence of one form: how its arrays lie, and which
numbers of the tables that machine code reads are addresses of which array. Here that is found once,
after a call that went the general way (`solvers.run`). A later call takes blocks of memory, adds
their addresses to what is known, and sweeps. One that is in anything unlike the first, or in which
anything is in doubt, goes the general way: nothing is decided here but that nothing is to decide.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from pgm.beliefs.moments.bound.outcome import BoundOutcome
from pgm.beliefs.moments.bound.traces import Check
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile import DynamicGraph
from pgm.compile.machine import Compiled
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import Array, Mask
from pgm.linearisation.family import cancellation
from pgm.posteriors.status import Status


class Bound(ABC):
    """A call for evidence of one form, bound.

    `plan` is that of a call with such evidence that went the general way. An `Uncompiled` says why
    it cannot be bound. `served` counts the calls that were answered, `failed` those in vain.
    """

    checks: Sequence[Check]

    def __init__(self, plan: ChainPlan, *, back: bool) -> None:
        _require_plain(plan, back=back)
        self.served = self.failed = 0
        self._words = plan.account.words(plan.runs)

    @abstractmethod
    def __call__(self, graph: DynamicGraph, evidence: BoundEvidence) -> BoundOutcome | None:
        """The posterior given evidence of the form; None where that has to go the general way."""

    @property
    def stands(self) -> bool:
        """Whether calls would use the traces that are bound, and have often found them right."""
        return all(check.trace.stands for check in self.checks)

    def prove(self) -> None:
        """Take the traces for right, since a call has found them so."""
        for check in self.checks:
            check.trace.prove()

    def told(self, residuals: list[Array], settled: Mask, evidence: BoundEvidence) -> Status:
        """The status of a call, of these residuals, in whose runs all has settled or not."""
        return Status.of(residuals, settled, evidence.lead).with_compilation(self._words)


def _require_plain(plan: ChainPlan, *, back: bool) -> None:
    """Refuse a plan of which machine code did not make all, or something is looked at later."""
    account, layout = plan.account, plan.layout
    if account.compiled < 1 + back or account.called:
        raise Uncompiled("machine code did not make all of its sweeps")
    if back and not layout.single:
        raise Uncompiled("several CPDs make a slice")
    if plan.runs > 1 and isinstance(layout.compiled, Compiled) and layout.compiled.threads > 1:
        raise Uncompiled("threads share the runs")
    for sensor in plan.read:
        if sensor.is_correlated:
            raise Uncompiled("sightings of a step are linearised as one vector")
        if sensor.robust and sensor.family.noisy:
            raise Uncompiled("a robust noise depends on evidence")
    if any(map(cancellation, plan.families)):
        raise Uncompiled("sigma points lie close together")
