"""Evidence of a dynamic network, checked once and laid out with the time axis first."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from pgm.cpds import CPD, by_step
from pgm.errors import EvidenceError
from pgm.evidence.lengths import Lengths
from pgm.evidence.rows import (
    Rows,
    as_steps,
    complete,
    constant_row,
    due,
    no_evidence_for,
    rows_of,
    taken_of,
    unread,
)
from pgm.evidence.values import Constant, Evidence, OneOf, Sightings, opened, require_whole
from pgm.factors.arrays import common_runs, flat
from pgm.factors.scope import listed, namesake
from pgm.kernels.arrays import Integers, Mask
from pgm.linearisers.numbering import Numbering
from pgm.resources import APIECE, in_threads, require_memory
from pgm.variables import Discrete, Variable

# Values of parents with evidence, (rows, runs or 1, d): a row is a step or a sighting.
Inputs = Mapping[Variable, Rows]
Kind = TypeVar("Kind", bound=np.generic)


@dataclass(frozen=True, eq=False)
class Reading:
    """All measurements of one sensor, sorted by `step`, (M,).

    Row k comes from row ``order[k]`` of the user's evidence.

    `values` are (M, runs or 1, d), zero where not `taken`; of a discrete sensor the index of its
    state, d = 1, or logarithms of weights of its states. `inputs` are values of observed parents,
    likewise; `unknown` is the parent that is not known, with its candidates.
    """

    cpd: CPD
    step: Integers
    order: Integers
    values: Rows
    taken: Mask
    inputs: Inputs
    unknown: tuple[Variable, Any] | None = None

    @cached_property
    def whole(self) -> bool:
        """Whether all components were measured."""
        return bool(self.taken.all())

    def alike(self, other: Reading) -> bool:
        """Whether other measurements are laid out in the same way: all but values is equal."""
        return (
            self.cpd is other.cpd
            and self.unknown is None is other.unknown
            and self.values.shape == other.values.shape
            and self.taken.shape == other.taken.shape
            and _same(self.step, other.step)
            and _same(self.order, other.order)
            and _same_shapes(self.inputs, other.inputs)
        )


def _same(one: Integers, other: Integers) -> bool:
    return one is other or np.array_equal(one, other)


def _same_shapes(one: Inputs, other: Inputs) -> bool:
    """Whether values of the same variables, in the same order, have the same shapes."""
    return len(one) == len(other) and all(
        a == b and x.shape == y.shape
        for (a, x), (b, y) in zip(one.items(), other.items(), strict=True)
    )


@dataclass(frozen=True, eq=False)
class BoundEvidence:
    """Evidence laid out by step; inside, the leading axes, of runs, are flattened to one.

    For each transition CPD it has the values of observed parents, (T, runs or 1, d), row k being of
    step k + 1. Messages count runs from `first_run`, where these are a part of more. With
    `candidates`, axes of `lead` are sightings, runs and candidates, each of which is tried with
    each sighting of a step. With a number of `own_runs`, the runs are hypotheses of so many runs of
    the user's, one of each run after another. All evidence that has the same `form`, if it has any,
    is laid out in the same way.

    `unread` are sensors at all steps of which observed parents are known, with values of these and
    no component taken: those at which a reading may be forecast. A sensor with a plain array of T
    rows, or with parents in its sightings' given=, is not among them: its readings have all rows.
    """

    steps: int
    lead: tuple[int, ...]
    transition: tuple[Inputs, ...]
    readings: tuple[Reading, ...]
    first_run: int = 0
    form: object = None
    candidates: bool = False
    own_runs: int | None = None
    unread: tuple[Reading, ...] = ()

    @property
    def runs(self) -> int:
        """Number of runs."""
        return math.prod(self.lead)

    @property
    def numbering(self) -> Numbering:
        """The numbers of runs in the texts of errors."""
        if self.own_runs is not None:
            return Numbering(self.first_run, self.own_runs)
        if not self.candidates:
            return Numbering(self.first_run)
        runs, candidates = self.lead[1:]
        return Numbering(self.first_run, runs, candidates)

    def mapped(self, change: Callable[[Any], Any]) -> BoundEvidence:
        """The layout with a function's values of all its arrays, of the same shapes."""

        def inputs(own: Inputs) -> Inputs:
            return {v: change(values) for v, values in own.items()}

        def changed(readings: tuple[Reading, ...]) -> tuple[Reading, ...]:
            return tuple(
                replace(
                    each,
                    values=change(each.values),
                    taken=change(each.taken),
                    inputs=inputs(each.inputs),
                )
                for each in readings
            )

        return replace(
            self,
            transition=tuple(map(inputs, self.transition)),
            readings=changed(self.readings),
            unread=changed(self.unread),
        )

    def repeated(self, count: int) -> BoundEvidence:
        """The evidence with all its runs so many times, on an axis of hypotheses before them."""

        def tiled(array: npt.NDArray[Kind]) -> npt.NDArray[Kind]:
            return array if array.shape[1] == 1 else np.concatenate([array] * count, axis=1)

        lead = (count, *self.lead)
        return replace(self.mapped(tiled), lead=lead, own_runs=self.runs, form=None)

    def emptied(self) -> BoundEvidence:
        """The layout with zeros that take no memory."""
        return self.mapped(lambda array: np.broadcast_to(array.dtype.type(0), array.shape))

    def alike(self, other: BoundEvidence) -> bool:
        """Whether other evidence is laid out in the same way: all but its values is equal."""
        if self.steps != other.steps or self.lead != other.lead:
            return False
        if self.numbering != other.numbering:
            return False
        if len(self.transition) != len(other.transition):
            return False
        if len(self.readings) != len(other.readings):
            return False
        return all(map(_same_shapes, self.transition, other.transition)) and all(
            one.alike(another) for one, another in zip(self.readings, other.readings, strict=True)
        )


# About so many numbers are turned round at a time: they stay in the cache.
_PART = 2**14


def by_row(array: npt.NDArray[Kind], lead: tuple[int, ...], threads: int = 1) -> npt.NDArray[Kind]:
    """A read-only copy of an array (..., rows, d) as (rows, runs or 1, d), runs fastest."""
    if array.ndim == 2:  # of one run
        rows = array[:, None].copy()
        rows.setflags(write=False)  # in an eighth of the time of `flags`
        return rows
    if array.shape[:-2] == lead and len(lead) == 1 and array.transpose(1, 2, 0).flags.c_contiguous:
        rows = array.transpose(1, 2, 0).copy().transpose(0, 2, 1)  # it lies as it is to lie
        rows.flags.writeable = False
        return rows
    source = flat(array, lead, 2)
    memory = np.empty((*source.shape[1:], len(source)), source.dtype)
    size = max(_PART // memory[..., 0].size, 256) if memory.size else 1

    def turn(first: int, last: int) -> None:
        for begin in range(first, last, size):
            part = slice(begin, min(begin + size, last))
            memory[..., part] = source[part].transpose(1, 2, 0)

    in_threads(turn, len(source), min(threads, 1 + memory.size // APIECE))
    rows = memory.transpose(0, 2, 1)
    rows.flags.writeable = False
    return rows


def reading_by_row(reading: Reading, lead: tuple[int, ...], threads: int = 1) -> Reading:
    """A measurement whose arrays have the user's axes, with the axes of runs as one, rows first."""
    return replace(
        reading,
        values=by_row(reading.values, lead, threads),
        taken=by_row(reading.taken, lead),
        inputs={v: by_row(a, lead) for v, a in reading.inputs.items()},
    )


def bind(
    transition: Sequence[CPD],
    observation: Sequence[CPD],
    evidence: Evidence,
    steps: int | None,
    lead: tuple[int, ...] = (),
    *,
    transition_inputs: bool = True,
    drawing: bool = False,
    identities: bool = False,
    among: Container[Variable] = (),
    threads: int = 1,
    forecasts: bool = False,
    whole: bool = True,
) -> BoundEvidence:
    """Check evidence against a dynamic network's CPDs and lay it out by step.

    evidence: Plain arrays (..., T, d) for steps 1..T, constants, and sightings.
    steps: T; None to take it from the plain arrays.
    lead: Leading axes that the runs have at least.
    transition_inputs: Whether the transition is to be used, so that its inputs must be there.
    drawing: Whether measurements are to be drawn: sightings then have no values.
    identities: Whether sightings may leave open what was seen, with `unknown`.
    among: The hidden variables that may be candidates themselves.
    threads: How many share the work on many numbers.
    forecasts: Whether sensors are laid out also at the steps where nothing was read.
    whole: Whether the steps are those of the model, 1..T; else they are a part, at any place.
    """
    open_ = identities, among
    parts = transition, observation, evidence, steps, lead, drawing, open_, threads
    binder = _Binder(*parts, whole=whole)
    return binder.bind(transition if transition_inputs else (), forecasts=forecasts)


class _Binder:
    def __init__(
        self,
        transition: Sequence[CPD],
        observation: Sequence[CPD],
        evidence: Evidence,
        steps: int | None,
        lead: tuple[int, ...],
        drawing: bool,
        identities: tuple[bool, Container[Variable]],
        threads: int,
        *,
        whole: bool,
    ) -> None:
        self.changing = by_step.among((*transition, *observation)) if whole else None
        self.evidence, self.drawing = evidence, drawing
        self.identities, self.among = identities
        self.threads = threads
        self.lead, self.transition = lead, transition
        self.hidden = {cpd.child for cpd in transition}
        self.sensors = {cpd.child: cpd for cpd in observation}
        self._check_known((*transition, *observation))
        self.arrays = {
            variable: rows_of(variable, value, "T")
            for variable, value in evidence.items()
            if not isinstance(value, (Constant, Sightings))
        }
        for variable, value in evidence.items():
            if isinstance(value, Constant):
                constant_row(variable, value)
        self.steps = self._length(steps)
        self.span = np.arange(1, self.steps + 1)
        self.shapes: list[tuple[str, tuple[int, ...]]] = [("the model's priors", lead)]

    def bind(self, transition: Sequence[CPD], *, forecasts: bool) -> BoundEvidence:
        self._check_inputs()
        inputs = [self._inputs(cpd, {}, self.span) for cpd in transition]
        readings = [self._reading(z) for z in self.sensors if z in self.evidence or self._drawn(z)]
        lead = common_runs(self.shapes)
        return BoundEvidence(
            self.steps,
            lead,
            tuple({v: by_row(a, lead, self.threads) for v, a in each.items()} for each in inputs),
            tuple(reading_by_row(reading, lead, self.threads) for reading in readings),
            unread=tuple(self._unread(lead)) if forecasts else (),
        )

    def _unread(self, lead: tuple[int, ...]) -> Iterator[Reading]:
        """The sensors of `BoundEvidence.unread`, whose inputs have no say about the runs `lead`."""
        shapes, wide = self.shapes, math.prod(lead)
        for sensor, cpd in self.sensors.items():
            value, rows = self.evidence.get(sensor), self.arrays.get(sensor)
            if isinstance(value, Sightings) and value.given:
                continue
            if rows is not None and rows.shape[-2] == self.steps:
                continue
            begun = rows is not None or any(parent in self.arrays for parent in cpd.parents)
            begun = begun or cpd.steps is not None
            step = self.span if begun else np.arange(self.steps + 1)
            # Evidence that no reading needs is not refused, whatever it is: there is no forecast.
            self.shapes = [("the runs", lead)]
            with suppress(EvidenceError):
                inputs = self._inputs(cpd, {}, step)
                if math.prod(common_runs(self.shapes)) == wide:
                    shape = step.size, 1, max(sensor.dimension, 1)
                    yield Reading(
                        cpd,
                        step,
                        np.arange(step.size),
                        np.broadcast_to(0.0, shape),
                        np.broadcast_to(False, shape),
                        {v: by_row(a, lead, self.threads) for v, a in inputs.items()},
                    )
        self.shapes = shapes

    def _check_known(self, cpds: Sequence[CPD]) -> None:
        known = {v for cpd in cpds for v in cpd.scope if not v.lag or v.template not in self.hidden}
        for variable in self.evidence:
            if not isinstance(variable, Variable):
                raise no_evidence_for(variable, known)
            if variable.template in self.hidden:
                raise self._of_hidden(variable, cpds)
            if variable.step is not None and variable.template in known:
                raise EvidenceError(
                    f"evidence for the single step {variable!r}; give {variable.template!r} an "
                    f"array {due(variable)} of steps 1..T or, where it is a sensor's "
                    "measurement, sightings with step=",
                    variable=variable,
                    step=variable.step,
                )
            if variable not in known:
                raise no_evidence_for(variable, known)

    def _of_hidden(self, variable: Variable, cpds: Sequence[CPD]) -> EvidenceError:
        child = variable.template
        cpd = next(cpd for cpd in self.transition if cpd.child == child)
        advice = f"declare a sensor of it ({_sensor_of(child)})"
        if not any(child == parent.template for each in cpds for parent in each.parents):
            # Nothing depends on it, as nothing does on a measurement.
            advice = (
                f"if it is a sensor's measurement, the CPD belongs in observation=; else {advice}"
            )
        return EvidenceError(
            f"evidence for {variable!r}, which is hidden since {cpd!r} stands in transition=; "
            f"{advice}",
            variable=variable,
            cpd=cpd,
        )

    def _length(self, steps: int | None) -> int:
        lengths = Lengths(self.arrays, self.sensors, self.evidence, self.changing)
        found = lengths.steps(steps, self._unexplained())
        if steps is None and self.changing is None:
            if not math.prod(self.lead) > 1:
                lengths.warn_of_columns(found)
            lengths.warn_of_step_behind(found)
            return found
        require_memory(
            found * sum(variable.dimension for variable in self.hidden),
            f"the hidden variables at {steps} steps",
            "take fewer steps",
            error=EvidenceError,
        )
        return found

    def _unexplained(self) -> tuple[Variable, CPD] | None:
        """An input of the transition without evidence, and its CPD."""
        for cpd in self.transition:
            for parent in cpd.parents:
                if parent.template not in self.hidden and parent not in self.evidence:
                    return parent, cpd
        return None

    def _check_inputs(self) -> None:
        for variable, value in self.evidence.items():
            if isinstance(value, Sightings) and variable not in self.sensors:
                raise EvidenceError(
                    f"sightings of {variable!r}, which is no sensor's measurement; give its values "
                    f"as an array {due(variable)}, a constant, or in the sightings' given=",
                    variable=variable,
                )
            if isinstance(value, Constant) and variable in self.sensors:
                raise EvidenceError(
                    f"a constant measurement of {variable!r} does not say at which steps; give an "
                    "array or sightings",
                    variable=variable,
                )

    def _drawn(self, sensor: Variable) -> bool:
        """Whether a sensor without an entry is to be drawn at steps 1..T all the same."""
        cpd = self.sensors[sensor]
        seen = {v for v in cpd.parents if v not in self.hidden}
        return self.drawing and seen <= set(self.evidence)

    def _reading(self, sensor: Variable) -> Reading:
        cpd, value = self.sensors[sensor], self.evidence.get(sensor)
        if isinstance(value, Sightings):
            given, count = value.given, None
            rows: Rows | None = None
            if value.values is not None:
                rows = rows_of(sensor, value.values, "M")
                count = rows.shape[-2]
            runs = 1 if rows is None else math.prod(rows.shape[:-2])
            step = as_steps(sensor, value.step, count, self.steps, runs)
            if self.changing is not None and cpd.steps is not None and not step.all():
                raise EvidenceError(
                    f"a sighting of {sensor!r} at step 0: {cpd!r} has numbers of its own at each "
                    f"of the steps 1..{cpd.steps}, and none of step 0; leave it out, or give it to "
                    "a sensor of its own",
                    variable=sensor,
                    cpd=cpd,
                    step=0,
                )
        else:
            given = {}
            rows = self.arrays.get(sensor)
            shorter = rows is not None and rows.shape[-2] < self.steps and not self.drawing
            step = self.span[: rows.shape[-2]] if shorter and rows is not None else self.span
        if self.drawing:
            rows = np.full((step.size, sensor.dimension), np.nan)
            if isinstance(sensor, Discrete):
                rows = unread(step.size)
        elif rows is None:
            raise EvidenceError(
                f"sightings of {sensor!r} have no values; only sample() draws them", variable=sensor
            )
        self.shapes.append((repr(sensor), rows.shape[:-2]))
        order, sorted_already = np.arange(step.size), bool((step[1:] >= step[:-1]).all())
        if not sorted_already:
            order = np.argsort(step, kind="stable")
            step, rows = step[order], rows[..., order, :]
        allowed = self.identities and not self.drawing
        given, unknown = opened(cpd, given, allowed, self.among)
        inputs = self._inputs(cpd, given, step, None if sorted_already else order, unknown)
        taken = taken_of(sensor, rows, step, self.threads)
        if taken is None:
            taken = np.ones(rows.shape[-2:], dtype=bool)
        else:
            rows = np.where(taken, rows, rows.dtype.type(0))
            require_whole(cpd, unknown, taken)
        return Reading(cpd, step, order, rows, taken, inputs, unknown)

    def _inputs(
        self,
        cpd: CPD,
        given: Mapping[Variable, Any],
        step: Integers,
        order: Integers | None = None,
        unknown: tuple[Variable, OneOf] | None = None,
    ) -> Inputs:
        """Values of a CPD's observed parents at rows of some steps, (..., rows, d)."""
        seen = [v for v in cpd.parents if v.template not in self.hidden]
        for variable in given if unknown is None else [*given, unknown[0]]:
            if variable not in seen:
                raise EvidenceError(
                    f"sightings of {cpd.child!r} are given {variable!r}, which is no observed "
                    f"parent of its CPD; those are [{listed(seen)}]{namesake(variable, seen)}",
                    variable=variable,
                    cpd=cpd,
                )
            if variable in self.evidence:
                raise EvidenceError(
                    f"{variable!r} has evidence both at the top level and in the sightings of "
                    f"{cpd.child!r}; give it once",
                    variable=variable,
                    cpd=cpd,
                )
        inputs = {}
        for variable in seen:
            if unknown is not None and variable == unknown[0]:
                continue
            value = given.get(variable, self.evidence.get(variable))
            if value is None:
                raise EvidenceError(
                    f"no evidence for {variable!r}, a parent in {cpd!r} that no CPD explains; "
                    "give its values, or a CPD of its own",
                    variable=variable,
                    cpd=cpd,
                )
            if isinstance(value, Constant):
                row = constant_row(variable, value)[..., None, :]
                rows = np.broadcast_to(row, (*row.shape[:-2], step.size, row.shape[-1]))
            elif variable in given:
                rows = rows_of(variable, value, "M")
                if rows.shape[-2] != step.size:
                    raise EvidenceError(
                        f"sightings of {cpd.child!r}: {step.size} measurements with "
                        f"{rows.shape[-2]} rows of {variable!r}; one for each was due",
                        variable=variable,
                        cpd=cpd,
                    )
                if order is not None:
                    rows = rows[..., order, :]
                rows = complete(variable, rows, step)
            else:
                if step.size and step[0] == 0:
                    raise EvidenceError(
                        f"a sighting of {cpd.child!r} at step 0, but {variable!r} is a plain "
                        "array, which starts at step 1; give it in the sightings' given=",
                        variable=variable,
                        cpd=cpd,
                        step=0,
                    )
                rows = complete(variable, self.arrays[variable], self.span)
                if step is not self.span:
                    rows = rows[..., step - 1, :]
            self.shapes.append((repr(variable), rows.shape[:-2]))
            inputs[variable] = rows
        return inputs


def _sensor_of(variable: Variable) -> str:
    if isinstance(variable, Discrete):
        return f"TableCPD(reading, given={variable.name}, table=...)"
    return f"LinearGaussianCPD(reading, given={{{variable.name}: 1.0}}, ...)"
