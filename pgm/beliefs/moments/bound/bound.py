"""Filters and smoothers bound to memory: what a call in machine code needs, found once for many.

A sweep of sixty steps takes machine code as long as a few lines take Python. Nearly all of a call's
time then goes into what is the same for all evidence of one form: how its arrays lie, and which
numbers of the tables that machine code reads are addresses of which array. Here that is found once,
after a call that went the general way (`solvers.run`). A later call takes blocks of memory, adds
their addresses to what is known, and sweeps. One that is in anything unlike the first, or in which
anything is in doubt, goes the general way: nothing is decided here but that nothing is to decide.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.beliefs.moments.bound.call import Made
from pgm.beliefs.moments.bound.numbers import Numbers, Varying, ways
from pgm.beliefs.moments.bound.outcome import BoundOutcome
from pgm.beliefs.moments.bound.room import Room, Sweeps
from pgm.beliefs.moments.bound.traces import checks
from pgm.beliefs.moments.compiled import sweep
from pgm.beliefs.moments.compiled.named_table import Named, NamedTable, lies
from pgm.beliefs.moments.compiled.sweep import Swept
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.beliefs.moments.digits.certificate import MODERATE
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes.forward import Filtered
from pgm.beliefs.moments.steps.plan import Blank, ChainPlan
from pgm.compile import DynamicGraph
from pgm.compile.machine import Compiled
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import Array, Mask, address
from pgm.kernels.machine.sweeps import chain as sweeps
from pgm.kernels.machine.sweeps import told
from pgm.linearisation.family import cancellation
from pgm.posteriors.belief_kind import SMOOTHED
from pgm.posteriors.status import Status
from pgm.schedules.schedule import Filtering

# What a call looks at of all that a sweep forward tells.
_TOLD = sweeps.LEFT, sweeps.CLOSEST, sweeps.FAR
# Names of arrays, with the numbers of their owners.
Owned = list[tuple[int, Named]]


class Bound:
    """A filter or a smoother of evidence of one form, bound.

    `found` is a posterior given such evidence, by a filter's schedule and maybe a sweep back, that
    went the general way. An `Uncompiled` says why it cannot be bound.
    """

    def __init__(
        self, blank: Blank, found: ChainOutcome, evidence: BoundEvidence, schedule: Filtering
    ) -> None:
        plan, back = found._planned, found.kind == SMOOTHED
        _require_plain(found, back=back)
        self._blank, self._kind, self._linear = blank, found.kind, plan.linear
        self._compiled, self._runs = plan.account.compiled, plan.runs
        self._words = plan.account.words(plan.runs)
        self.served = self.failed = 0
        made = Sweeps(schedule, back, keep=not isinstance(found._swept, Filtered))
        self._room, self._settings = Room(plan, made), sweep.settings(schedule)
        # The status of a call whose sweeps settle nothing.
        self._status: Status | None = None
        if back or not (self._room.residuals or plan.robust):
            settled = np.full(plan.runs, plan.exact if back else plan.linear)
            self._status = self._told([], settled, evidence)
        mine, other = self._made(evidence), self._made(evidence.mapped(np.copy))
        for own, theirs in zip(mine.plan.families, plan.families, strict=True):
            own.compiled = theirs.compiled
        owners, others = map(self._owners, (mine, other))
        numbers, named = self._tabled(mine.plan, owners)
        self._before = len(numbers)
        if back:
            more = self._tabled_back(mine.plan, owners)
            numbers, named = numbers + more[0], [*named, *more[1]]
        # What two plans have in common is the same for all evidence; what is in no block varies.
        self._kept, self._varying = list[Array](), list[Varying]()
        varying, known = [], dict(ways(evidence))
        for owner, each in named:
            array = each.get(owners[owner])
            numbers[each.place] = address(array)  # one that is made when asked for lies elsewhere
            if array is each.get(others[owner]):
                self._kept.append(array)
            elif not any(np.may_share_memory(array, block) for block in mine.blocks):
                way = known.get(id(array))
                if way is not None and way.of(other.evidence) is not each.get(others[owner]):
                    way = None
                self._varying.append(Varying(way, owner, each.get, each.lies))
                varying.append(array)
            if each.copied:
                raise Uncompiled("machine code reads a copy of an array")
        self._checks = checks(mine, numbers, again=schedule.iterations > 1)
        self._numbers = Numbers(numbers, [*mine.blocks, *varying])

    @property
    def stands(self) -> bool:
        """Whether calls would use the traces that are bound, and have often found them right."""
        return all(check.trace.stands for check in self._checks)

    def __call__(self, graph: DynamicGraph, evidence: BoundEvidence) -> ChainOutcome | None:
        """The posterior given evidence of the form; None where that has to go the general way."""
        made = self._made(evidence)
        blocks, room, runs, varying = made.blocks, self._room, self._runs, list[Array]()
        for each in self._varying:
            array = each.of(made)
            if each.lies is not None and lies(array) != each.lies:
                return None
            varying.append(array)
        room.begin(evidence, blocks)
        numbers = self._numbers.at([*map(address, blocks), *map(address, varying)])
        table = address(numbers)
        self._ahead(table, 0, runs)
        ended = room.ended[0].numbers(blocks)
        left, closest, far = (ended[k * runs : (k + 1) * runs] for k in _TOLD)
        least = min(closest)
        if any(left) or any(far) or not least * MODERATE > 1.0:
            return None
        if room.sweeps.back:
            self._behind(table + 8 * self._before, 0, runs)
            ended = room.ended[1].numbers(blocks)
            if any(ended[:runs]) or not all(ended[runs * sweeps.KEPT : runs * (sweeps.KEPT + 1)]):
                return None
        elif not np.isfinite(blocks[1].sum() + blocks[2].sum()):
            return None
        if not all(check.clears(made, table) for check in self._checks):
            return None
        for check in self._checks:
            check.trace.prove()
        status = self._status or self._went(made)
        return BoundOutcome.of(graph, status, self._kind, made, least)

    def _made(self, evidence: BoundEvidence) -> Made:
        """The plan and the arrays of a call for evidence of the form."""
        return Made(self._blank, self._room, evidence, self._compiled)

    def _went(self, made: Made) -> Status:
        """How the iterations of a call's sweep went, or its weights."""
        residuals = made.record.get("residuals")
        went = Swept.told([], made.ended[0], residuals, linear=self._linear)
        return self._told(went.residuals, went.converged, made.evidence)

    def _told(self, residuals: list[Array], settled: Mask, evidence: BoundEvidence) -> Status:
        return Status.of(residuals, settled, evidence.lead).with_compilation(self._words)

    def _owners(self, made: Made) -> list[Any]:
        """The owners of all arrays of the sweeps."""
        begin = made.plan.layout.begun
        if not begin:
            raise Uncompiled("the belief to begin with depends on evidence")
        record = made.record | dict(zip(sweep.BEGIN, begin[0], strict=True))
        if "residuals" in record:
            record["settings"] = self._settings
        record |= zip(sweep.KNOWN, (*made.known, made.density), strict=True)
        record |= zip(sweep.PREDICTED, made.predicted, strict=True)
        record |= zip(("ended", "ended back"), made.ended, strict=False)
        if self._room.sweeps.back:
            record |= zip(sweep.SMOOTHED, (made.beliefs.mean, made.beliefs.cov), strict=True)
        return [*made.owners, record, made.forward() if self._room.sweeps.back else None]

    def _tabled(self, plan: ChainPlan, owners: list[Any]) -> tuple[list[int], Owned]:
        """The table of the sweep forward, and the names of its arrays."""
        *_, record, _ = owners
        schedule, _, keep = self._room.sweeps
        lanes = sweep.lanes_of(plan)
        table = NamedTable(plan, lanes, owners, record)
        cpds = {"stored": False, "keep": keep, "controlled": False}
        self._ahead = sweeps.made(
            sweep.told_ahead(plan, table, (), **cpds, gate=schedule.gate), lanes
        )
        return self._whole(table, record["ended"]), _owned(table, 0)

    def _tabled_back(self, plan: ChainPlan, owners: list[Any]) -> tuple[list[int], Owned]:
        """The table of the sweep back, and the names of its arrays."""
        *_, moved, record, ahead = owners
        lanes = sweep.lanes_of(plan)
        table = NamedTable(plan, lanes, owners, record)
        self._behind = sweeps.made(sweep.told_back(plan, table, ahead, moved, record), lanes)
        return self._whole(table, record["ended back"]), _owned(table, self._before)

    def _whole(self, table: NamedTable, ended: Array) -> list[int]:
        """The numbers of a table, which begins with those that are of the sweep as a whole."""
        table.numbers[told.ITERATIONS] = self._room.sweeps.schedule.iterations
        table.numbers[told.ENDED] = address(ended)
        return table.numbers


def _owned(table: NamedTable, first: int) -> Owned:
    """The names of a table's arrays, whose numbers begin at `first`."""
    named = table.form.named
    return [(each.owner, each._replace(place=first + each.place)) for each in named]


def _require_plain(found: ChainOutcome, *, back: bool) -> None:
    """Refuse calls of which not all was done by machine code, or something is looked at later."""
    plan = found._planned
    account, layout = plan.account, plan.layout
    if account.compiled != 1 + back or account.called:
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
