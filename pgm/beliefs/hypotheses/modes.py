"""Several modes of one posterior: iterated smoothers from many starts, as runs of one call.

A *start* is a trajectory: a point of the prior, sent through the motion without its noise. From
each an iterated smoother goes to a *fixed point*, at which all CPDs are linearised; fixed points
that are apart are the *modes* of the posterior, and the evidence of the model as it is linearised
there, Laplace's approximation of a mode's mass, weighs them. Arrays have the S starts or K modes
first, then the runs.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from pgm.beliefs.hypotheses.adapted import ModeBeliefs, adapt
from pgm.beliefs.hypotheses.points import white_points
from pgm.beliefs.moments.family import MOMENTS
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.compile import DynamicGraph
from pgm.display import Summary
from pgm.errors import (
    BeliefWarning,
    ConvergenceWarning,
    EvidenceError,
    ModelError,
    NumericalError,
    PgmError,
    levels_to_user,
)
from pgm.evidence import BoundEvidence
from pgm.factors import Gaussian, GaussianMixture
from pgm.factors.scope import Scope
from pgm.kernels import roots
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.semirings import log_sum
from pgm.posteriors.belief_kind import SMOOTHED
from pgm.posteriors.belief_kind import Kind as Knows
from pgm.posteriors.figures import Figures
from pgm.posteriors.outcome import Outcome
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import over_time
from pgm.schedules.convergence import is_iterated
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.options import Call
from pgm.schedules.schedule import ONCE, Smoothing, kind_of
from pgm.variables import Variable

# Two fixed points are one mode if no component differs by more of its deviations.
APART = 0.5
# Draws of fewer effective ones give a warning.
ENOUGH = 100.0
# Linearisations of a smoother from a start, unless a call asks for others.
ITERATIONS = 50


class ModeFigures(Figures):
    """How the smoothers of several starts went.

    Attributes
    ----------
    starts : int
        How many there were, in each run.
    arrived : ndarray of int
        (*runs): how many of them settled.
    modes : ndarray of int
        (*runs): how many modes are kept, no more than were asked for: points more than half a
        deviation apart at which starts settled, or where none did, at which they ended.
    effective : ndarray or None
        (*runs): of draws that adapted the modes the effective number of the last round's; None if
        none were asked for.
    """

    starts: int
    arrived: Integers
    modes: Integers
    effective: Array | None

    def __init__(
        self, starts: int, arrived: Integers, modes: Integers, effective: Array | None = None
    ) -> None:
        for array in (arrived, modes, effective):
            if array is not None:
                array.flags.writeable = False
        self._set(starts=starts, arrived=arrived, modes=modes, effective=effective)

    @property
    def phrases(self) -> list[str]:
        """The figures in words."""
        modes = _range(self.modes)
        found = [
            f"{modes} mode{'s' * (modes != '1')}",
            f"{_range(self.arrived)} of {self.starts} starts settled",
        ]
        if self.effective is not None:
            found.append(f"{_range(self.effective.astype(np.intp))} effective draws")
        return found


def _range(values: Integers) -> str:
    low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
    return str(low) if low == high else f"{low} to {high}"


class _Part(NamedTuple):
    """Some starts, and the beliefs that they led to, with an axis of starts before runs."""

    starts: Integers
    outcome: Any


@dataclass(frozen=True, eq=False, repr=False)
class ModesOutcome(Outcome[GaussianMixture]):
    """Mixtures of the modes of a chain's posterior; leading axes are runs.

    ``posterior[x]`` is a `GaussianMixture` with the user's axes of runs, then one of steps; its
    Gaussians are those of the modes.
    """

    beliefs: ClassVar[str] = "mixtures of several modes"
    silent: ClassVar[str] = "each mode is of a smoother of its own, and no messages are kept"
    moving: ClassVar[bool] = True

    graph: DynamicGraph
    status: Status
    log_evidence: Array
    _parts: Sequence[_Part]
    # By mode the start that found it, (K, runs), and its weight.
    _index: Integers
    _weights: Array

    kind: ClassVar[Knows] = SMOOTHED

    @property
    def log_evidence_kind(self) -> str:
        """``modes`` by Laplace's approximation of those that were found; ``draws`` by weighing."""
        figures = self.status._figures
        return "modes" if getattr(figures, "effective", None) is None else "draws"

    @property
    def _hidden(self) -> Scope:
        return (*self.graph.model.states, *self.graph.model.controls)

    def __getitem__(self, variable: Variable) -> GaussianMixture:
        """The marginal of a hidden variable, at all its steps or at one."""
        return self._mixture([part.outcome[variable] for part in self._parts])

    def joint(self, *variables: Variable) -> GaussianMixture:
        """The joint of hidden variables at steps, ``x.at(3)``."""
        return self._mixture([part.outcome.joint(*variables) for part in self._parts])

    def _mixture(self, each: Sequence[Gaussian]) -> GaussianMixture:
        lead = np.shape(self.log_evidence)
        axes = 1 + len(lead)
        mean = np.concatenate([own.mean for own in each])
        cov = np.concatenate([own.cov for own in each])
        count, runs = self._index.shape
        steps = mean.shape[axes:-1]
        at = self._index, np.broadcast_to(np.arange(runs), (count, runs))

        def of_modes(values: Array, own: int) -> Array:
            """Values (S, *lead, *steps, ...) of the modes, (*lead, *steps, K, ...)."""
            flat = values.reshape(len(values), runs, *values.shape[axes:])
            chosen = np.moveaxis(flat[at], 0, values.ndim - len(lead) - own)
            return chosen.reshape(*lead, *chosen.shape[1:])

        weights = np.moveaxis(self._weights, 0, 1).reshape(*lead, *(1,) * len(steps), count)
        weights = np.broadcast_to(weights, (*lead, *steps, count)).copy()
        found = Gaussian._make(each[0].scope, of_modes(mean, 1), of_modes(cov, 2))
        return GaussianMixture._make(weights, found, each[0].steps)

    @property
    def _title(self) -> str:
        lead = np.shape(self.log_evidence)
        runs = f", runs {lead}" if lead else ""
        return f"Posterior({self.kind}, steps 0..{self.graph.steps}{runs})"

    def _summary(self) -> Summary:
        lead = np.shape(self.log_evidence)
        return over_time(self._title, self, self._hidden, lead, self.graph.steps)


def run(
    graph: DynamicGraph, bound: BoundEvidence, call: Call, count: int, starts: int, draws: int
) -> ModesOutcome:
    """The modes at which smoothers from so many starts arrive, `count` at the most.

    They are adapted by so many `draws`; by none if it is 0.
    """
    if kind_of(call.schedule, "modes of one posterior") != SMOOTHED:
        raise ModelError(
            "starts= of a smoother finds modes of a whole record, and a fixed lag sees a part of "
            "it: leave lag= out, or use pgm.filter, whose prior is cut into pieces"
        )
    if graph.model.mixed or any(reading.unknown is not None for reading in bound.readings):
        raise ModelError(
            "starts= looks for modes of continuous variables, whose CPDs are nonlinear; discrete "
            "variables and open sightings have hypotheses already: leave starts out"
        )
    schedule = _schedule(call)
    begun = _begun(graph, bound, call, starts)
    parts = _arrived(graph, bound, call._replace(schedule=schedule), begun)
    found = _chosen(graph, bound, parts, count, starts)
    if not (found.status.converged.all() or is_iterated(call.schedule)):  # which warns itself
        warnings.warn(
            f"starts={starts}: in some run no smoother from any start had settled after "
            f"{schedule.iterations} linearisations (status.converged, status.arrived); give more "
            "iterations, or more starts",
            ConvergenceWarning,
            stacklevel=levels_to_user(),
        )
    return _adapted(found, bound, call._replace(schedule=schedule), draws) if draws else found


def _adapted(found: ModesOutcome, bound: BoundEvidence, call: Call, draws: int) -> ModesOutcome:
    """The modes of an outcome, adapted by weighed draws."""
    graph, lead = found.graph, bound.lead
    marginals = {variable: found[variable].components.mean for variable in graph.layout.slice}
    # A mode's own linearisation, of all runs, is that of a smoother which starts there.
    outcomes = []
    for k in range(len(found._weights)):
        start = {variable: mean[..., k, :] for variable, mean in marginals.items()}
        outcome = MOMENTS.infer(graph, bound, call._replace(start=start))
        assert isinstance(outcome, ChainOutcome)
        outcomes.append(outcome)
    adapted = adapt(outcomes, found._weights, draws)
    least = float(adapted.effective.min(initial=ENOUGH))
    if least < ENOUGH:
        warnings.warn(
            f"draws={draws}: those of the last round are worth {least:.0f} equally weighted ones "
            "in the worst run (status.effective), too few to adapt modes by: give more draws, or "
            "fewer steps, or leave draws out",
            BeliefWarning,
            stacklevel=levels_to_user(),
        )
    weights = adapted.laws.weights
    beliefs = ModeBeliefs.make(adapted.laws, graph.layout, lead)
    figures = found.status._figures
    assert isinstance(figures, ModeFigures)
    told = ModeFigures(
        figures.starts, figures.arrived, figures.modes, adapted.effective.reshape(lead)
    )
    count = len(weights)
    return replace(
        found,
        status=found.status._with(_figures=told),
        log_evidence=np.asarray(adapted.log_evidence.reshape(lead)),
        _parts=[_Part(np.arange(count), beliefs)],
        _index=np.tile(np.arange(count)[:, None], (1, bound.runs)),
        _weights=weights,
    )


def _schedule(call: Call) -> Smoothing:
    """The smoother from each start: of many iterations, whose steps lower the cost."""
    asked = call.schedule
    damping = getattr(asked, "damping", None) or LevenbergMarquardt()
    if isinstance(asked, Smoothing) and asked.iterations > 1:
        return Smoothing(asked.iterations, asked.tolerance, damping)
    return Smoothing(ITERATIONS, damping=damping)


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


def _arrived(graph: DynamicGraph, bound: BoundEvidence, call: Call, begun: Array) -> list[_Part]:
    """The smoothers from all starts; one that fails in some run is left out of all."""
    layout = graph.layout
    left = [np.arange(begun.shape[1])]
    found: list[_Part] = []
    refused: PgmError | None = None
    while left:
        some = left.pop()
        start: dict[Variable, Array] = {}
        for variable, place in layout.places.items():
            own = np.moveaxis(begun[:, some][..., place], 0, 2)
            if variable not in layout.states:
                own = own[..., 1:, :]
            start[variable] = own.reshape(some.size, *bound.lead, *own.shape[-2:])
        part = bound.repeated(some.size)
        try:
            outcome = MOMENTS.infer(graph, part, call._replace(start=start))
        except (PgmError, np.linalg.LinAlgError) as error:
            if isinstance(error, PgmError):
                refused = refused or error
            if some.size > 1:
                left += [some[: some.size // 2], some[some.size // 2 :]]
            continue
        found.append(_Part(some, outcome))
    if not found:
        raise refused or ModelError("no smoother from any start has arrived")
    return found


def _chosen(
    graph: DynamicGraph, bound: BoundEvidence, parts: Sequence[_Part], count: int, starts: int
) -> ModesOutcome:
    """The outcome of the modes at which smoothers have arrived."""
    runs, layout = bound.runs, graph.layout

    def by_start(name: str) -> Array:
        each = [np.asarray(getattr(part.outcome, name)) for part in parts]
        return np.concatenate([own.reshape(-1, runs) for own in each])

    logs = by_start("log_evidence")
    settled = np.concatenate(
        [np.asarray(part.outcome.status.converged).reshape(-1, runs) for part in parts]
    )
    settled &= np.isfinite(logs)
    none = ~settled.any(axis=0)
    ranked = np.where(settled | (none & np.isfinite(logs)), logs, -np.inf)
    mean, std, angles = _trajectories(parts, layout.slice, runs)
    order = np.argsort(-ranked, axis=0, kind="stable")
    each, filled = np.arange(runs), np.zeros(runs, dtype=np.intp)
    index, weights = np.tile(order[0], (count, 1)), np.full((count, runs), -np.inf)
    for place in order:
        new = (ranked[place, each] > -np.inf) & (filled < count)
        for k, other in enumerate(index):
            off = np.abs(difference(mean[place, each], mean[other, each], angles))
            wide = std[other, each]
            apart = np.where(wide > 0.0, off / np.where(wide > 0.0, wide, 1.0), off > 0.0)
            new &= (k >= filled) | (apart.max(axis=-1, initial=0.0) > APART)
        at = filled[new], each[new]
        index[at], weights[at] = place[new], ranked[place, each][new]
        filled = filled + new
    found = max(int(filled.max(initial=1)), 1)
    index, weights = index[:found], weights[:found]
    total, lead = log_sum(weights, 0), bound.lead
    if not (total > -np.inf).all():
        run = bound.first_run + int((total == -np.inf).argmax())
        raise NumericalError(
            f"run {run}: no smoother from any start has a log-evidence that float64 can hold; are "
            "the evidence and the noises of a size that fits?",
            run=run,
        )
    figures = ModeFigures(starts, settled.sum(axis=0).reshape(lead), filled.reshape(lead))
    status = Status(1, np.zeros((0, *lead)), np.asarray(~none.reshape(lead)), _figures=figures)
    return ModesOutcome(
        graph, status, np.asarray(total.reshape(lead)), parts, index, np.exp(weights - total)
    )


def _trajectories(parts: Sequence[_Part], hidden: Scope, runs: int) -> tuple[Array, Array, Mask]:
    """The means and deviations of all slices at each fixed point, (S, runs, all), and angles."""
    means: list[Array] = []
    stds: list[Array] = []
    angles = []
    for variable in hidden:
        each = [part.outcome[variable] for part in parts]
        for found, name in ((means, "mean"), (stds, "std")):
            whole = np.concatenate([getattr(own, name) for own in each])
            found.append(whole.reshape(len(whole), runs, -1))
        steps = each[0].mean.shape[-2]
        angles.append(np.tile(variable.angle_mask, steps))
    return np.concatenate(means, -1), np.concatenate(stds, -1), np.concatenate(angles)
