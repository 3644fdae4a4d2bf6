"""Filters and smoothers whose evidence lies on a card, and whose beliefs stay there.

Evidence is looked at on the card, by run. A few runs, at even distances, come home: the engine
checks their evidence and solves them, and the card's beliefs must be theirs. So do the runs that
the card's sweeps leave, or whose digits may be few; their beliefs go to the card.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled.sweep import stretches
from pgm.beliefs.moments.outcomes.doubts import doubt, is_held
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.solvers.card_cells import CardCells
from pgm.beliefs.moments.solvers.card_evidence import CardEvidence, by_run
from pgm.beliefs.moments.solvers.laid import Laid, Left, Lying
from pgm.beliefs.moments.solvers.resident import Owner, ResidentChain
from pgm.beliefs.moments.solvers.run import run as run_chain
from pgm.compile import DynamicGraph, compile
from pgm.cpds import CPD
from pgm.errors import (
    EvidenceError,
    ExecutorError,
    LinearisationWarning,
    LostWarning,
    PgmError,
    levels_to_user,
)
from pgm.evidence import BoundEvidence, Reading
from pgm.evidence.on_card import is_there
from pgm.evidence.values import Constant, Sightings
from pgm.kernels.arrays import Array, Integers, Mask, deviation, frozen
from pgm.kernels.machine.emitter.arena import Arena
from pgm.kernels.machine.emitter.driver import OutOfMemory
from pgm.kernels.machine.studies.sums import Cells
from pgm.kernels.machine.sweeps import lying as kernels
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.on_card import CardArray, CardBeliefs, CardMoments, PosteriorOnCard
from pgm.posteriors.outcome import Outcome
from pgm.resources import NUMBER
from pgm.schedules.argument_checks import require_gaussian
from pgm.schedules.options import Call
from pgm.schedules.schedule import Filtering, Smoothing
from pgm.variables import Variable

# So many runs come home at most, to be filtered there too.
_SAMPLE = 16
# Deviations by which their beliefs may differ from the card's.
_AGREES = 1e-6
# And parts by which log-evidence may differ, if evidence has stayed as it was.
_SAME = 1e-9
# Of a filter one run of so many keeps its predicted beliefs: the first alone.
_ALONE = 2**30
# The share of free memory that is left free: the driver takes more than is asked for.
_SPARE = 1 / 32
_HOME = "copy the evidence to this machine's memory (cupy.asnumpy(a), a.cpu().numpy())"

# The beliefs of a chain with its evidence in this machine's memory.
Infer = Callable[[DynamicGraph, BoundEvidence, Call], Outcome[Any]]


def solved(
    model: DynamicBayesianNetwork,
    evidence: Mapping[Variable, Any],
    steps: int | None,
    call: Call,
    infer: Infer,
    graph: DynamicGraph | None = None,
) -> PosteriorOnCard:
    """Filter or smooth evidence that lies on a card; what is not done there is refused, in words.

    `steps` is T, None for that of the evidence, and ``call.compiled`` asks for the card. `infer`
    finds the outcome if anything but the beliefs' arrays is looked at, on the user's `graph`, or
    one of its own.
    """
    if call.schedule is None:
        call = call._replace(schedule=Smoothing())
    _require_asked(model, evidence, call)
    with _driver_told():
        return _There(model, evidence, steps, call, infer, graph).posterior()


class _There:
    """A call with evidence on a card: the user's arguments, and where the numbers lie."""

    def __init__(
        self,
        model: DynamicBayesianNetwork,
        evidence: Mapping[Variable, Any],
        steps: int | None,
        call: Call,
        infer: Infer,
        graph: DynamicGraph | None,
    ) -> None:
        self._model, self._call, self._infer = model, call, infer
        self._evidence = there = CardEvidence(model, evidence, steps)
        self._device, self._places = there.device, there.places
        few = np.linspace(0, there.runs - 1, min(there.runs, _SAMPLE))
        self._sample: Integers = np.unique(few.round().astype(np.intp))
        self._bound = there.bind(self._sample)
        self._graph = graph or compile(model, self._bound.steps, compiled=call.compiled)
        self._here = compile(model, self._bound.steps, compiled=False)
        asked = sorted(set(call.asked(self._graph)) - {"lineariser", "compiled"})
        if asked:
            raise _refused(f"{asked[0]} is not taken")
        self._first: dict[Variable, int] = {}
        for reading in self._bound.readings:
            self._first[reading.cpd.child] = int(reading.step[0]) if reading.step.size else 1
            self._require_read(reading)
        for cpd in (*model.transition, *model.observation):
            self._require_known(cpd)

    def _require_read(self, reading: Reading) -> None:
        """Refuse a sensor whose rows on the card are not those that are read, one after another."""
        sensor = reading.cpd.child
        if reading.unknown is not None:
            raise _refused(f"a sighting of {sensor!r} leaves open what was seen")
        if (np.diff(reading.order) != 1).any():
            raise _refused(f"sightings of {sensor!r} are not in the order of their steps")
        for parent in reading.inputs:
            given = (sensor, parent) in self._places
            there = given or (parent, parent) in self._places
            if there and not given and (np.diff(reading.step) != 1).any():
                raise _refused(f"{parent!r} has to be in the given= of the sightings of {sensor!r}")

    def _require_known(self, cpd: CPD) -> None:
        """Refuse a CPD whose noise depends on inputs that lie on the card."""
        for parent in getattr(getattr(cpd, "cov", None), "given", ()):
            if (cpd.child, parent) in self._places or (parent, parent) in self._places:
                raise _refused(f"the noise of {cpd!r} depends on its inputs")

    def posterior(self) -> PosteriorOnCard:
        """The beliefs, on the card."""
        few, size = self._few(), self._graph.layout.slice_size
        own, rows, runs = self._device, self._graph.steps + 1, self._evidence.runs
        beliefs = tuple(CardCells.empty(own, rows, count, runs) for count in (size, size**2))
        with own.current():
            fine, lost, log_evidence = self._swept(beliefs)
            self._require_alike(beliefs[0], few, fine)
            for some in stretches(~fine):
                found = self._solved(self._evidence.bind(np.arange(some.start, some.stop)))
                lost |= not is_held(found)
                log_evidence[some] = np.reshape(found.log_evidence, -1)
                for cells, array in zip(beliefs, _moments(found), strict=True):
                    numbers = np.moveaxis(array, 1, -1).reshape(rows, cells.cells, -1)
                    cells.fill(numbers, some)
        if lost:
            warnings.warn(doubt(held=False), LostWarning, stacklevel=levels_to_user())
        elif bent := few._misfit():
            warnings.warn(bent, LinearisationWarning, stacklevel=levels_to_user())
        return PosteriorOnCard.lying(
            self._shown(*beliefs),
            frozen(log_evidence.reshape(self._evidence.lead)),
            partial(self._come_home, log_evidence),
        )

    def _few(self) -> ChainOutcome:
        """The beliefs of a few runs, found at home; the run of an error has its own number."""
        try:
            return self._solved(self._bound)
        except PgmError:
            for run in self._sample:
                self._solved(self._evidence.bind(np.array([run])))
            raise

    def _swept(self, beliefs: tuple[CardCells, ...]) -> tuple[Mask, bool, Array]:
        """Sweep all runs on the card, in parts for whose arrays there is room.

        The results are which runs have their digits, whether one of these was ever lost, and the
        log-evidence, (runs,).
        """
        chain, own, runs, first = self._chain(), self._device, self._evidence.runs, 0
        fine, lost, log_evidence = np.zeros(runs, dtype=bool), False, np.zeros(runs)
        most = self._most(chain, beliefs)
        while first < runs:
            part = slice(first, min(first + most, runs))
            fixed, loose = (each.most for each in self._laid(chain, beliefs, part)[1:])
            try:
                with own.room(fixed) as place, own.room(loose) as other:
                    arenas = Arena(own, place, fixed), Arena(own, other, loose)
                    laid, *_ = self._laid(chain, beliefs, part, *arenas)
                    fine[part], gone = laid.swept(own, part.stop - first)
                    lost |= bool((gone & fine[part]).any())
                    log_evidence[part] = self._added(laid.density, part.stop - first)
            except OutOfMemory:
                if most == 1:
                    raise
                most = -(-most // 2)
                continue
            first = part.stop
        return fine, lost, log_evidence

    def _chain(self) -> ResidentChain:
        """The sweeps, told by two runs."""
        evidence = self._evidence.brought(np.minimum([0, 1], self._evidence.runs - 1))
        rest = _ALONE, self._places, self._evidence.missing
        try:
            return ResidentChain(self._graph, self._call, evidence, *rest)
        except Left as error:
            raise _refused(str(error)) from error

    def _most(self, chain: ResidentChain, beliefs: tuple[CardCells, ...]) -> int:
        """How many runs are swept at once; an OutOfMemory where there is no room for one."""
        most, free = self._evidence.runs, (1.0 - _SPARE) * self._device.free()
        while sum(each.most for each in self._laid(chain, beliefs, slice(0, most))[1:]) > free:
            if most == 1:
                raise OutOfMemory("a single run needs more memory than is free")
            most = -(-most // 2)
        return most

    def _laid(
        self,
        chain: ResidentChain,
        beliefs: tuple[CardCells, ...],
        part: slice,
        fixed: Arena | None = None,
        loose: Arena | None = None,
    ) -> tuple[Laid, Arena, Arena]:
        """The sweeps over a part of the runs, in arenas that have no end unless they are given."""
        fixed, loose = fixed or Arena(), loose or Arena()
        given = {owner: self._cells(owner, part.start) for owner in chain.given}
        mean, cov = (each.of(part.start) for each in beliefs)
        runs = part.stop - part.start
        laid = chain.lie_among(fixed, loose, given, (mean, cov), Lying(runs, 1, runs))
        return laid, fixed, loose

    def _cells(self, owner: Owner, run: int) -> Cells:
        """Where numbers of the user's lie from a run on, and the first row that is read."""
        child, of = owner
        lies = self._places.get(owner) or self._places[of, of]
        # Plain arrays begin at step 1; those of sightings have a row for each.
        skipped = 0 if owner in self._places else self._first.get(child, 1) - 1
        down, across, cell = lies.distances
        first = lies.address + NUMBER * (skipped * down + run * across)
        return Cells(first, across, down, cell)

    def _solved(self, bound: BoundEvidence) -> ChainOutcome:
        """The beliefs given evidence at home, without machine code, as functions are."""
        call = self._call
        found = run_chain(self._here, bound, call.schedule, call.lineariser, None)
        found.status._warn()
        return found

    def _added(self, density: Cells, runs: int) -> Array:
        """The sums over the steps of each run."""
        across, down, cell = density[1:]
        given = density.address, down, across, cell, self._graph.steps + 1, 1
        return by_run(self._device, kernels.add(self._device), given, runs)

    def _require_alike(self, there: CardCells, few: ChainOutcome, fine: Mask) -> None:
        """Refuse means of the card's that are not those found at home."""
        mean, cov = _moments(few)
        std = deviation(cov)
        for k, run in enumerate(self._sample.tolist()):
            off = np.abs(there.copy(slice(run, run + 1))[..., 0] - mean[:, k])
            alike = (off <= _AGREES * std[:, k] + _SAME * np.abs(mean[:, k])).all()
            if fine[run] and not alike:
                raise ExecutorError(
                    f"the card's beliefs of run {run} are not those that this machine finds: a "
                    f"function may not be what its trace says, or the card's code is wrong; {_HOME}"
                )

    def _shown(self, mean: CardCells, cov: CardCells) -> CardBeliefs:
        """The beliefs by variable."""
        layout, found = self._graph.layout, {}
        size, rows = layout.slice_size, mean.rows
        for variable in layout.slice:
            skipped, d = 0 if variable in layout.states else 1, variable.dimension
            place = int(np.arange(size)[layout.places[variable]][0])
            each = []
            for cells, own in ((mean, (1,)), (cov, (size, 1))):
                _, across, down, cell = (NUMBER * k for k in cells.of(0))
                begin = skipped * down + place * cell * sum(own)
                shape = *self._evidence.lead, rows - skipped, *(d for _ in own)
                strides = *(across for _ in self._evidence.lead), down, *(cell * k for k in own)
                each.append(CardArray(cells.memory, begin, shape, strides))
            found[variable] = CardMoments(*each)
        return CardBeliefs(found)

    def _come_home(self, log_evidence: Array) -> Outcome[Any]:
        """The outcome of a call with the same evidence, brought home."""
        with _driver_told(), self._device.current():
            self._device.settle()
            bound = self._evidence.bind(None)
        found = self._infer(self._graph, bound, self._call)
        now = np.asarray(found.log_evidence).reshape(-1)
        if not np.allclose(now, log_evidence, rtol=_SAME, atol=_SAME):
            raise EvidenceError(
                "the evidence on the card is not what it was when the call was made: look at the "
                "posterior before you write there, or give a copy"
            )
        return found


def _moments(found: ChainOutcome) -> tuple[Array, Array]:
    """The means (T+1, runs, n) and covariances of an outcome."""
    beliefs = found._swept if found._smoothed is None else found._smoothed
    return beliefs.mean, beliefs.cov


def _require_asked(
    model: DynamicBayesianNetwork, evidence: Mapping[Variable, Any], call: Call
) -> None:
    """Refuse calls, models and evidence that are not for a card's own memory."""
    if type(call.schedule) not in (Filtering, Smoothing):
        raise _refused(f"filters, and smoothers of all steps, take it there, not {call.schedule!r}")
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


def _refused(why: str) -> EvidenceError:
    return EvidenceError(f"evidence that lies on a card is not taken there: {why}; {_HOME}")


@contextmanager
def _driver_told() -> Iterator[None]:
    """A context in which errors of the card's driver are an ExecutorError."""
    try:
        yield
    except OutOfMemory as error:
        raise ExecutorError(
            f"beliefs that stay on the card do not fit there: {error}; give fewer runs at once, "
            f"or {_HOME}"
        ) from error
    except OSError as error:
        raise ExecutorError(f"evidence could not be swept on the card: {error}") from error
