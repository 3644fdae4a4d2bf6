"""Filters whose evidence lies on a card, and whose beliefs stay there.

Evidence is looked at on the card, by run. A few runs, at even distances, come home: the engine
checks their evidence, filters them, and judges traces, and the card's beliefs must be theirs. So
do the runs that the card's sweep leaves, or whose digits may be few; their beliefs go to the card.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled import lying
from pgm.beliefs.moments.compiled.lying import Cells, Known
from pgm.beliefs.moments.compiled.sweep import stretches
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.beliefs.moments.digits.certificate import MODERATE
from pgm.beliefs.moments.outcomes.doubts import doubt, is_held
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.solvers.run import run as run_chain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile import DynamicGraph, compile
from pgm.errors import (
    EvidenceError,
    ExecutorError,
    LinearisationWarning,
    LostWarning,
    PgmError,
    levels_to_user,
)
from pgm.evidence import BoundEvidence
from pgm.evidence.on_card import Lying, brought, is_there, lying_of
from pgm.evidence.values import Constant, Sightings
from pgm.factors.scope import positions
from pgm.kernels.arrays import Array, Integers, Mask, address, deviation, frozen, quiet
from pgm.kernels.machine.emitter.driver import Device, OutOfMemory, device
from pgm.kernels.machine.sweeps import chain as sweeps
from pgm.kernels.machine.sweeps import lying as kernels
from pgm.linearisation.family import cancellation
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.on_card import CardArray, CardBeliefs, CardMoments, PosteriorOnCard
from pgm.posteriors.outcome import Outcome
from pgm.resources import NUMBER
from pgm.schedules.argument_checks import require_gaussian
from pgm.schedules.binding import bind_chain
from pgm.schedules.options import Call
from pgm.schedules.schedule import Filtering
from pgm.tracing import judged
from pgm.variables import Variable

# So many runs come home at most, to be filtered there too.
_SAMPLE = 16
# Deviations by which their beliefs may differ from the card's.
_AGREES = 1e-6
# And parts by which log-evidence may differ, if evidence has stayed as it was.
_SAME = 1e-9
_HOME = "copy the evidence to this machine's memory (cupy.asnumpy(a), a.cpu().numpy())"

# The beliefs of a chain with its evidence in this machine's memory.
Infer = Callable[[DynamicGraph, BoundEvidence, Call], Outcome[Any]]


def filtered(
    model: DynamicBayesianNetwork,
    evidence: Mapping[Variable, Any],
    steps: int | None,
    call: Call,
    infer: Infer,
    graph: DynamicGraph | None = None,
) -> PosteriorOnCard:
    """Filter evidence that lies on a card; what is not done there is refused, in words.

    `steps` is T, None for that of the evidence, and ``call.compiled`` asks for the card. `infer`
    finds the outcome if anything but the beliefs' arrays is looked at, on the user's `graph`, or
    one of its own.
    """
    _require_asked(model, evidence, call)
    with _driver_told():
        return _Filter(model, evidence, steps, call, infer, graph).posterior()


class _Filter:
    """A filter of evidence on a card: the user's arguments, and where the numbers lie."""

    def __init__(
        self,
        model: DynamicBayesianNetwork,
        evidence: Mapping[Variable, Any],
        steps: int | None,
        call: Call,
        infer: Infer,
        graph: DynamicGraph | None,
    ) -> None:
        self._given = graph
        self._model, self._evidence, self._call, self._infer = model, dict(evidence), call, infer
        self._device, self._places = device(), lying_of(evidence)
        with self._device.current():
            self._device.settle()
            for lies in self._places.values():
                _require_own(self._device, lies)
        found = {lies.runs: lies for lies in self._places.values() if lies.runs is not None}
        if len(found) > 1:
            one, other = list(found.values())[:2]
            raise EvidenceError(
                f"evidence for {one.variable!r} has {one.runs} runs on the card, and for "
                f"{other.variable!r} {other.runs}; all of them were due to have as many"
            )
        self._lead = tuple(found)
        self._runs = next(iter(found), 1)
        flags = {key: self._look(lies) for key, lies in self._places.items()}
        self._steps = steps
        self._require_finite(flags)
        self._missing = {z for (z, of), each in flags.items() if z == of and each.any()}
        few = np.linspace(0, self._runs - 1, min(self._runs, _SAMPLE))
        self._sample: Integers = np.unique(few.round().astype(np.intp))
        self._bound = self._bind(self._sample)
        self._steps = self._bound.steps
        # Of which no other call knows, since its plan has arrays that stand in for others.
        self._graph = compile(model, self._steps, compiled=call.compiled)
        self._here = compile(model, self._steps, compiled=False)
        asked = set(call.asked(graph or self._graph)) - {"lineariser", "compiled"}
        for reading in self._bound.readings:
            asked |= {"unknown"} if reading.unknown is not None else set()
            if (np.diff(reading.order) != 1).any():
                raise EvidenceError(
                    f"sightings of {reading.cpd.child!r} that lie on a card have to be in the "
                    "order of their steps",
                    variable=reading.cpd.child,
                )
        if asked:
            raise _refused(f"{sorted(asked)[0]} is not taken")

    def posterior(self) -> PosteriorOnCard:
        """The beliefs, on the card."""
        known = self._swept()
        few = self._few()
        ended = known.ended
        left = (ended[sweeps.LEFT] != 0.0) | (ended[sweeps.FAR] != 0.0)
        left |= ~(ended[sweeps.CLOSEST] * MODERATE > 1.0)
        with self._device.current():
            self._require_alike(known, few, left)
            lost = bool(ended[sweeps.LOST][~left].any())
            for runs in stretches(left):
                found = self._solved(self._bind(np.arange(runs.start, runs.stop)))
                lost |= not is_held(found)
                _put(known, found, runs)
            log_evidence = self._added(known.density)
        if lost:
            warnings.warn(doubt(held=False), LostWarning, stacklevel=levels_to_user())
        elif bent := few._misfit():
            warnings.warn(bent, LinearisationWarning, stacklevel=levels_to_user())
        return PosteriorOnCard.lying(
            self._beliefs(known),
            frozen(log_evidence.reshape(self._lead)),
            partial(self._come_home, log_evidence),
        )

    def _few(self) -> ChainOutcome:
        """The beliefs of a few runs, found at home; the run of an error has its own number."""
        try:
            return self._solved(self._bound)
        except PgmError:
            for run in self._sample:
                self._solved(self._bind(np.array([run])))
            raise

    def _swept(self) -> Known:
        """The beliefs, as a sweep on the card leaves them."""
        wide = self._widened()
        for judge in judged():  # whose traces the few runs at home judge
            with quiet(), judge:
                plan = ChainPlan.make(
                    self._graph, wide, self._call.lineariser, probe=False, judge=judge
                )
                plan = replace(
                    plan,
                    sensors=[
                        lying.with_missing(sensor) if sensor.variable in self._missing else sensor
                        for sensor in plan.sensors
                    ],
                )
                for family in plan.families:
                    if cancellation(family):
                        raise _refused(f"the points of {family.lineariser!r} lie close together")
                try:
                    return lying.sweep(plan, self._places, self._device)
                except Uncompiled as error:
                    raise _refused(str(error)) from error
        raise AssertionError  # there is a judge

    def _widened(self) -> BoundEvidence:
        """The evidence of all runs, with arrays that stand in for those on the card."""

        def inputs(key: Variable | None, own: Any) -> dict[Variable, Array]:
            return {parent: stand(key, parent, values) for parent, values in own.items()}

        def stand(key: Variable | None, of: Variable, values: Array) -> Array:
            lies = self._places.get((of, of))
            if key is not None:
                lies = self._places.get((key, of), lies)
            return values if lies is None else lies.like(values[0, 0], len(values), self._runs)

        readings = tuple(
            replace(
                reading,
                values=(values := stand(reading.cpd.child, reading.cpd.child, reading.values)),
                taken=reading.taken
                if values is reading.values
                else np.broadcast_to(True, values.shape),
                inputs=inputs(reading.cpd.child, reading.inputs),
            )
            for reading in self._bound.readings
        )
        transition = tuple(inputs(None, own) for own in self._bound.transition)
        return replace(
            self._bound,
            lead=self._lead,
            transition=transition,
            readings=readings,
            unread=(),
            form=None,
        )

    def _bind(self, runs: Integers | None) -> BoundEvidence:
        """The evidence of some runs, None for all, brought home and checked."""
        here = brought(self._evidence, self._places, partial(self._home, runs))
        bound = bind_chain(self._model, here, self._steps, identities=True, among=True)
        if runs is None or not self._lead:
            return bound
        return replace(bound, first_run=int(runs[0]))

    def _solved(self, bound: BoundEvidence) -> ChainOutcome:
        """The beliefs given evidence at home, without machine code, as functions are."""
        call = self._call
        found = run_chain(self._here, bound, call.schedule, call.lineariser, None)
        found.status._warn()
        return found

    def _home(self, runs: Integers | None, lies: Lying) -> Array:
        """Numbers of some runs, None for all, copied to this machine's memory."""
        with self._device.current():
            if lies.runs is None or runs is None:
                return _whole(self._device, lies)
            return np.stack([_of_run(self._device, lies.of(int(run))) for run in runs])

    def _look(self, lies: Lying) -> Array:
        """What is found among the numbers of each run; see `kernels.look`."""
        runs = 1 if lies.runs is None else lies.runs
        down, across, cell = lies.distances
        given = lies.address, down, across, cell, lies.rows, lies.shape[-1]
        return self._by_run(kernels.look(self._device), given, runs)

    def _added(self, density: Cells) -> Array:
        """The sums of the rows of each run."""
        given = density.memory.address, *density.distances, density.rows, 1
        return self._by_run(kernels.add(self._device), given, density.runs)

    def _by_run(self, kernel: Any, given: tuple[int, ...], runs: int) -> Array:
        found, own = np.empty(runs), self._device
        with own.current(), own.room(found.nbytes) as out:
            own.launch(kernel, runs, (*given, out, runs), kernels.KINDS)
            own.get(out, address(found), found.nbytes)
        return found

    def _require_finite(self, flags: Mapping[tuple[Variable, Variable], Array]) -> None:
        """Refuse what is no evidence, as evidence at home is, by the first such run."""
        for (key, of), each in flags.items():
            worst = kernels.MISSING if key == of and self._is_sensor(key) else kernels.FINITE
            bad = np.flatnonzero(each > worst)
            if bad.size:
                where = f" (run {bad[0]})" if self._lead else ""
                try:
                    self._bind(bad[:1])
                except EvidenceError as error:
                    told = {"variable": error.variable, "step": error.step}
                    raise EvidenceError(f"{error}{where}", **told) from error
                raise EvidenceError(f"evidence for {of!r} is not finite{where}", variable=of)

    def _is_sensor(self, variable: Variable) -> bool:
        return any(cpd.child == variable for cpd in self._model.observation)

    def _require_alike(self, known: Known, few: ChainOutcome, left: Mask) -> None:
        """Refuse beliefs of the card's that are not those found at home."""
        mean = np.asarray(few._swept.mean)
        std = deviation(few._swept.cov)
        for k, run in enumerate(self._sample.tolist()):
            if left[run]:
                continue
            there = known.mean.copy(slice(run, run + 1))[..., 0]
            apart = np.abs(there - mean[:, k])
            if not (apart <= _AGREES * std[:, k] + _SAME * np.abs(mean[:, k])).all():
                raise ExecutorError(
                    f"the card's beliefs of run {run} are not those that this machine finds: a "
                    f"function may not be what its trace says, or the card's code is wrong; {_HOME}"
                )

    def _beliefs(self, known: Known) -> CardBeliefs:
        """The beliefs by variable."""
        layout, found = self._graph.layout, {}
        size, rows = layout.slice_size, known.mean.rows
        for variable in layout.slice:
            skipped = 0 if variable in layout.states else 1
            d, first = (
                variable.dimension,
                int(np.arange(size)[positions(layout.slice, [variable])][0]),
            )
            each = []
            for cells, own in ((known.mean, (1,)), (known.cov, (size, 1))):
                down, across, cell = (NUMBER * k for k in cells.distances)
                begin = skipped * down + cell * first * sum(own)
                shape = *self._lead, rows - skipped, *(d for _ in own)
                strides = *(across for _ in self._lead), down, *(cell * k for k in own)
                each.append(CardArray(cells.memory, begin, shape, strides))
            found[variable] = CardMoments(*each)
        return CardBeliefs(found)

    def _come_home(self, log_evidence: Array) -> Outcome[Any]:
        """The outcome of a call with the same evidence, brought home."""
        with _driver_told(), self._device.current():
            self._device.settle()
            bound = self._bind(None)
        graph = self._given or compile(self._model, self._steps, compiled=self._call.compiled)
        found = self._infer(graph, bound, self._call)
        now = np.asarray(found.log_evidence).reshape(-1)
        if not np.allclose(now, log_evidence, rtol=_SAME, atol=_SAME):
            raise EvidenceError(
                "the evidence on the card is not what it was when the call was made: look at the "
                "posterior before you write there, or filter a copy"
            )
        return found


def _whole(own: Device, lies: Lying) -> Array:
    """All numbers, copied to this machine's memory with all that lies between them."""
    pairs = zip(lies.strides, lies.shape, strict=True)
    extent = sum(stride * (length - 1) for stride, length in pairs) + NUMBER
    room = np.empty(extent // NUMBER if 0 not in lies.shape else 0)
    own.get(lies.address, address(room), room.nbytes)
    return np.lib.stride_tricks.as_strided(room, lies.shape, lies.strides)


def _of_run(own: Device, lies: Lying) -> Array:
    """The numbers of one run, (rows, d), copied to this machine's memory, and nothing else."""
    found = np.empty(lies.shape)
    (rows, size), (down, cell) = lies.shape, lies.strides
    whole = size == 1 or (cell == NUMBER and down >= NUMBER * size)
    for k in range(1 if whole else size):
        width = NUMBER * (size if whole else 1)
        place = lies.address + k * cell
        own.get(place, address(found[:, k:]), width, rows, NUMBER * size, down)
    return found


def _put(known: Known, found: ChainOutcome, runs: slice) -> None:
    """Put the beliefs of some runs, found at home, on the card."""
    swept, count = found._swept, runs.stop - runs.start
    arrays = swept.mean, swept.cov, swept.log_density
    for cells, array in zip((known.mean, known.cov, known.density), arrays, strict=True):
        rows = np.moveaxis(np.asarray(array), 1, -1)
        cells.fill(rows.reshape(cells.rows, cells.cells, count), runs)


def _require_asked(
    model: DynamicBayesianNetwork, evidence: Mapping[Variable, Any], call: Call
) -> None:
    """Refuse calls, models and evidence that are not for a card's own memory."""
    if not isinstance(call.schedule, Filtering):
        raise _refused("a filter alone takes it there")
    if model.lead:
        raise _refused(f"the priors have runs of their own, {model.lead}")
    require_gaussian((*model.prior, *model.transition, *model.observation), "Gaussian beliefs")
    for variable, value in evidence.items():
        each = {variable: value}
        if isinstance(value, Sightings):
            each = {variable: value.values, **value.given}
        for of, array in each.items():
            axes = 1 if isinstance(value, Constant) else 2
            here = array.value if isinstance(array, Constant) else array
            if not is_there(here) and np.ndim(here) > axes:
                raise _refused(
                    f"evidence for {of!r} beside it has runs of its own, in this machine's memory: "
                    "put it on the card as well"
                )


def _require_own(own: Device, lies: Lying) -> None:
    try:
        own.require_own(lies.address)
    except OSError as error:
        raise EvidenceError(
            f"evidence for {lies.variable!r} does not lie on the card that sweeps, the first that "
            f"CUDA_VISIBLE_DEVICES shows: {error}",
            variable=lies.variable,
        ) from error


def _refused(why: str) -> EvidenceError:
    return EvidenceError(f"evidence that lies on a card is filtered there as it is: {why}; {_HOME}")


@contextmanager
def _driver_told() -> Iterator[None]:
    """A context in which errors of the card's driver are an ExecutorError."""
    try:
        yield
    except OutOfMemory as error:
        raise ExecutorError(
            f"beliefs that stay on the card do not fit there: {error}; filter fewer runs at once, "
            f"or {_HOME}"
        ) from error
    except OSError as error:
        raise ExecutorError(f"evidence could not be filtered on the card: {error}") from error
