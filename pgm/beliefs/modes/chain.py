"""Several modes of a chain's posterior: iterated smoothers from many starts, as runs of one call.

A start is a trajectory: a point of the prior, sent through the motion, without its noise or with.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pgm.beliefs.modes.adapted import adapt, warn_of_few
from pgm.beliefs.modes.arrivals import patient, warn_of_unsettled
from pgm.beliefs.modes.chain_laws import ModeBeliefs, Trajectories, laws_of
from pgm.beliefs.modes.laws import Laws
from pgm.beliefs.modes.outcome import ChainModes, Found
from pgm.beliefs.modes.points import white_points
from pgm.beliefs.modes.search import Search
from pgm.beliefs.moments.family import MOMENTS
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.compile import DynamicGraph
from pgm.cpds.caused import has_mixtures
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence
from pgm.factors.scope import Scope
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Integers, apply
from pgm.posteriors.belief_kind import SMOOTHED
from pgm.schedules.convergence import is_iterated
from pgm.schedules.options import Call
from pgm.schedules.schedule import ONCE, Smoothing, kind_of
from pgm.schedules.starting_points import Start
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
    schedule = patient(call, Smoothing)
    search = ChainSearch.make(graph, bound, call._replace(schedule=schedule))
    found = search.chosen(search.arrived(starts), count)
    if not is_iterated(call.schedule):  # which warns itself
        warn_of_unsettled(found, schedule.iterations)
    if draws:
        laws = search.laws(found)
        adapted = adapt(search.target(laws), laws, draws)
        warn_of_few(adapted.effective, draws)
        beliefs = search.beliefs(adapted.laws)
        found = found.with_draws(
            adapted.laws.weights, adapted.log_evidence, adapted.effective, beliefs
        )
    return search.outcome(found)


@dataclass(frozen=True, eq=False)
class ChainSearch(Search):
    """A chain with its evidence, in whose posterior modes are looked for; see `Search`."""

    schedule = Smoothing

    graph: DynamicGraph
    bound: BoundEvidence
    call: Call

    @classmethod
    def make(cls, graph: DynamicGraph, bound: BoundEvidence, call: Call) -> ChainSearch:
        """The search; a ModelError refuses models that have hypotheses of their own."""
        several = graph.model.mixed or has_mixtures(graph.model.cpds)
        if several or any(reading.unknown is not None for reading in bound.readings):
            raise ModelError(
                "modes are looked for of continuous variables, whose CPDs are nonlinear; discrete "
                "variables, mixtures of CPDs and open sightings have hypotheses already, and need "
                "no starts"
            )
        return cls(graph, bound, call)

    @property
    def lead(self) -> tuple[int, ...]:
        """The axes of runs."""
        return self.bound.lead

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return self.bound.runs

    @property
    def steps(self) -> int:
        """T, the last step."""
        return self.bound.steps

    @property
    def first_run(self) -> int:
        """The number of the first run, from which errors count."""
        return self.bound.first_run

    @property
    def together(self) -> bool:
        """Whether runs are asked together alone, as CPDs differ by run."""
        return bool(self.graph.model.lead)

    @property
    def hidden(self) -> Scope:
        """The variables of a slice."""
        return self.graph.layout.slice

    @property
    def width(self) -> int:
        """The components of a slice."""
        return self.graph.layout.slice_size

    def _of(self, runs: Integers) -> ChainSearch:
        cut = self.bound.mapped(lambda array: array if array.shape[1] == 1 else array[:, runs])
        return replace(self, bound=replace(cut, lead=(runs.size,), form=None))

    def _called(self, call: Call) -> ChainSearch:
        return replace(self, call=call)

    def _inferred(self, count: int, start: Start | None) -> ChainOutcome:
        call = self.call._replace(start=start)
        outcome = MOMENTS.infer(self.graph, self.bound.repeated(count), call)
        assert isinstance(outcome, ChainOutcome)
        return outcome

    def _begun(self, starts: int) -> dict[Variable, Array]:
        """Points of the prior, sent through the motion: every other one with its noise.

        A motion without noise leads from all points of a narrow prior along one path, and modes of
        later steps may lie beside it.
        """
        bound, layout = self.bound, self.graph.layout
        many = bound.repeated(starts)
        plan = ChainPlan.make(self.graph, many, self.call.lineariser)
        chain = MomentChain(plan, ONCE, keep=False)
        mean, cov = chain.start().by_run
        lower = roots.root(cov)
        if not np.isfinite(lower).all():
            raise EvidenceError(
                "starts= are points of the prior, which has an infinite variance: give it a finite "
                "one"
            )
        every = np.repeat(white_points(starts, mean.shape[-1]), bound.runs, axis=0)
        at = Moments.of(plan, mean + apply(lower, every), np.zeros_like(cov))
        each, rng = [at.by_run[0]], np.random.default_rng(0)
        for step in range(1, bound.steps + 1):
            mean, noise = chain.predict(step, at).by_run
            white = rng.standard_normal((starts, mean.shape[-1]))
            white[::2] = 0.0
            mean = mean + apply(roots.root(noise), np.repeat(white, bound.runs, axis=0))
            at = Moments.of(plan, mean, np.zeros_like(noise))
            each.append(mean)
        whole = np.stack(each, axis=1)
        found = {}
        for variable, place in layout.places.items():
            own = whole[:, 0 if variable in layout.states else 1 :, place]
            found[variable] = own.reshape(starts, *self.lead, *own.shape[1:])
        return found

    def target(self, laws: Laws) -> Trajectories:
        """The exact density; a NumericalError refuses a posterior without."""
        once = self.call._replace(schedule=ONCE, start=None)
        outcome = MOMENTS.infer(self.graph, self.bound, once)
        assert isinstance(outcome, ChainOutcome)
        return Trajectories(outcome._plan)

    def laws(self, found: Found) -> Laws:
        """The Gauss–Markov laws of the modes."""
        return laws_of(self.graph.layout, found)

    def beliefs(self, laws: Laws) -> ModeBeliefs:
        """The beliefs of laws."""
        return ModeBeliefs.make(laws, self.graph.layout, self.lead)

    def outcome(self, found: Found) -> ChainModes:
        """The mixtures of the modes."""
        return ChainModes(self.graph, found)
