"""Filters and smoothers bound to memory: what a call in machine code needs, found once for many.

A sweep of sixty steps takes machine code as long as a few lines take Python. Nearly all of a call's
time then goes into what is the same for all evidence of one form: how its arrays lie, and which
numbers of the tables that machine code reads are addresses of which array. Here that is found once,
after a call that went the general way (`solvers.run`). A later call takes blocks of memory, adds
their addresses to what is known, and sweeps. One that is in anything unlike the first, or in which
anything is in doubt, goes the general way: nothing is decided here but that nothing is to decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import Any, NamedTuple

import numpy as np

from pgm.beliefs.moments.compiled import sweep
from pgm.beliefs.moments.compiled.judged import evaluated, standing
from pgm.beliefs.moments.compiled.plans import Integers64, Uncompiled
from pgm.beliefs.moments.compiled.table import Named, NamedTable, lies
from pgm.beliefs.moments.digits.certificate import MODERATE
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes.backward import Beliefs, transition
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.steps.account import Account
from pgm.beliefs.moments.steps.plan import Blank, ChainPlan
from pgm.compile import BalancedGraph, DynamicGraph
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import Array, address, vacant
from pgm.kernels.machine.sweeps import chain as sweeps
from pgm.kernels.machine.sweeps import told
from pgm.linearisation.family import Family
from pgm.posteriors.belief_kind import SMOOTHED
from pgm.schedules.schedule import Filtering, Schedule, Smoothing
from pgm.tracing import Program, Tracer
from pgm.tracing.clearing import Clearing, Standing

# A mean and a covariance of each step.
Pair = tuple[Array, Array]
# Names of arrays, with the numbers of their owners.
Owned = list[tuple[int, Named]]


class _View(NamedTuple):
    """An array in one of a call's blocks of memory."""

    block: int
    begin: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]

    def of(self, blocks: Sequence[Array]) -> Array:
        """The array in these blocks."""
        return np.ndarray(self.shape, float, blocks[self.block], self.begin, self.strides)


class _Room:
    """The arrays of a call in three blocks.

    Two are the means and the covariances that users ask for first, and keep; the other has the
    rest.
    """

    def __init__(self, plan: ChainPlan, *, back: bool) -> None:
        self._sizes = [0, 0, 0]
        size = plan.layout.slice_size
        steps = plan.steps + 1
        belief = (steps, (size,)), (steps, (size, size))
        self.shown = [self._take(*each, block) for block, each in enumerate(belief, 1)]
        self.predicted = [self._take(*each) for each in belief]
        self.known = [self._take(*each) for each in belief] if back else self.shown
        self.density = self._take(steps, ())
        self.ended = [self._take(sweeps.TOLD, ()) for _ in range(1 + back)]
        # By the number of a family its slopes and offsets, by that of a sensor its moved readings.
        self.lines = {
            k: (
                self._take(each.shape[0], each.shape[2:]),
                self._take(each.shape[0], each.shape[2:3]),
            )
            for k, each in enumerate(plan.families)
            if not each.exact and each.step.size
        }
        self.moved = {
            k: self._take(each.family.shape[0], each.family.shape[2:3])
            for k, each in enumerate(plan.sensors)
            if each.variable.angles and each.family.step.size
        }

    def _take(self, rows: int, own: tuple[int, ...], block: int = 0) -> _View:
        begin, length = self._sizes[block], rows * prod(own)
        self._sizes[block] += length
        like = vacant((rows, 1), own) if own else np.empty((rows, 1))
        return _View(block, 8 * begin, like.shape, like.strides)

    @property
    def blocks(self) -> list[Array]:
        """New blocks."""
        return list(map(np.empty, self._sizes))

    def give(self, plan: ChainPlan, blocks: Sequence[Array]) -> None:
        """Give a plan its arrays in some blocks."""
        families = plan.families
        for k, (matrix, offset) in self.lines.items():
            families[k].matrix, families[k].offset = matrix.of(blocks), offset.of(blocks)
        for k, view in self.moved.items():
            moved = view.of(blocks)
            moved[...] = plan.sensors[k].values
            plan.sensors[k].moved = moved


class _Numbers:
    """Whole numbers of which some are addresses, in arrays that are others in each call."""

    def __init__(self, numbers: Sequence[int], arrays: Sequence[Array]) -> None:
        self._rest = np.array(numbers, dtype=np.int64)
        self._inside = np.zeros((len(arrays), len(numbers)), dtype=np.int64)
        for row, array in zip(self._inside, arrays, strict=True):
            begin = address(array)
            row[:] = (self._rest >= begin) & (self._rest < begin + array.nbytes)
            self._rest -= row * begin

    def at(self, begins: Sequence[int]) -> Integers64:
        """The numbers where the arrays begin at these addresses."""
        found: Integers64 = self._rest + np.array(begins, dtype=np.int64) @ self._inside
        return found


class _Check(NamedTuple):
    """A trace that a call uses; `first` is where its points' places begin among the numbers."""

    tracer: Tracer
    trace: Program
    clearing: Clearing
    points: Standing
    first: int


class Bound:
    """A filter or a smoother of evidence of one form, bound.

    `found` is a posterior given such evidence that went the general way. An `Uncompiled` says why
    it cannot be bound.
    """

    def __init__(self, blank: Blank, found: ChainOutcome, evidence: BoundEvidence) -> None:
        plan, self._back = found._planned, found.kind == SMOOTHED
        _require_plain(plan, back=self._back)
        self._blank, self._status, self._kind = blank, found.status, found.kind
        self._compiled = plan.account.compiled
        self.served = self.failed = 0
        self._room = _Room(plan, back=self._back)
        mine, other = self._made(evidence), self._made(evidence.mapped(np.copy))
        for own, theirs in zip(mine[0].families, plan.families, strict=True):
            own.compiled = theirs.compiled
        owners, others = (self._owners(*each) for each in (mine, other))
        numbers, named = self._tabled(mine[0], owners)
        self._before = len(numbers)
        if self._back:
            more = self._tabled_back(mine[0], owners)
            numbers, named = numbers + more[0], [*named, *more[1]]
        # What two plans have in common is the same for all evidence; what is in no block varies.
        self._kept, self._varying = list[Array](), list[tuple[int, Named]]()
        varying = []
        for owner, each in named:
            array = each.get(owners[owner])
            if array is each.get(others[owner]):
                self._kept.append(array)
            elif not any(np.may_share_memory(array, block) for block in mine[1]):
                self._varying.append((owner, each))
                varying.append(array)
            if each.copied:
                raise Uncompiled("machine code reads a copy of an array")
        self._checks: list[_Check] = []
        for family, belief in evaluated(mine[0], *self._moments(mine[1])):
            self._checks.append(_check(family, standing(family, belief), len(numbers)))
            numbers += self._checks[-1].points.places
        self._numbers = _Numbers(numbers, [*mine[1], *varying])

    @property
    def stands(self) -> bool:
        """Whether calls would use the traces that are bound, and have often found them right."""
        return all(check.tracer.stands(check.trace) for check in self._checks)

    def __call__(self, graph: DynamicGraph, evidence: BoundEvidence) -> ChainOutcome | None:
        """The posterior given evidence of the form; None where that has to go the general way."""
        plan, blocks = self._made(evidence)
        owners = self._of_plan(plan)
        varying = [each.get(owners[owner]) for owner, each in self._varying]
        for array, (_, each) in zip(varying, self._varying, strict=True):
            if each.lies is not None and lies(array) != each.lies:
                return None
        numbers = self._numbers.at([*map(address, blocks), *map(address, varying)])
        table, ended = address(numbers), self._ended(blocks)
        self._ahead(table, 0, 1)
        left, closest, far, _ = ended[0][:, 0].tolist()
        if left or far or not closest * MODERATE > 1.0:
            return None
        if self._back:
            self._behind(table + 8 * self._before, 0, 1)
            left, kept, *_ = ended[1][:, 0].tolist()
            if left or not kept:
                return None
        elif not np.isfinite(blocks[1].sum() + blocks[2].sum()):
            return None
        for check in self._checks:
            places = numbers[check.first : check.first + len(check.points.places)]
            if not check.clearing.clears(check.points._replace(places=places)):
                return None
        for check in self._checks:
            check.tracer.prove(check.trace)
        return self._posterior(graph, plan, blocks, closest)

    def _made(self, evidence: BoundEvidence) -> tuple[ChainPlan, list[Array]]:
        """A plan for evidence of the form, and the blocks in which its arrays are."""
        plan, blocks = self._blank.renewed(evidence), self._room.blocks
        plan.account = Account(due=True, compiled=self._compiled)
        self._room.give(plan, blocks)
        return plan, blocks

    def _of_plan(self, plan: ChainPlan) -> list[Any]:
        """The owners of arrays that may vary: those of a plan."""
        families = [link.family for link in plan.transition]
        for sensor in plan.read:
            families.append(sensor.family)
        return [*families, *plan.read, transition(plan) if self._back else None]

    def _owners(self, plan: ChainPlan, blocks: Sequence[Array]) -> list[Any]:
        """The owners of all arrays of the sweeps."""
        known, predicted = self._moments(blocks)
        begin = plan.layout.begun
        if not begin:
            raise Uncompiled("the belief to begin with depends on evidence")
        record = dict(zip(sweep.BEGIN, begin[0], strict=True))
        density = self._room.density.of(blocks)
        record |= zip(sweep.KNOWN, (*known, density), strict=True)
        record |= zip(sweep.PREDICTED, predicted, strict=True)
        record |= zip(("ended", "ended back"), self._ended(blocks), strict=False)
        owners = [*self._of_plan(plan), record, self._forward(blocks)]
        if self._back:
            record |= zip(sweep.SMOOTHED, self._shown(blocks), strict=True)
        return owners

    def _ended(self, blocks: Sequence[Array]) -> list[Array]:
        """The arrays in which each of the sweeps tells of its end."""
        return [each.of(blocks) for each in self._room.ended]

    def _moments(self, blocks: Sequence[Array]) -> tuple[Pair, Pair]:
        """The known and the predicted means and covariances."""
        mean, cov, *predicted = (
            each.of(blocks) for each in (*self._room.known, *self._room.predicted)
        )
        return (mean, cov), (predicted[0], predicted[1])

    def _tabled(self, plan: ChainPlan, owners: list[Any]) -> tuple[list[int], Owned]:
        """The table of the sweep forward, and the names of its arrays."""
        *_, record, _ = owners
        table = NamedTable(plan, 1, owners, record)
        cpds = {"stored": False, "keep": True, "controlled": False}
        self._ahead = sweeps.made(sweep.told_ahead(plan, table, (), **cpds, gate=None), 1)
        return self._whole(table, record["ended"]), _owned(table)

    def _tabled_back(self, plan: ChainPlan, owners: list[Any]) -> tuple[list[int], Owned]:
        """The table of the sweep back, and the names of its arrays."""
        *_, moved, record, ahead = owners
        table = NamedTable(plan, 1, owners, record)
        self._behind = sweeps.made(sweep.told_back(plan, table, ahead, moved, record), 1)
        return self._whole(table, record["ended back"]), _owned(table)

    def _whole(self, table: NamedTable, ended: Array) -> list[int]:
        """The numbers of a table, which begins with those that are of the sweep as a whole."""
        table.numbers[told.ITERATIONS] = 1
        table.numbers[told.ENDED] = address(ended)
        return table.numbers

    def _forward(self, blocks: Sequence[Array], closest: float = 0.0) -> Forward:
        known, (mean, cov) = self._moments(blocks)
        density = self._room.density.of(blocks)
        return Forward(mean, cov, *known, density, closest, far=False)

    def _shown(self, blocks: Sequence[Array]) -> Pair:
        """The means and covariances that users ask for first."""
        mean, cov = (each.of(blocks) for each in self._room.shown)
        return mean, cov

    def _posterior(
        self, graph: DynamicGraph, plan: ChainPlan, blocks: Sequence[Array], closest: float
    ) -> ChainOutcome:
        swept = self._forward(blocks, closest)
        parts = graph, self._status, self._kind, plan, swept
        if not self._back:
            return ChainOutcome(*parts, None, None)
        return ChainOutcome(*parts, Beliefs(*self._shown(blocks), kept=True), None)


def _owned(table: NamedTable) -> Owned:
    return [(each.owner, each) for each in table.form.named]


def bound_to(
    blank: Blank | None, graph: DynamicGraph, schedule: Schedule, evidence: BoundEvidence
) -> ChainOutcome | None:
    """The posterior by what has been bound for a form of evidence; None where nothing serves."""
    key = None if blank is None else _key(graph, schedule, evidence)
    if blank is None or key is None:
        return None
    bound = blank.bound.get(key)
    if not isinstance(bound, Bound) or not bound.stands:
        return None
    found = bound(graph, evidence)
    if found is not None:
        bound.served += 1
        return found
    bound.failed += 1
    if bound.failed > _FAILURES + bound.served:  # which costs more than it saves
        blank.bound[key] = None
    return None


def bind(
    blank: Blank | None, schedule: Schedule, found: ChainOutcome, evidence: BoundEvidence
) -> None:
    """Bind what later calls for evidence of a form need, after one that went the general way."""
    key = None if blank is None else _key(found.graph, schedule, evidence)
    if blank is None or key is None:
        return
    known = blank.bound.get(key, _NOTHING)
    if known is None or (isinstance(known, Bound) and known.stands):
        return
    # Machine code clears what calls have often found right: until then all go the general way.
    plan = found._planned
    whole = [family.compiled for family in plan.families if not family.exact]
    if plan.account.compiled and not all(each and each.tracer.often for each in whole):
        return
    try:
        blank.bound[key] = Bound(blank, found, evidence)
    except Uncompiled:
        blank.bound[key] = None


# What is found where nobody has tried to bind.
_NOTHING = "nothing"
# Calls in vain, beside as many as served, after which a form of evidence is bound no more.
_FAILURES = 4


def _key(graph: DynamicGraph, schedule: Schedule, evidence: BoundEvidence) -> Any:
    """The kind of a call that may be bound, and which sensors lack readings; None of others."""
    if type(schedule) not in (Filtering, Smoothing) or isinstance(graph, BalancedGraph):
        return None
    assert isinstance(schedule, Filtering | Smoothing)
    if schedule.iterations > 1 or schedule.gate is not None or schedule.damping != 0.0:
        return None
    return type(schedule), *(bool(each.taken.all()) for each in evidence.readings)


def _require_plain(plan: ChainPlan, *, back: bool) -> None:
    """Refuse plans of which not all is done by machine code, or something is looked at later."""
    account, layout = plan.account, plan.layout
    if account.compiled != 1 + back or account.left or account.called or plan.runs > 1:
        raise Uncompiled("machine code did not make all of its sweeps, of one run")
    if back and not layout.single:
        raise Uncompiled("several CPDs make a slice")
    if plan.robust or any(each.robust for each in plan.sensors):
        raise Uncompiled("noise is robust")
    for family in plan.families:
        if not (family.taylor or not family.hidden) or family.approximate:
            raise Uncompiled("a CPD is linearised with an error")


def _check(family: Family, points: Standing, first: int) -> _Check:
    """The clearing of a family's trace at points whose places follow others."""
    answers = family.compiled
    assert answers is not None
    clearing = answers.slopes.clearing(answers.trace, differentiated=True)
    if clearing is None or answers.every > 1:
        raise Uncompiled("a trace is not cleared at once")
    return _Check(answers.tracer, answers.trace, clearing, points, first)
