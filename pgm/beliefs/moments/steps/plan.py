"""Plans of chains: CPDs with their evidence, placed in the vectors of the slices.

A *slice* is the vector of all hidden variables of a step, of n components; a *pair* is the vector
of the states of the step before, then the slice. A *family* is a CPD at its *rows*: the steps of a
transition, or the measurements of a sensor, of which a step may have several. A *window* is a
stretch of consecutive steps, with a plan of its own.

A sweep goes from step to step, with a few batched kernel calls for each. Its arrays have their
components first and the runs last, (n, *batch), `batch` being () for one run and (runs,) for
several. Reversing a chain, and linearising it again, is one call for all steps, on arrays that have
the time axis first and the runs second.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from pgm.beliefs.moments.steps.account import Account
from pgm.beliefs.moments.steps.open_sensor import by_candidate, made_of
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile import DynamicGraph, SliceLayout
from pgm.compile.dynamic import Place
from pgm.cpds import AffineCPD
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence, Reading
from pgm.evidence.dynamic import Inputs
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, Index, Integers, cut, length
from pgm.linearisation.family import Family
from pgm.linearisers import Lineariser, StatisticalRegression
from pgm.linearisers.numbering import Numbering
from pgm.posteriors.measurements import where_unread
from pgm.schedules.argument_checks import require_plain
from pgm.tracing import Judge
from pgm.variables import Variable

# Blank plans of so many forms of evidence are kept.
_PLANS = 8


@dataclass(eq=False)
class Link:
    """A CPD at its rows, and where its hidden parents and its child stand in a vector.

    For the prior that is the vector of states, for the transition the pair. `angles` are the
    components of the child that are angles, `before` the places in that vector of the same angles
    one step before; both are empty for an affine CPD, and where the child does not depend on
    itself a step before.
    """

    family: Family
    parents: Index
    child: slice
    angles: Integers
    before: Integers

    def with_family(self, family: Family) -> Link:
        """The CPD's place, with its family for other evidence."""
        part = object.__new__(Link)
        part.__dict__.update(self.__dict__, family=family)
        return part

    @cached_property
    def turning(self) -> list[tuple[int, int]]:
        """Pairs (i, j): component i of the child is an angle, and stands at j one step before."""
        return list(zip(self.angles.tolist(), self.before.tolist(), strict=True))


class Unread(NamedTuple):
    """Sensors at steps where nothing may have been read, of which readings may be forecast.

    `readings` are as of `BoundEvidence.unread`; the `lineariser` serves nonlinear CPDs that have
    none of their own, and the `numbering` of runs is for the texts of errors.
    """

    readings: tuple[Reading, ...]
    lineariser: Lineariser
    numbering: Numbering


@dataclass(eq=False)
class ChainPlan:
    """A chain of slices with its evidence, ready to be swept.

    `layout` tells where variables stand in a slice and in a pair; `prior`, `transition` and
    `sensors` are the model's CPDs with their evidence and linearisations, parents before children.
    `steps` is T; `runs` are flattened from the user's axes `lead`. `first` is the number of the
    first step, which is not zero online and for a window; `begin` is the belief there given its
    measurements, (n, *batch) and (n, n, *batch), where that takes the prior's place, else None.
    `account` tells which sweeps of this plan, and of the plans cut from it, machine code made, and
    why it did not make the others. `unread` has the sensors at the steps without readings.
    """

    layout: SliceLayout
    steps: int
    lead: tuple[int, ...]
    prior: list[Link]
    transition: list[Link]
    sensors: list[Sensor]
    first: int = 0
    begin: tuple[Array, Array] | None = None
    account: Account = field(default_factory=Account)
    unread: Unread | None = None

    @cached_property
    def linear(self) -> bool:
        """Whether every sensor with measurements is affine."""
        return all(s.family.exact for s in self.sensors if s.family.step.size)

    @cached_property
    def robust(self) -> list[Sensor]:
        """The sensors with robust noise that have measurements."""
        return [s for s in self.sensors if s.robust and s.family.step.size]

    @cached_property
    def runs(self) -> int:
        """How many runs the evidence is of: the product of `lead`, 1 for a single run."""
        return math.prod(self.lead)

    @cached_property
    def batch(self) -> tuple[int, ...]:
        """The trailing run axes of arrays in a sweep: () for one run, (runs,) for several."""
        return () if self.runs == 1 else (self.runs,)

    @property
    def families(self) -> list[Family]:
        """The families of the prior, the transition and the sensors, in this order."""
        links = [link.family for link in (*self.prior, *self.transition)]
        return links + [sensor.family for sensor in self.sensors]

    @property
    def read(self) -> list[Sensor]:
        """The sensors that have measurements."""
        return [sensor for sensor in self.sensors if sensor.family.step.size]

    @property
    def exact(self) -> bool:
        """Whether every CPD is affine, and every sensor with measurements Gaussian."""
        return all(family.exact for family in self.families) and not self.robust

    def of(self, runs: Index) -> ChainPlan:
        """The plan of some runs, with linearisations of its own, and views for a slice."""

        def links(every: list[Link]) -> list[Link]:
            return [replace(link, family=link.family.of(runs)) for link in every]

        sensors = [
            replace(
                sensor,
                family=sensor.family.of(runs),
                taken=None if sensor.taken is None else cut(sensor.taken, runs),
                values=cut(sensor.values, runs),
                gated=None if sensor.gated is None else sensor.gated.of(runs),
                cross={},
            )
            for sensor in self.sensors
        ]
        lead, begin = (length(runs),), self.begin
        if begin is not None and self.batch:
            one = runs.start if isinstance(runs, slice) and lead == (1,) else runs
            begin = begin[0][..., one], begin[1][..., one]
        return replace(
            self,
            lead=lead,
            begin=begin,
            prior=links(self.prior),
            transition=links(self.transition),
            sensors=sensors,
        )

    def copies(self, count: int) -> ChainPlan:
        """The plan with all its runs so many times, copy after copy, linearised as it is."""

        def links(every: list[Link]) -> list[Link]:
            return [replace(link, family=link.family.copies(count)) for link in every]

        return replace(
            self,
            lead=(count * self.runs,),
            prior=links(self.prior),
            transition=links(self.transition),
            sensors=[sensor.copies(count) for sensor in self.sensors],
            account=Account(),
        )

    def window(self, first: int, last: int, begin: tuple[Array, Array] | None = None) -> ChainPlan:
        """The plan of the steps `first` to `last`: a view of the evidence, its own linearisations.

        `begin` is the belief at `first` given its measurements, (n, *batch) and (n, n, *batch): the
        window then has no prior, and no measurements at `first`. If it is None the prior is kept.
        """

        def links(every: list[Link], start: int, end: int) -> list[Link]:
            return [replace(link, family=link.family.window(start, end)) for link in every]

        after = begin is not None
        return replace(
            self,
            steps=last - first,
            prior=[] if after else links(self.prior, 0, 1),
            transition=links(self.transition, first, last),
            sensors=[sensor.window(first, last, after=after) for sensor in self.sensors],
            first=self.first + first,
            begin=begin,
        )

    def put(self, first: int, part: ChainPlan) -> None:
        """Copy into this plan a window's linearisations, gate decisions and robust weights.

        `first` is the step of this plan where the window `part` begins.
        """
        for link, own in zip(self.prior if part.prior else [], part.prior, strict=True):
            link.family.put(slice(0, own.family.step.size), own.family)
        for link, own in zip(self.transition, part.transition, strict=True):
            link.family.put(slice(first, first + own.family.step.size), own.family)
        seen = {id(sensor.family.cpd): sensor for sensor in part.sensors}
        for sensor in self.sensors:
            read = seen.get(id(sensor.family.cpd))
            if read is not None:
                sensor.put(first, read, after=part.begin is not None)

    def put_runs(self, runs: Index, part: ChainPlan) -> None:
        """Copy into this plan how the CPDs were linearised in `part`, the plan of some of its runs.

        `runs` are those of which `of` made `part`, and `part` has decided no gate anew.
        """
        where = slice(None), runs
        for family, own in zip(self.families, part.families, strict=True):
            family.put(where, own)
        for sensor, of in zip(self.sensors, part.sensors, strict=True):
            if sensor.variable.angles:
                sensor.moved[where] = of.moved
            if sensor.robust:
                sensor.weights.put(where, of.weights)
            for step, between in sensor.cross.items():
                between[runs] = of.cross.get(step, 0.0)

    @classmethod
    def make(
        cls,
        graph: DynamicGraph,
        bound: BoundEvidence,
        lineariser: Lineariser,
        *,
        first: int = 0,
        prior: bool = True,
        probe: bool = True,
        judge: Judge | None = None,
    ) -> ChainPlan:
        """Lay out the families of a graph with evidence, and probe their functions.

        A sensor whose sightings leave a parent open is an `OpenSensor`, which only machine code
        sweeps. The `lineariser` serves nonlinear CPDs that have none of their own. `first` is the
        number of the first step, and without `prior` the plan has none: both are for a plan of
        later steps.
        With `probe` each function is called once on trial, if the graph has not done so before.
        Functions may be replaced by traces, programs recorded from a call of the function. A
        trace's values are compared with the function's: by the `judge` when the inference is done,
        or at once if that is None.

        What does not depend on values is kept by the graph's layout, for the last few forms of
        evidence.
        """
        layout = graph.layout
        whole = prior and not first and all(each.unknown is None for each in bound.readings)
        known = Blank.known(layout, bound, lineariser) if whole else None
        if known is not None:
            plan = known.renewed(bound)
        else:
            plan = cls._laid_out(graph, bound, lineariser, first=first, prior=prior)
            if whole:
                layout.plans.insert(0, Blank.of(plan, bound, lineariser))
                del layout.plans[_PLANS:]
        if probe or judge is not None:
            plan.trace(judge, probe=probe)
        return plan

    def trace(self, judge: Judge | None, *, probe: bool = False) -> None:
        """Have traces stand in for functions; arguments are as of `make`."""
        layout = self.layout
        means = layout.prior_means
        for family in self.families:
            if family.exact:
                continue
            # A graph is probed once; what comes back is checked in every call.
            if probe and family.cpd not in layout.probed:
                family.probe(means)
                layout.probed.update([family.cpd] * bool(family.step.size))
            family.trace(means, judge)

    def settle(self) -> None:
        """Leave noises as they are in the model where no linearisation has an error."""
        for family in self.families:
            family.settle()

    @classmethod
    def _laid_out(
        cls,
        graph: DynamicGraph,
        bound: BoundEvidence,
        lineariser: Lineariser,
        *,
        first: int,
        prior: bool,
    ) -> ChainPlan:
        """The families of a graph with evidence; see `make`."""
        layout, lead = graph.layout, bound.lead

        def family(cpd: Any, place: Place, step: Integers, inputs: Inputs) -> Family:
            rows = step, inputs, lineariser, lead, bound.numbering
            return _family(cpd, place, *rows)

        def link(cpd: Any, scope: Scope, step: Integers, inputs: Inputs) -> Link:
            require_plain([cpd])
            place = layout.place(cpd, scope)
            turning = slice(0 if isinstance(cpd, AffineCPD) else None)
            return Link(
                family(cpd, place, step, inputs),
                place.parents,
                place.child,
                place.angles[turning],
                place.before[turning],
            )

        def sensor(reading: Reading) -> Sensor:
            place, rows = layout.place(reading.cpd, layout.slice), by_candidate(reading)
            made = family(reading.cpd, place, rows.step + first, rows.inputs)
            return _sensor(made, place, reading, layout, bound.steps)

        start, later = np.zeros(1, dtype=np.intp), np.arange(bound.steps) + first + 1
        priors = layout.model.prior if prior else ()
        links = [link(cpd, layout.states, start, {}) for cpd in priors]
        transition = [
            link(cpd, layout.pair, later, inputs)
            for cpd, inputs in zip(layout.model.transition, bound.transition, strict=False)
        ]
        sensors = [sensor(reading) for reading in bound.readings]
        unread = Unread(bound.unread, lineariser, bound.numbering)
        plan = layout, bound.steps, lead, links, transition, sensors, first
        return cls(*plan, unread=unread)

    def unread_family(self, variable: Variable) -> tuple[Family, Index] | None:
        """A sensor at the steps where it may be forecast, and its parents' places in the slice.

        The family's rows are these steps; it is not linearised. None where there are no such rows;
        see `where_unread`.
        """
        if self.unread is None:
            return None
        readings, lineariser, numbering = self.unread
        reading = where_unread(readings, self.layout, variable)
        if reading is None:
            return None
        place = self.layout.place(reading.cpd, self.layout.slice)
        rows = reading.step + self.first, reading.inputs
        return _family(reading.cpd, place, *rows, lineariser, self.lead, numbering), place.parents


def _family(
    cpd: Any,
    place: Place,
    step: Integers,
    inputs: Inputs,
    lineariser: Lineariser,
    lead: tuple[int, ...],
    numbering: Numbering,
) -> Family:
    """The family of a CPD at its place, at rows of steps with values of observed parents."""
    rows = cpd, place.hidden, step, inputs, lineariser, lead
    return Family.make(*rows, template=place.template, numbering=numbering)


@dataclass(frozen=True, eq=False)
class Blank:
    """A plan without evidence, of which plans for evidence of one form are made.

    `plan` has evidence that takes no memory, and so has `evidence`, whose layout is that of the
    form. The `lineariser` is as of `ChainPlan.make`. `bound` has what was found for calls of some
    kinds; see `moments.bound`. `forms` are some that evidence has had; see `BoundEvidence`.
    """

    plan: ChainPlan
    evidence: BoundEvidence
    lineariser: Lineariser
    bound: dict[Any, Any] = field(default_factory=dict)
    forms: list[object] = field(default_factory=list)

    @classmethod
    def known(
        cls, layout: SliceLayout, evidence: BoundEvidence, lineariser: Lineariser
    ) -> Blank | None:
        """The blank plan that a layout has kept for evidence of this form, if there is one."""
        fitting = (each for each in layout.plans if each.fits(evidence, lineariser))
        return next(fitting, None)

    @classmethod
    def of(cls, plan: ChainPlan, bound: BoundEvidence, lineariser: Lineariser) -> Blank:
        """The blank of a plan, just laid out: its part that other evidence of its form shares."""

        def links(every: list[Link]) -> list[Link]:
            return [link.with_family(link.family.emptied()) for link in every]

        plan = replace(
            plan,
            prior=links(plan.prior),
            transition=links(plan.transition),
            sensors=[sensor.emptied() for sensor in plan.sensors],
        )
        return cls(plan, bound.emptied(), lineariser)

    def fits(self, bound: BoundEvidence, lineariser: Lineariser) -> bool:
        """Whether evidence is of this form, and to be linearised in the same way."""
        rule = self.lineariser
        if not (
            rule is lineariser or (isinstance(rule, StatisticalRegression) and rule == lineariser)
        ):
            return False
        form = bound.form
        if form is not None and any(form is each for each in self.forms):
            return True
        alike = self.evidence.alike(bound)
        if alike and form is not None and len(self.forms) < _PLANS:
            self.forms.append(form)
        return alike

    def renewed(self, bound: BoundEvidence) -> ChainPlan:
        """The plan for evidence of this form."""
        known, lead = self.plan, self.plan.lead
        sensors = []
        for sensor, reading in zip(known.sensors, bound.readings, strict=True):
            taken = None if reading.whole else reading.taken
            family = sensor.family.renewed(reading.inputs, lead)
            sensors.append(sensor.renewed(family, reading.values, taken))
        transition = [
            link.with_family(link.family.renewed(inputs, lead))
            for link, inputs in zip(known.transition, bound.transition, strict=False)
        ]
        prior = [link.with_family(link.family.renewed({}, lead)) for link in known.prior]
        unread = Unread(bound.unread, self.lineariser, bound.numbering)
        plan = known.layout, known.steps, lead, prior, transition, sensors
        return ChainPlan(*plan, unread=unread)


def _sensor(
    family: Family, place: Place, reading: Reading, layout: SliceLayout, steps: int
) -> Sensor:
    """The sensor made of its family and of `reading`, its measurements as the evidence has them.

    `place` tells where the hidden parents of its CPD stand in the slice, and `steps` is T.
    EvidenceError for a measurement of a control at step 0, where controls do not exist.
    """
    number = int(family.step[0]) if family.step.size else 1
    for parent in family.hidden:
        if number == 0 and parent not in layout.states:
            raise EvidenceError(
                f"a sighting of {family.cpd.child!r} at step 0, where its parent {parent!r} does "
                "not exist; controls begin at step 1",
                variable=family.cpd.child,
                cpd=family.cpd,
                step=0,
            )
    bounds = np.searchsorted(reading.step, np.arange(steps + 2)).tolist()
    made = made_of(
        reading,
        layout.slice_size,
        family=family,
        parents=place.parents,
        order=reading.order,
        taken=None if reading.whole else reading.taken,
        values=reading.values,
        bounds=bounds,
        cross={},
        whole=isinstance(place.parents, slice) and place.parents == slice(0, layout.slice_size),
    )
    if place.singular is not None:
        made.exact = place.singular
    return made
