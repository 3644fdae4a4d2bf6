"""Filtering with particles in a robot's loop, one step at a time.

*Inputs* are the values of the transition's observed parents. An argument `bound` is the evidence of
a single call, in one run or several: the inputs of a prediction, or the measurements of an update.

A belief has its weighted particles, a *cloud*, in `_cloud`. `_filter` and `_model` are the filter
and the network that made them. Where a step's particles are drawn again once its measurements are
known, `_before` has the particles of the step before, and the inputs that moved them; else it is
None. `behind` is the window of steps that a fixed-lag filter of Gaussian beliefs keeps; it is None,
since particles have no such window.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from pgm.beliefs.particles.chain import ParticleChain
from pgm.beliefs.particles.number import LikelihoodSampling
from pgm.beliefs.particles.record import Record
from pgm.beliefs.particles.run import require_fitting, require_room
from pgm.beliefs.particles.settings import ParticleSettings
from pgm.beliefs.points.cloud import Cloud
from pgm.beliefs.points.components import parts
from pgm.beliefs.points.filter import PointFilter
from pgm.beliefs.points.measurements import online
from pgm.beliefs.points.model import ParticleModel
from pgm.beliefs.points.particle_belief import ParticleBelief
from pgm.beliefs.points.point_mixture import PointMixture
from pgm.compile import DynamicGraph, SliceGraph
from pgm.display import Summary
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence
from pgm.factors.scope import namesake
from pgm.kernels.arrays import Array
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.belief_kind import FILTERED, PREDICTED, Kind
from pgm.posteriors.online_belief import OnlineBelief
from pgm.posteriors.posterior import require_variable
from pgm.posteriors.predictions import require_parents
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import at_a_step
from pgm.schedules import step_evidence
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class OnlineParticleBelief(OnlineBelief):
    """The belief of an online filter at one step, as particles.

    Attributes
    ----------
    step : int
        The number of the step.
    log_evidence : ndarray
        (*runs): ln p of all measurements so far, estimated.
    status : Status
        The status of this step, (*runs, 1).
    kind : Kind
        Filtered after an update, predicted before.

    Examples
    --------
    >>> from pgm.examples import walk, x
    >>> belief = pgm.OnlineFilter(walk, belief=pgm.Particles(10_000, seed=0)).initial()
    >>> belief[x].std.round(1), str(belief.kind)
    (array([1.]), 'predicted')
    """

    step: int
    log_evidence: Array
    status: Status
    kind: Kind
    _filter: ParticleSteps
    _cloud: Cloud
    _model: ParticleModel
    # The particles of the step before, and the inputs that moved them, where they are moved again
    # once the measurements are known.
    _before: tuple[Cloud, BoundEvidence] | None = None
    beliefs: ClassVar[str] = "particles"
    # A window of steps behind it, which particles have none of.
    behind: ClassVar[None] = None

    def __post_init__(self) -> None:
        for array in (self._cloud.states, self._cloud.log_weights, self.log_evidence):
            array.flags.writeable = False

    @property
    def lead(self) -> tuple[int, ...]:
        """The shape of the axes of runs."""
        return self.log_evidence.shape

    def __getitem__(self, variable: Variable) -> ParticleBelief:
        """The marginal of a state or hidden control at the belief's step, its leading axes runs.

        Raises
        ------
        EvidenceError
            If the variable is no hidden variable of the network, or of another step.
        """
        template = require_variable(variable).template
        places = self._model.places
        early = self.step == 0 and template in self._filter.model.controls
        if template not in places or early or variable.step not in (None, self.step):
            raise EvidenceError(
                f"the belief at step {self.step} is over {list(places)}, not {variable!r}"
                f"{namesake(variable, places)}",
                variable=variable,
                step=self.step,
            )
        return ParticleBelief(parts([(template, places[template].start)]), [self._cloud], self.lead)

    def _measurement(
        self, variable: Variable, given: Mapping[Variable, Any]
    ) -> ParticleBelief | PointMixture:
        if variable in self._model.places:
            return self[variable]
        require_parents(self._filter.model, variable, given, self.step)
        return self._filter.measurement(self, variable, given)

    @property
    def _title(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        most = int(self._cloud.counts.max())
        return f"OnlineBelief({self.kind}, step {self.step}, {most:,} particles{runs})"

    def _summary(self) -> Summary:
        model = self._filter.model
        hidden = tuple(v for v in self._model.places if self.step or v in model.states)
        return at_a_step(self._title, self, hidden, self.lead)


class ParticleSteps(PointFilter[OnlineParticleBelief]):
    """A particle filter for one step at a time; made by ``OnlineFilter(model, belief=particles)``.

    Random numbers are keyed by seed, run and step, so that the particles are those of `pgm.filter`.
    Where a belief has one run, and the inputs or measurements given next have several, each of
    these runs goes on from the same particles; if that belief is the prior, each run draws
    particles of its own.

    Parameters
    ----------
    model : DynamicBayesianNetwork
        The network, which may have leading axes of runs.
    belief : ParticleSettings
        How many particles a belief has, and how they are drawn.

    Raises
    ------
    ModelError
        If a proposal, start or injection of the particles does not fit the model, or the particles
        would not fit into memory.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> robot = pgm.OnlineFilter(walk, belief=pgm.Particles(10_000, seed=0))
    >>> belief = robot.predict(robot.initial())
    >>> belief = robot.update(belief, {z: [4.0]})
    >>> belief[x].mean.round(1)
    array([2.])
    """

    belief: ParticleSettings

    def __init__(self, model: DynamicBayesianNetwork, belief: ParticleSettings) -> None:
        self._set(model=model, belief=belief)
        require_fitting(belief, model)
        size = sum(variable.dimension for variable in (*model.states, *model.controls))
        require_room(size, belief, 1, int(np.prod(model.lead)), FILTERED)

    def initial(self) -> OnlineParticleBelief:
        """The prior belief, at step 0, with the model's leading axes of runs."""
        bound = BoundEvidence(0, self.model.lead, (), ())
        chain, record = self._chain(bound, 0)
        cloud = chain.start()
        zero = np.zeros(bound.runs)
        return self._belief(0, PREDICTED, cloud, chain.model, bound, zero, record)

    def measurement(
        self, belief: OnlineParticleBelief, variable: Variable, given: Mapping[Variable, Any]
    ) -> PointMixture:
        """The belief of a sensor's measurement at the step of a predicted belief.

        `given` has the values of the sensor's observed parents, in rows or constant.
        """
        bound, alone = step_evidence.unread(self.model, belief, variable, given)
        bound = step_evidence.at_step(bound, belief.step)
        cloud = self._spread(belief, bound)
        model = ParticleModel(self.model, bound, self.belief.dtype, belief.step)
        return online(model, cloud.normalised(cloud.log_weights)[0], variable, alone=alone)

    def _predicted(
        self, belief: OnlineParticleBelief, bound: BoundEvidence
    ) -> OnlineParticleBelief:
        """The belief one step later, by the inputs of that step.

        Where draws depend on the new step's measurements, as with a proposal, the new belief also
        holds the particles of the old one, from which an update draws again.
        """
        step, before = belief.step + 1, self._spread(belief, bound)
        chain, record = self._chain(bound, belief.step)
        cloud = chain.predict(step, before)
        log_evidence = np.broadcast_to(belief.log_evidence, bound.lead).reshape(-1)
        kept = (before, bound) if self._looks else None
        return self._belief(step, PREDICTED, cloud, chain.model, bound, log_evidence, record, kept)

    def _updated(self, belief: OnlineParticleBelief, bound: BoundEvidence) -> OnlineParticleBelief:
        """The belief given the measurements of its step.

        Where draws depend on the measurements, as with a proposal, the step's particles are first
        drawn again, from the particles of the step before. With a `start`, those of step 0 are
        drawn again from its cells.
        """
        step = belief.step
        cloud = self._spread(belief, bound)
        chain, record = self._chain(bound, step)
        if step == 0 and belief.kind == PREDICTED and self.belief.start is not None:
            cloud = chain.start()
        elif belief._before is not None:
            before, moved = belief._before
            chain, record = self._chain(replace(bound, transition=moved.transition), step - 1)
            cloud = chain.predict(step, self._spread(belief, bound, before))
        known, log_density = chain.take(step, cloud)
        log_evidence = np.broadcast_to(belief.log_evidence, bound.lead).reshape(-1) + log_density
        record.resampled[step] |= np.broadcast_to(belief.status.resampled[..., -1], bound.lead).flat
        return self._belief(step, FILTERED, known, chain.model, bound, log_evidence, record)

    def _chain(self, bound: BoundEvidence, first: int) -> tuple[ParticleChain, Record]:
        """A particle filter of the steps `first` and `first` + 1, and its record.

        The inputs in `bound`, if there are any, are those of step `first` + 1. The record tells
        what happens to the particles, and has the steps 0 to `first` + 1.
        """
        model = ParticleModel(self.model, bound, self.belief.dtype, first)
        record = Record(first + 1, bound.runs)
        return ParticleChain(self._graph, model, self.belief, record), record

    @property
    def _looks(self) -> bool:
        """Whether a step's draws depend on its measurements.

        They do with a proposal, and with a `LikelihoodSampling`.
        """
        by_likelihood = isinstance(self.belief.number, LikelihoodSampling)
        return self.belief.proposal is not None or by_likelihood

    @cached_property
    def _graph(self) -> DynamicGraph:
        return SliceGraph(self.model, 1)

    def _spread(
        self, belief: OnlineParticleBelief, bound: BoundEvidence, cloud: Cloud | None = None
    ) -> Cloud:
        """The particles of a belief, or those of a given cloud, in the runs of the evidence.

        A single run's particles are repeated for each run of the evidence; but if the belief is the
        prior, each run draws particles of its own. An EvidenceError is raised if the belief has
        several runs, and not as many as the evidence.

        cloud: The particles to take instead of the belief's own; None takes those.
        """
        cloud, runs = belief._cloud if cloud is None else cloud, bound.runs
        if cloud.runs == runs:
            return cloud
        if cloud.runs > 1:
            raise EvidenceError(
                f"evidence of runs {bound.lead} for a belief of runs {belief.lead}",
                step=belief.step,
            )
        if belief.step == 0 and belief.kind == PREDICTED:  # each run draws from the prior itself
            chain, _ = self._chain(BoundEvidence(0, bound.lead, (), ()), 0)
            return chain.start()
        return Cloud(
            np.tile(cloud.states, runs),
            np.tile(cloud.log_weights, runs),
            np.arange(runs + 1) * len(cloud.log_weights),
            averages=None if cloud.averages is None else np.tile(cloud.averages, runs),
        )

    def _owns(self, belief: Any) -> bool:
        mine = isinstance(belief, OnlineParticleBelief) and belief._filter.model is self.model
        return mine and belief._filter.belief is self.belief

    def _belief(
        self,
        step: int,
        kind: Kind,
        cloud: Cloud,
        model: ParticleModel,
        bound: BoundEvidence,
        log_evidence: Array,
        record: Record,
        before: tuple[Cloud, BoundEvidence] | None = None,
    ) -> OnlineParticleBelief:
        """Make the user's belief at a step, and warn if few of its particles are effective.

        Measurements that no particle explained are warned of, too.

        kind: Predicted, or filtered if the step's measurements have been taken.
        cloud: The particles.
        model, bound: The network with its evidence, and the evidence.
        log_evidence: ln p of all measurements so far, (runs,).
        record: What has happened at the step.
        before: The particles of the step before and the inputs that moved them, if an update is to
            move them again; None otherwise.
        """
        record.effective[step], record.number[step] = cloud.effective, cloud.counts
        figures = record.figures(bound.lead).at(step)
        figures.warn()
        status = Status.of_figures(figures, bound.lead)
        log_evidence = np.array(log_evidence).reshape(bound.lead)
        return OnlineParticleBelief(step, log_evidence, status, kind, self, cloud, model, before)
