"""Filters and smoothers bound to memory: what a call in machine code needs, found once for many.

A sweep of sixty steps takes machine code as long as a few lines take Python. Nearly all of a call's
time then goes into what is the same for all evidence of one form: how its arrays lie, and which
numbers of the tables that machine code reads are addresses of which array. Here that is found once,
after a call that went the general way (`solvers.run`). A later call takes blocks of memory, adds
their addresses to what is known, and sweeps. One that is in anything unlike the first, or in which
anything is in doubt, goes the general way: nothing is decided here but that nothing is to decide.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields
from functools import cached_property
from math import prod
from typing import Any, NamedTuple

import numpy as np

from pgm.beliefs.moments.compiled import sweep
from pgm.beliefs.moments.compiled.judged import evaluated, standing
from pgm.beliefs.moments.compiled.named_table import Named, NamedTable, lies
from pgm.beliefs.moments.compiled.table import Get, Integers64
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
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
from pgm.linearisers import Lineariser
from pgm.posteriors.belief_kind import SMOOTHED, Kind
from pgm.posteriors.status import Status
from pgm.schedules.schedule import Filtering, FixedLag, Schedule, Smoothing
from pgm.tracing import Program, Tracer
from pgm.tracing.clearing import Clearing, Standing
from pgm.variables import Variable

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

    def numbers(self, blocks: Sequence[Array]) -> list[float]:
        """The numbers of an array that has no gaps, in a third of the time."""
        first = self.begin // 8
        found: list[float] = blocks[self.block][first : first + self.shape[0]].tolist()
        return found


class _Room:
    """The arrays of a call in three blocks.

    Two are the means and the covariances that users ask for first, and keep; the other has the
    rest.
    """

    def __init__(self, plan: ChainPlan, *, back: bool) -> None:
        self.back, self._sizes = back, [0, 0, 0]
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
            plan.sensors[k].moved = view.of(blocks)

    def read(self, evidence: BoundEvidence, blocks: Sequence[Array]) -> None:
        """Write the readings that a sweep moves as they are before."""
        for k, view in self.moved.items():
            view.of(blocks)[...] = evidence.readings[k].values


class _Made:
    """The plan and the arrays of a call, each made when it is first asked for.

    A sweep takes their addresses alone, and few who call ask for more than means and covariances.
    """

    def __init__(self, blank: Blank, room: _Room, evidence: BoundEvidence, compiled: int) -> None:
        self.evidence, self.blocks = evidence, room.blocks
        self._blank, self._room, self._compiled = blank, room, compiled

    @cached_property
    def plan(self) -> ChainPlan:
        """The plan, with the linearisations of the sweep."""
        plan = self._blank.renewed(self.evidence)
        plan.account = Account(due=True, compiled=self._compiled)
        self._room.give(plan, self.blocks)
        return plan

    @cached_property
    def owners(self) -> list[Any]:
        """The owners of arrays that may vary: those of the plan."""
        plan = self.plan
        families = [link.family for link in plan.transition]
        for sensor in plan.read:
            families.append(sensor.family)
        return [*families, *plan.read, transition(plan) if self._room.back else None]

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
    def ended(self) -> list[Array]:
        """The arrays in which each of the sweeps tells of its end."""
        return [each.of(self.blocks) for each in self._room.ended]

    @property
    def beliefs(self) -> Beliefs:
        """The means and covariances that users ask for first."""
        mean, cov = self._room.shown
        return Beliefs(mean.of(self.blocks), cov.of(self.blocks), kept=self._room.back)

    def forward(self, closest: float = 0.0) -> Forward:
        """The sweep forward; `closest` is the least share of a variance."""
        density = self._room.density.of(self.blocks)
        return Forward(*self.predicted, *self.known, density, closest, far=False)


class BoundOutcome(ChainOutcome):
    """The outcome of a bound call, whose parts are made when they are asked for."""

    _made: _Made
    _closest: float

    @classmethod
    def of(
        cls, graph: DynamicGraph, status: Status, kind: Kind, made: _Made, closest: float
    ) -> BoundOutcome:
        """The outcome of a call; `closest` is the least share of a variance on its way."""
        found = object.__new__(cls)  # whose other fields are found below
        parts = {"graph": graph, "status": status, "kind": kind, "associations": {}}
        parts["_reverse_given"] = None  # it is made when it is asked for
        smoothed = made.beliefs if kind == SMOOTHED else None
        own = {"_made": made, "_closest": closest, "_lead": made.evidence.lead}
        found.__dict__.update(parts, _smoothed=smoothed, **own)
        return found

    @cached_property
    def _planned(self) -> ChainPlan:  # type: ignore[override]  # frozen there
        return self._made.plan

    @cached_property
    def _swept(self) -> Forward:
        return self._made.forward(self._closest)

    def __reduce__(self) -> tuple[Any, ...]:
        # What is bound to memory of this process stays there.
        return ChainOutcome, tuple(getattr(self, each.name) for each in fields(ChainOutcome))


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
    """A trace that a call uses, at so many `points`.

    `first` is where the places of these begin among the numbers, of which some point to what is
    `kept`; `squared` is as of `Standing`.
    """

    tracer: Tracer
    trace: Program
    clearing: Clearing
    first: int
    points: int
    squared: bool
    kept: object


class _Varying(NamedTuple):
    """An array that is another one in each call.

    It is found in the evidence itself by `way`; where that is None, `owner` has it, a number of the
    plan's, and is asked for it by `get`. `lies` is as of `Named`.
    """

    way: _Way | None
    owner: int
    get: Get
    lies: tuple[Any, ...] | None

    def of(self, made: _Made) -> Array:
        """The array in a call."""
        if self.way is None:
            found: Array = self.get(made.owners[self.owner])
            return found
        return self.way.of(made.evidence)


class _Way(NamedTuple):
    """Where an array stands in evidence: as values of a reading, or of a parent, there or not."""

    place: int
    sensor: bool
    parent: Variable | None

    def of(self, evidence: BoundEvidence) -> Array:
        """The array of this evidence."""
        if self.parent is None:
            return evidence.readings[self.place].values
        if self.sensor:
            return evidence.readings[self.place].inputs[self.parent]
        return evidence.transition[self.place][self.parent]


def _ways(evidence: BoundEvidence) -> Iterator[tuple[int, _Way]]:
    """The identities of evidence's arrays of numbers, each with the way to it."""
    for k, inputs in enumerate(evidence.transition):
        yield from ((id(values), _Way(k, False, parent)) for parent, values in inputs.items())
    for k, reading in enumerate(evidence.readings):
        yield id(reading.values), _Way(k, True, None)
        yield from ((id(own), _Way(k, True, parent)) for parent, own in reading.inputs.items())


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
        for own, theirs in zip(mine.plan.families, plan.families, strict=True):
            own.compiled = theirs.compiled
        owners, others = map(self._owners, (mine, other))
        numbers, named = self._tabled(mine.plan, owners)
        self._before = len(numbers)
        if self._back:
            more = self._tabled_back(mine.plan, owners)
            numbers, named = numbers + more[0], [*named, *more[1]]
        # What two plans have in common is the same for all evidence; what is in no block varies.
        self._kept, self._varying = list[Array](), list[_Varying]()
        varying, ways = [], dict(_ways(evidence))
        for owner, each in named:
            array = each.get(owners[owner])
            numbers[each.place] = address(array)  # one that is made when asked for lies elsewhere
            if array is each.get(others[owner]):
                self._kept.append(array)
            elif not any(np.may_share_memory(array, block) for block in mine.blocks):
                way = ways.get(id(array))
                if way is not None and way.of(other.evidence) is not each.get(others[owner]):
                    way = None
                self._varying.append(_Varying(way, owner, each.get, each.lies))
                varying.append(array)
            if each.copied:
                raise Uncompiled("machine code reads a copy of an array")
        self._checks: list[_Check] = []
        for family, belief in evaluated(mine.plan, mine.known, mine.predicted):
            points = standing(family, belief)
            self._checks.append(_check(family, points, len(numbers)))
            numbers += points.places
        self._numbers = _Numbers(numbers, [*mine.blocks, *varying])

    @property
    def stands(self) -> bool:
        """Whether calls would use the traces that are bound, and have often found them right."""
        return all(check.tracer.stands(check.trace) for check in self._checks)

    def __call__(self, graph: DynamicGraph, evidence: BoundEvidence) -> ChainOutcome | None:
        """The posterior given evidence of the form; None where that has to go the general way."""
        made = self._made(evidence)
        blocks, room, varying = made.blocks, self._room, list[Array]()
        for each in self._varying:
            array = each.of(made)
            if each.lies is not None and lies(array) != each.lies:
                return None
            varying.append(array)
        room.read(evidence, blocks)
        numbers = self._numbers.at([*map(address, blocks), *map(address, varying)])
        table = address(numbers)
        self._ahead(table, 0, 1)
        left, closest, far, _ = room.ended[0].numbers(blocks)
        if left or far or not closest * MODERATE > 1.0:
            return None
        if self._back:
            self._behind(table + 8 * self._before, 0, 1)
            left, kept, *_ = room.ended[1].numbers(blocks)
            if left or not kept:
                return None
        elif not np.isfinite(blocks[1].sum() + blocks[2].sum()):
            return None
        for check in self._checks:
            places = table + 8 * check.first
            if not check.clearing.clears_at(check.points, places, squared=check.squared):
                return None
        for check in self._checks:
            check.tracer.prove(check.trace)
        return BoundOutcome.of(graph, self._status, self._kind, made, closest)

    def _made(self, evidence: BoundEvidence) -> _Made:
        """The plan and the arrays of a call for evidence of the form."""
        return _Made(self._blank, self._room, evidence, self._compiled)

    def _owners(self, made: _Made) -> list[Any]:
        """The owners of all arrays of the sweeps."""
        begin = made.plan.layout.begun
        if not begin:
            raise Uncompiled("the belief to begin with depends on evidence")
        record = dict(zip(sweep.BEGIN, begin[0], strict=True))
        ahead = made.forward()
        record |= zip(sweep.KNOWN, (*made.known, ahead.log_density), strict=True)
        record |= zip(sweep.PREDICTED, made.predicted, strict=True)
        record |= zip(("ended", "ended back"), made.ended, strict=False)
        if self._back:
            record |= zip(sweep.SMOOTHED, (made.beliefs.mean, made.beliefs.cov), strict=True)
        return [*made.owners, record, ahead]

    def _tabled(self, plan: ChainPlan, owners: list[Any]) -> tuple[list[int], Owned]:
        """The table of the sweep forward, and the names of its arrays."""
        *_, record, _ = owners
        table = NamedTable(plan, 1, owners, record)
        cpds = {"stored": False, "keep": True, "controlled": False}
        self._ahead = sweeps.made(sweep.told_ahead(plan, table, (), **cpds, gate=None), 1)
        return self._whole(table, record["ended"]), _owned(table, 0)

    def _tabled_back(self, plan: ChainPlan, owners: list[Any]) -> tuple[list[int], Owned]:
        """The table of the sweep back, and the names of its arrays."""
        *_, moved, record, ahead = owners
        table = NamedTable(plan, 1, owners, record)
        self._behind = sweeps.made(sweep.told_back(plan, table, ahead, moved, record), 1)
        return self._whole(table, record["ended back"]), _owned(table, self._before)

    def _whole(self, table: NamedTable, ended: Array) -> list[int]:
        """The numbers of a table, which begins with those that are of the sweep as a whole."""
        table.numbers[told.ITERATIONS] = 1
        table.numbers[told.ENDED] = address(ended)
        return table.numbers


def _owned(table: NamedTable, first: int) -> Owned:
    """The names of a table's arrays, whose numbers begin at `first`."""
    named = table.form.named
    return [(each.owner, each._replace(place=first + each.place)) for each in named]


def bound_to(
    graph: DynamicGraph, evidence: BoundEvidence, schedule: Schedule | None, lineariser: Lineariser
) -> ChainOutcome | None:
    """The posterior by what has been bound for a form of evidence; None where nothing serves.

    A call that is bound has gone the general way before, where all but values was checked.
    """
    blank = Blank.known(graph.layout, evidence, lineariser) if evidence.runs == 1 else None
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


# The schedule of calls that name none.
_ONCE = Smoothing()
# What is found where nobody has tried to bind.
_NOTHING = "nothing"
# Calls in vain, beside as many as served, after which a form of evidence is bound no more.
_FAILURES = 4


def _key(graph: DynamicGraph, schedule: Schedule | None, evidence: BoundEvidence) -> Any:
    """The kind of a call that may be bound, and which sensors lack readings; None of others."""
    if schedule is None:
        schedule = _ONCE
    elif type(schedule) is FixedLag and not schedule.lag:
        schedule = schedule.filtering
    if type(schedule) not in (Filtering, Smoothing) or isinstance(graph, BalancedGraph):
        return None
    assert isinstance(schedule, Filtering | Smoothing)
    if schedule.iterations > 1 or schedule.gate is not None or schedule.damping != 0.0:
        return None
    return type(schedule), *[each.whole for each in evidence.readings]


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
    own = answers.tracer, answers.trace, clearing
    return _Check(*own, first, points.number, points.squared, points.kept)
