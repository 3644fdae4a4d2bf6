"""Running a schedule with a user's own family of beliefs: one sweep forward, and one back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.beliefs.own.kept import closed, kept
from pgm.beliefs.own.marginals import pair
from pgm.beliefs.own.outcome import Hidden, OwnMarginals, OwnOutcome
from pgm.beliefs.own.slices import BACK, TAKEN, Slice
from pgm.beliefs.own.status import status_of
from pgm.beliefs.points.model import ParticleModel
from pgm.boundary import as_floats
from pgm.compile import DynamicGraph
from pgm.errors import ModelError, NumericalError
from pgm.evidence import BoundEvidence
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array, frozen
from pgm.posteriors.associations import by_density
from pgm.posteriors.belief_kind import FILTERED, PREDICTED, SMOOTHED, Kind
from pgm.progress import counted
from pgm.schedules import sweep
from pgm.schedules.schedule import kind_of

if TYPE_CHECKING:
    from pgm.beliefs.own.family import BeliefFamily
    from pgm.schedules.options import Call


class OwnChain:
    """A user's family along a chain, with the methods of a forward sweep, and its record.

    update: Online, how many updates of the step came before, so that each draws anew.
    predicted, known: The beliefs before and after the measurements of each step so far.
    log_density: By step, the log-density of its measurements, (runs,).
    """

    def __init__(self, family: BeliefFamily[Any], model: ParticleModel, update: int = 0) -> None:
        self.family, self.model, self.update = family, model, update
        self.predicted: list[Any] = []
        self.known: list[Any] = []
        self.log_density: list[Array] = []

    def start(self) -> Any:
        """The family's belief over the slice at step 0."""
        return kept(self.family, "begin(at)", self.family.begin(Slice(self.model, 0)))

    def predict(self, step: int, belief: Any) -> Any:
        """The family's belief over a step's slice."""
        found = self.family.predict(Slice(self.model, step), closed(belief))
        return kept(self.family, "predict(at, belief)", found)

    def take(self, step: int, belief: Any) -> tuple[Any, Array]:
        """The family's belief given the measurements of a step, and their log-density, (runs,).

        Nothing is asked where nothing was measured. A log-density that is NaN, plus infinity or of
        a wrong shape is refused.
        """
        at = Slice(self.model, step, TAKEN, self.update)
        if not at.measurements:
            return belief, np.zeros(at.runs)
        found = self.family.take(at, closed(belief))
        belief, told = pair(self.family, "take(at, belief)", found, "the belief and a log-density")
        log_density = as_floats(told, f"{self.family!r}: the log-density of take", ModelError)
        if log_density.shape not in ((), (at.runs,)):
            raise ModelError(
                f"{self.family!r}: the log-density of take(at, belief) has shape "
                f"{log_density.shape} at step {step}; ({at.runs},), one a run, was due"
            )
        log_density = np.broadcast_to(log_density, (at.runs,))
        bad = np.isnan(log_density) | (log_density == np.inf)
        if bad.any():
            place = int(bad.argmax())
            run = self.model.bound.first_run + place
            missing = [m.variable for m in at.measurements if np.isnan(m.value[place]).any()]
            raise NumericalError(
                f"{self.family!r}: the log-density of the measurements at step {step}, run {run}, "
                f"is {log_density[place]}"
                + (f"; {listed(missing)} is missing there, in part or whole" if missing else ""),
                step=step,
                run=run,
            )
        return kept(self.family, "take(at, belief)", belief), log_density

    def keep(self, step: int, predicted: Any, known: Any, log_density: Array | float) -> None:
        """Keep a step's beliefs and the log-density of its measurements."""
        self.predicted.append(predicted)
        self.known.append(known)
        self.log_density.append(np.asarray(log_density))

    def back(self, step: int, later: Any) -> Any:
        """The family's belief over a step's slice that knows what that of the next step knows."""
        at = Slice(self.model, step, BACK)
        known, predicted = self.known[step], self.predicted[step + 1]
        found = self.family.back(at, *map(closed, (known, predicted, later)))
        return kept(self.family, "back(at, known, predicted, later)", found)

    def smoothed(self, kind: Kind) -> list[Any]:
        """The beliefs of all steps that know the measurements up to a lag later, or all."""
        last = len(self.known) - 1
        if kind == SMOOTHED:
            found = dict(sweep.backward(self, last, self.known[-1]))
            return [found[step] for step in range(last + 1)]
        beliefs = []
        for step in counted(range(last + 1), "back"):
            belief = self.known[kind.last(step, last)]
            for before in range(kind.last(step, last) - 1, step - 1, -1):
                belief = self.back(before, belief)
            beliefs.append(belief)
        return beliefs


def run(
    family: BeliefFamily[Any], graph: DynamicGraph, bound: BoundEvidence, call: Call
) -> OwnOutcome:
    """The beliefs of a user's family after a call's schedule, without one smoothed.

    A family that cannot flow back is refused a smoother, by a ModelError.
    """
    kind = kind_of(call.schedule, family.beliefs)
    if kind != FILTERED and not family.flows_back:
        raise ModelError(
            f"{family!r} says not how its beliefs flow back, so that they can be filtered alone: "
            "use pgm.filter, or define back(at, known, predicted, later)"
        )
    model = ParticleModel(graph.model, by_density(bound), np.float64, weighed=False)
    chain = OwnChain(family, model)
    sweep.forward(chain, bound.steps, chain)
    hidden, lead = Hidden(graph.model, dict(model.places)), bound.lead
    log_evidence = frozen(np.sum(chain.log_density, axis=0).reshape(lead))

    def marginals(kind: Kind, beliefs: list[Any]) -> OwnMarginals:
        return OwnMarginals(kind, family, hidden, beliefs, lead)

    before, known = marginals(PREDICTED, chain.predicted), marginals(FILTERED, chain.known)
    which = "" if kind == FILTERED else ", in the forward pass (posterior.filtered)"
    status = status_of(family, chain.known, lead, of=which)
    filtered = OwnOutcome(graph, family, log_evidence, status, before, known)
    if kind == FILTERED:
        return filtered
    beliefs = chain.smoothed(kind)
    status = status_of(family, beliefs, lead, filtered.status)
    later = marginals(kind, beliefs)
    return OwnOutcome(graph, family, log_evidence, status, before, later, filtered)
