"""Filters and smoothers of runs whose readings lie on a card already, and whose beliefs stay there.

A chain is told once, by a plan of a few runs whose numbers are of no matter, and swept for as many
as there is room for: of each array that has runs the card has one of its own, and of each other one
a copy. Readings are drawn there, or they and observed parents lie there as the user has them.
Traces are judged at beliefs of a few runs that come home.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from pgm.beliefs.moments.compiled.groups import groups_of
from pgm.beliefs.moments.compiled.judged import judge
from pgm.beliefs.moments.compiled.key import decisive
from pgm.beliefs.moments.compiled.named_table import NamedTable
from pgm.beliefs.moments.compiled.rows import places
from pgm.beliefs.moments.compiled.sweep import (
    BEGIN,
    KNOWN,
    PREDICTED,
    SMOOTHED,
    begun,
    is_iterated,
    settings,
    squares_of,
    told_ahead,
    told_back,
)
from pgm.beliefs.moments.compiled.table import Record
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled, require_affine_prior, unknown
from pgm.beliefs.moments.digits import certificate, close_points
from pgm.beliefs.moments.outcomes.innovations import measured
from pgm.beliefs.moments.passes.backward import transition
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.solvers.laid import (
    Composed,
    Key,
    Laid,
    Left,
    Lying,
    Sweep,
    Told,
    has_runs,
    key_of,
)
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile import BalancedGraph, DynamicGraph
from pgm.cpds import AffineCPD
from pgm.evidence import Evidence
from pgm.kernels.arrays import Array, Integers, Mask, quiet, vacant
from pgm.kernels.machine.emitter.arena import Arena
from pgm.kernels.machine.emitter.memory import Runs
from pgm.kernels.machine.studies.beliefs import LARGEST
from pgm.kernels.machine.studies.sums import Cells
from pgm.kernels.machine.studies.transitions import Part, Transition
from pgm.kernels.machine.sweeps import chain as sweeps
from pgm.kernels.machine.sweeps import told
from pgm.kernels.machine.sweeps.writer import arrays
from pgm.kernels.moments import Conditional
from pgm.linearisation.family import Family
from pgm.schedules.binding import bind_chain
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.options import Call
from pgm.schedules.schedule import ONCE, Filtering, FixedLag, Smoothing
from pgm.tracing import Judge
from pgm.variables import Variable

# A CPD's child, and the variable whose numbers it has: the child's own, or an observed parent's.
Owner = tuple[Variable, Variable]
# A row of a CPD of the transition, or of a sensor.
AnyRow = TypeVar("AnyRow", bound=told.Row)


class ResidentChain:
    """The sweeps of a filter or a smoother over runs whose readings are drawn on a card.

    It raises a `Left` where some of it would be done by the program.

    Parameters
    ----------
    graph : DynamicGraph
    call : Call
        Of a filter, or of a smoother that linearises once, without a gate.
    evidence : mapping
        Of a few runs, two or more, whose readings are of no matter.
    thinned : int
        Of a filter one run of so many keeps its predicted beliefs.
    there : collection of (Variable, Variable), optional
        The evidence that lies on the card, by its owners; without, readings are drawn there, and
        the NIS of each sensor is kept.
    missing : collection of Variable, optional
        The sensors of whose readings there some are missing, which NaN marks.
    """

    def __init__(
        self,
        graph: DynamicGraph,
        call: Call,
        evidence: Evidence,
        thinned: int,
        there: Collection[Owner] = (),
        missing: Collection[Variable] = (),
    ) -> None:
        self._judge, self.thinned, self._there = Judge(), thinned, there
        self._schedule, self.smooths = _schedule(graph, call)
        if there and self.iterations > 1:
            raise Left("it iterates")
        bound = bind_chain(graph.model, evidence, graph.steps)
        with quiet():
            try:
                plan = ChainPlan.make(graph, bound, call.lineariser, judge=self._judge)
                self.plan = plan
                plan.sensors = [_unseen(s) if s.variable in missing else s for s in plan.sensors]
                self._require_known()
                self._key = decisive(plan, stored=False, keep=self.smooths, gate=None)
                self._record, self._moved = self._fields(), self._transition()
                self._sweeps = list(self._told())
                self.given = dict(self._given())
                self._require_filled()
            except Uncompiled as error:
                raise Left(str(error)) from error

    def _require_known(self) -> None:
        """Refuse a plan of which some would be done by the program."""
        plan, layout = self.plan, self.plan.layout
        if certificate.is_flat(plan):
            raise Left("a prior is flat")
        if close_points.largest(close_points.families(plan)):
            raise Left("the weights of its points cancel, of which the digits are judged here")
        if not plan.steps:
            raise Left("it has no steps")
        if self.smooths and layout.control_places.size:
            raise Left("it smooths hidden controls")
        if self.smooths and not layout.single and layout.slice_size > LARGEST:
            raise Left(f"it smooths several CPDs a step of more than {LARGEST} components")
        if any(sensor.robust for sensor in plan.read):
            raise Left("noise is robust")
        if groups_of(plan, None, stored=False, controlled=False):
            raise Left("sightings of a step have errors in common")
        why = unknown(plan)
        if why is not None:
            raise Left(why)
        require_affine_prior(plan)

    @property
    def iterated(self) -> bool:
        """Whether sensors are linearised again."""
        return is_iterated(self.plan, self._schedule)

    @property
    def iterations(self) -> int:
        """How often sensors are linearised at the most."""
        return self._schedule.iterations

    def _fields(self) -> Record:
        """The arrays by name that sweeps read or fill beside those of CPDs and sensors."""
        plan = self.plan
        lead, size = (plan.steps + 1, plan.runs), plan.layout.slice_size
        for sensor in plan.read:
            if not self._there or (sensor.variable, sensor.variable) in self._there:
                sensor.values = _by_runs(sensor.values, plan.runs)
        begin = begun(plan, self._schedule, keep=self.smooths)
        if any(each.shape[1] != 1 for each in begin):
            raise Left("the belief to begin with depends on the run")
        record: Record = dict(zip(BEGIN, begin, strict=True))
        record |= zip(KNOWN, (*_moments(lead, size), np.zeros(lead)), strict=True)
        record |= zip(PREDICTED, _moments(lead, size), strict=True)
        if not self._there:
            record |= squares_of(plan)
        if self.iterated:
            record["settings"] = settings(self._schedule)
            record["residuals"] = np.zeros((self.iterations + 1, plan.runs))
        if self.smooths:
            record |= zip(SMOOTHED, _moments(lead, size), strict=True)
        return record

    def _transition(self) -> Conditional | None:
        """The transition as the way back reads it, of which several CPDs are composed before."""
        plan, layout = self.plan, self.plan.layout
        if not self.smooths or layout.single:
            return transition(plan) if self.smooths else None
        lead, size, states = (plan.steps, plan.runs), layout.slice_size, layout.state_size
        own = (size, states), (size,), (size, size)
        return Conditional(*(vacant(lead, each) for each in own))

    @property
    def composed(self) -> Composed | None:
        """The transition of several CPDs; see `Told`."""
        plan, layout, moved = self.plan, self.plan.layout, self._moved
        if moved is None or layout.single:
            return None
        parts, laws = list[Part](), list[Array]()
        for link in plan.transition:
            family, own = link.family, (link.family.matrix, link.family.noise)
            kinds = (Runs.BESIDE if has_runs(each, plan.runs) else Runs.SAME for each in own)
            parents = places(link.parents, layout.state_size + layout.slice_size)
            parts.append(Part(parents, link.child.start, family.shape[2], *kinds))
            laws += own
        form = Transition(layout.state_size, tuple(parts))
        return Composed(form, laws, (moved.matrix, moved.cov))

    def _told(self) -> Iterator[Sweep]:
        plan, record = self.plan, self._record
        ahead = {name: array for name, array in record.items() if name not in SMOOTHED}
        links = (link.family for link in plan.transition)
        sensors = (sensor.family for sensor in plan.read)
        table = NamedTable(plan, 1, (*links, *sensors, *plan.read, ahead), ahead)
        thinned = 1 if self.smooths else self.thinned
        cpds: dict[str, Any] = {"stored": False, "keep": self.smooths, "controlled": False}
        found = told_ahead(plan, table, (), **cpds, gate=None, thinned=thinned)
        motions, read = (each.family for each in plan.transition), (s.family for s in plan.read)
        chain: sweeps.Chain = replace(
            found,
            motions=tuple(map(partial(self._fed, table), motions, found.motions)),
            sensors=tuple(map(partial(self._fed, table), read, found.sensors)),
        )
        yield Sweep(chain, table.numbers, table.arrays)
        if self._moved is not None:
            behind = {name: record[name] for name in SMOOTHED}
            before, after = (tuple(record[name] for name in each) for each in (PREDICTED, KNOWN))
            swept = Forward(before[0], before[1], after[0], after[1], after[2])
            owners = swept, self._moved, behind
            table = NamedTable(plan, 1, owners, behind)
            chain = told_back(plan, table, *owners)
            yield Sweep(chain, table.numbers, table.arrays)

    def _fed(self, table: NamedTable, family: Family, row: AnyRow) -> AnyRow:
        """A row of a CPD, to which linear inputs that lie on the card are added there."""
        cpd = family.cpd
        if not isinstance(cpd, AffineCPD):
            return row
        known = _observed(family)
        if not any(self._lies(cpd.child, parent) for parent in known):
            return row
        if cpd.steps is not None:
            raise Left(f"{cpd!r} has numbers of its own at each step")
        return replace(
            row,
            inputs=tuple(table.array(family.inputs[parent]) for parent in known),
            shifts=tuple(table.array(cpd.matrices[parent][None, None]) for parent in known),
            offset=table.array(cpd.offset[None, None]),
        )

    def _lies(self, child: Variable, parent: Variable) -> bool:
        """Whether the numbers of a CPD's observed parent lie on the card."""
        return (child, parent) in self._there or (parent, parent) in self._there

    def _given(self) -> Iterator[tuple[Owner, Key]]:
        """The arrays that stand for evidence on the card, by its owners."""
        plan, sweep = self.plan, self._sweeps[0]
        chain = sweep.chain
        assert isinstance(chain, told.Forward)
        for sensor, form in zip(plan.read, chain.sensors, strict=True):
            own = sensor.variable, sensor.variable
            if own in self._there:
                yield own, key_of(sweep.arrays[form.readings.place])
        families = [link.family for link in plan.transition]
        families += [sensor.family for sensor in plan.read]
        for family, row in zip(families, (*chain.motions, *chain.sensors), strict=True):
            child = family.cpd.child
            for parent, array in zip(_observed(family), row.inputs, strict=False):
                if self._lies(child, parent):
                    yield (child, parent), key_of(sweep.arrays[array.place])

    def _require_filled(self) -> None:
        """Refuse a chain that reads arrays of runs which neither it, draws nor the user fill."""
        plan, (ahead, *_) = self.plan, self._sweeps
        assert isinstance(ahead.chain, told.Forward)
        for sensor, form in zip(plan.read, ahead.chain.sensors, strict=True):
            if key_of(ahead.arrays[form.readings.place]) != key_of(sensor.values):
                raise Left(f"readings of {sensor.variable!r} are not as they are drawn")
        families = [link.family for link in plan.transition]
        families += [sensor.family for sensor in plan.read]
        filled = [*self._record.values(), *(sensor.values for sensor in plan.read)]
        for family in families if self.smooths else ():
            filled += [family.matrix, family.offset, family.noise]
        filled += [sensor.moved for sensor in plan.read] if self.smooths else []
        filled += self._moved or ()
        known = {*map(key_of, filled), *self.given.values()}
        for sweep in self._sweeps:
            for array in arrays(sweep.chain):
                found = sweep.arrays[array.place]
                if has_runs(found, plan.runs) and key_of(found) not in known:
                    raise Left("evidence of CPDs depends on the run")

    def lie(
        self, fixed: Arena, loose: Arena, readings: Mapping[Variable, Cells], of: Lying
    ) -> Laid:
        """The chain with its arrays on a card; copies, which stay, are in the `fixed` arena."""
        held = {key_of(sensor.values): readings[sensor.variable] for sensor in self.plan.read}
        return Laid(self.as_told, fixed, loose, held, of)

    def lie_among(
        self,
        fixed: Arena,
        loose: Arena,
        given: Mapping[Owner, Cells],
        beliefs: tuple[Cells, Cells],
        of: Lying,
    ) -> Laid:
        """The chain over evidence that is `given` on a card, with its beliefs there."""
        held = {self.given[owner]: cells for owner, cells in given.items()}
        pairs = zip(self._belief, beliefs, strict=True)
        held |= {key_of(self._record[name]): cells for name, cells in pairs}
        return Laid(self.as_told, fixed, loose, held, of)

    @property
    def as_told(self) -> Told:
        """The chain as this plan tells it."""
        return Told(
            self.plan,
            self._sweeps,
            self._record,
            self._belief,
            self.iterations,
            self.iterated,
            self.composed,
            self.judge,
        )

    @property
    def _belief(self) -> tuple[str, ...]:
        """The names in the record of the means and covariances that are asked for."""
        return SMOOTHED if self.smooths else KNOWN[:2]

    def dof(self) -> dict[Variable, Integers]:
        """By sensor with evidence how many components each step's readings have, (T+1,)."""
        return {s.variable: measured(self.plan, s)[:, 0] for s in self.plan.sensors}

    def judge(self, known: Sequence[Array], predicted: Sequence[Array], done: Mask) -> None:
        """Judge traces at the beliefs of a few runs, as many as the plan's, that are `done`.

        It raises a `Left` where one is wrong, or its function has changed.
        """
        with quiet():
            judge(self.plan, known, predicted, done, again=self.iterations > 1)
            right = self._judge.passes()
            # Those of the next runs are others, of the same traces.
            self._judge = Judge()
            for family in self.plan.families:
                family.compiled, family.answers = None, None
            self.plan.trace(self._judge)
            key = decisive(self.plan, stored=False, keep=self.smooths, gate=None)
        if not right or key != self._key:
            raise Left("a function has other values than its trace")


class _Unseen(Sensor):
    """A sensor whose readings lie on a card, where NaN marks what was not taken."""

    @property
    def marked(self) -> Array:
        """The values, which stand for the readings."""
        return self.values


def _unseen(sensor: Sensor) -> Sensor:
    """A sensor of whose readings on a card some are missing, of which no array here tells."""
    found = object.__new__(_Unseen)
    none = np.broadcast_to(False, (1, 1, sensor.height))
    found.__dict__.update(sensor.__dict__, taken=none)
    return found


def _observed(family: Family) -> list[Variable]:
    """The observed parents of a CPD, in the order in which sweeps are told of them."""
    template = family.template
    if template is None:
        return [parent for parent in family.cpd.given if parent in family.inputs]
    pairs = zip(template.given, template.places, strict=True)
    return [parent for parent, place in pairs if place is None]


def _schedule(graph: DynamicGraph, call: Call) -> tuple[Filtering, bool]:
    """The filter that a schedule begins with, and whether it smooths."""
    schedule = call.schedule
    if isinstance(graph, BalancedGraph):
        raise Left("a balanced tree is solved by NumPy")
    if type(schedule) is Filtering:
        found, smooths = schedule, False
    elif type(schedule) is Smoothing:
        found, smooths = schedule.first, True
    elif isinstance(schedule, FixedLag):
        raise Left("it has a lag")
    else:
        raise Left(f"it has the schedule {schedule!r}")
    if schedule.iterations > 1 and smooths:
        raise Left("it linearises all steps again")
    if schedule.iterations > 1 and isinstance(schedule.damping, LevenbergMarquardt):
        raise Left("its steps are controlled")
    if schedule.gate is not None:
        raise Left("it has a gate")
    return (found or ONCE), smooths


def _moments(lead: tuple[int, int], size: int) -> tuple[Array, Array]:
    return vacant(lead, (size,)), vacant(lead, (size, size))


def _by_runs(values: Array, runs: int) -> Array:
    """Values (rows, runs, d) in memory of their own, in which runs lie beside each other."""
    found = vacant((len(values), runs), values.shape[2:])
    found[...] = values
    return found
