"""Several modes of a chain's posterior: iterated smoothers from many starts, as runs of one call.

A start is a trajectory: a point of the prior, sent through the motion without its noise.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.modes.adapted import adapt, warn_of_few
from pgm.beliefs.modes.arrivals import arrived, chosen, patient, warn_of_unsettled
from pgm.beliefs.modes.chain_laws import ModeBeliefs, Trajectories, laws_of
from pgm.beliefs.modes.outcome import ChainModes, Found
from pgm.beliefs.modes.points import white_points
from pgm.beliefs.moments.family import MOMENTS
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.compile import DynamicGraph
from pgm.cpds.caused import has_mixtures
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Integers
from pgm.posteriors.belief_kind import SMOOTHED
from pgm.schedules.convergence import is_iterated
from pgm.schedules.options import Call
from pgm.schedules.schedule import ONCE, Smoothing, kind_of
from pgm.variables import Variable


def run(
    graph: DynamicGraph, bound: BoundEvidence, call: Call, count: int, starts: int, draws: int
) -> ChainModes:
    """The modes at which smoothers from so many starts arrive, `count` at the most.

    They are adapted by so many `draws`; by none if it is 0.
    """
    if kind_of(call.schedule, "modes of one posterior") != SMOOTHED:
        raise ModelError(
            "starts= of a smoother finds modes of a whole record, and a fixed lag sees a part of "
            "it: leave lag= out, or use pgm.filter, whose prior is cut into pieces"
        )
    several = graph.model.mixed or has_mixtures(graph.model.cpds)
    if several or any(reading.unknown is not None for reading in bound.readings):
        raise ModelError(
            "starts= looks for modes of continuous variables, whose CPDs are nonlinear; discrete "
            "variables, mixtures of CPDs and open sightings have hypotheses already: leave starts "
            "out"
        )
    schedule = patient(call, Smoothing)
    begun = _begun(graph, bound, call, starts)
    asked = call._replace(schedule=schedule)

    def infer(some: Integers) -> ChainOutcome:
        """The smoothers from some starts."""
        start: dict[Variable, Array] = {}
        for variable, place in graph.layout.places.items():
            own = np.moveaxis(begun[:, some][..., place], 0, 2)
            if variable not in graph.layout.states:
                own = own[..., 1:, :]
            start[variable] = own.reshape(some.size, *bound.lead, *own.shape[-2:])
        outcome = MOMENTS.infer(graph, bound.repeated(some.size), asked._replace(start=start))
        assert isinstance(outcome, ChainOutcome)
        return outcome

    parts = arrived(infer, starts)
    found = chosen(parts, graph.layout.slice, bound.lead, bound.first_run, count)
    if not is_iterated(call.schedule):  # which warns itself
        warn_of_unsettled(found, schedule.iterations)
    return ChainModes(graph, _adapted(graph, found, bound, asked, draws) if draws else found)


def _adapted(
    graph: DynamicGraph, found: Found, bound: BoundEvidence, call: Call, draws: int
) -> Found:
    """The modes adapted by weighed draws."""
    unadapted = ChainModes(graph, found)
    marginals = {variable: unadapted[variable].components.mean for variable in graph.layout.slice}
    # A mode's own linearisation, of all runs, is that of a smoother which starts there.
    outcomes = []
    for k in range(len(found.weights)):
        start = {variable: mean[..., k, :] for variable, mean in marginals.items()}
        outcome = MOMENTS.infer(graph, bound, call._replace(start=start))
        assert isinstance(outcome, ChainOutcome)
        outcomes.append(outcome)
    target = Trajectories(outcomes[0])
    adapted = adapt(target, laws_of(target.law, outcomes, found.weights), draws)
    warn_of_few(adapted.effective, draws)
    beliefs = ModeBeliefs.make(adapted.laws, graph.layout, bound.lead)
    return found.with_draws(adapted.laws.weights, adapted.log_evidence, adapted.effective, beliefs)


def _begun(graph: DynamicGraph, bound: BoundEvidence, call: Call, starts: int) -> Array:
    """The trajectories of the starts, (T+1, starts, runs, n): points of the prior, driven on."""
    many = bound.repeated(starts)
    plan = ChainPlan.make(graph, many, call.lineariser)
    chain = MomentChain(plan, ONCE, keep=False)
    mean, cov = chain.start().by_run
    lower = roots.root(cov)
    if not np.isfinite(lower).all():
        raise EvidenceError(
            "starts= are points of the prior, which has an infinite variance: give it a finite one"
        )
    size = mean.shape[-1]
    every = np.repeat(white_points(starts, size), bound.runs, axis=0)
    at = Moments.of(plan, mean + (lower @ every[..., None])[..., 0], np.zeros_like(cov))
    found = [at.by_run[0]]
    for step in range(1, bound.steps + 1):
        moved = chain.predict(step, at)
        at = Moments(moved.mean, np.zeros_like(moved.cov))
        found.append(at.by_run[0])
    return np.stack(found).reshape(bound.steps + 1, starts, bound.runs, size)
