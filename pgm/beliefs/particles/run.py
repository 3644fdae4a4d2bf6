"""Inference with particles: a filter, and backward simulation where the schedule smooths."""

from __future__ import annotations

import numpy as np

from pgm.beliefs.particles.backward import Backward
from pgm.beliefs.particles.chain import ParticleChain
from pgm.beliefs.particles.guided_proposal import require_guidable
from pgm.beliefs.particles.outcome import ParticleOutcome
from pgm.beliefs.particles.record import Record
from pgm.beliefs.particles.settings import ParticleSettings
from pgm.beliefs.points.cloud import Cloud
from pgm.beliefs.points.model import ParticleModel
from pgm.compile import DynamicGraph
from pgm.compile.machine import COMPILED, Choice, Compiled, is_for_card
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence
from pgm.networks import DynamicBayesianNetwork
from pgm.networks.compiled_draws import Left
from pgm.posteriors.belief_kind import FILTERED, Kind
from pgm.posteriors.status import Status
from pgm.resources import gibibytes, require_memory
from pgm.schedules import sweep
from pgm.schedules.schedule import Schedule, kind_of


def run(
    graph: DynamicGraph,
    bound: BoundEvidence,
    schedule: Schedule | None,
    particles: ParticleSettings,
    compiled: Choice = None,
) -> ParticleOutcome:
    """The posterior given the evidence `bound`, as particles.

    The schedule says whether they are filtered or smoothed; without one they are smoothed. They are
    filtered by machine code if it is `compiled` that asks for it, and can be; the status tells.
    Warnings tell of few effective particles and of impossible measurements.
    """
    kind = kind_of(schedule, "particles")
    require_fitting(particles, graph.model)
    model = ParticleModel(graph.model, bound, particles.dtype)
    _require_possible(particles, model, kind)
    require_room(model.size, particles, bound.steps + 1, bound.runs, kind)
    record, account = _filtered(graph, model, particles, compiled)
    if account.startswith(COMPILED) and is_for_card(compiled):
        account += "; a card has no particles, and the processor's threads do"
    if account.startswith(COMPILED) and kind != FILTERED:
        account += "; trajectories are drawn by NumPy"
    filtered, clouds, unmoved = tuple(record.clouds), tuple[Cloud, ...](), None
    if kind == FILTERED:
        clouds = filtered
    else:
        backward = Backward(model, particles, filtered, record.restarted)
        clouds = backward.smoothed() if kind.name == "smoothed" else backward.lagged(int(kind.lag))
        unmoved = backward.unmoved
    figures = record.figures(bound.lead, unmoved)
    figures.warn()
    status = Status.of_figures(figures, bound.lead).with_compilation(account)
    log_evidence = record.log_density.sum(axis=0).reshape(bound.lead)
    told = kind, log_evidence, status
    swept = filtered, tuple(record.predicted)
    return ParticleOutcome(graph, particles, *told, model, clouds, *swept)


def _filtered(
    graph: DynamicGraph, model: ParticleModel, particles: ParticleSettings, compiled: Choice
) -> tuple[Record, str]:
    """The record of a filter, and whether it was machine code; ``""`` if that was not asked for."""
    steps, runs, account = model.bound.steps, model.bound.runs, ""
    if compiled:
        # Here, as llvmlite may not be installed.
        from pgm.beliefs.particles.compiled import CompiledChain

        record = Record(steps, runs)
        try:
            threads = compiled.threads if isinstance(compiled, Compiled) else 1
            swift = CompiledChain(graph, model, particles, record, threads)
            try:
                sweep.forward(swift, steps, record)
            except EvidenceError:
                swift.judge()  # as a wrong trace may be why nothing explains the evidence
                raise
            swift.judge()
            return record, swift.account
        except Left as why:
            account = f"not compiled: {why}"
    record = Record(steps, runs)
    sweep.forward(ParticleChain(graph, model, particles, record), steps, record)
    return record, account


def require_fitting(particles: ParticleSettings, model: DynamicBayesianNetwork) -> None:
    """Refuse, by a ModelError, particles whose proposal, start or injection the model rules out."""
    if particles.proposal is not None:
        require_guidable(model)
    if particles.start is not None:
        particles.start.require(model)
    if particles.injection is not None:
        particles.injection.cells.require(model)


def _require_possible(particles: ParticleSettings, model: ParticleModel, kind: Kind) -> None:
    """Refuse particles whose injection or start does not fit the schedule or the evidence.

    A ModelError is raised if there is an injection and the `kind` of the posterior is not filtered.
    An EvidenceError is raised if a state is to be drawn from cells at step 0, and no sensor with
    measurements there depends on this state alone.
    """
    if particles.injection is not None and kind != FILTERED:
        raise ModelError(
            f"{particles!r}: injected particles have no past that a smoother could draw: filter, "
            "or leave injection= out"
        )
    if particles.start is not None and not particles.start.sensors(model, 0):
        raise EvidenceError(
            f"{particles!r}: start= draws from the measurements at step 0, of a sensor that "
            f"depends on {particles.start.variable!r} alone; there are none: give them with "
            "pgm.sightings(values, step=...), or leave start= out",
            variable=particles.start.variable,
            step=0,
        )


def require_room(size: int, particles: ParticleSettings, steps: int, runs: int, kind: Kind) -> None:
    """Refuse, by a ModelError, particles that would not fit memory, before any are drawn.

    size: The number of components of a particle.
    steps, runs: The numbers of steps and of runs whose particles are held at once.
    kind: The kind of the posterior; unless it is filtered, trajectories take room, too.
    """
    share = np.dtype(particles.dtype).itemsize / 8
    # States, weights and ancestors of the filter, and weights before measurements, with states of
    # their own where some are injected; states and weights of trajectories.
    each = (size * share * (1 + (particles.injection is not None)) + 3) * particles.most
    if kind != FILTERED:
        each += (size * share + 1) * particles.trajectories
    entries = int(each * steps * runs)
    over = f"{steps} steps" + (f" of {runs} runs" if runs > 1 else "")
    require_memory(
        entries,
        f"{particles.most:,} particles of {size} components at {over} ({gibibytes(entries)})",
        "take fewer particles, steps or runs to a call; pgm.OnlineFilter(model, belief=) holds one "
        "step at a time",
    )
