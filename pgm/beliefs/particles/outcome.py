"""The answer of a particle filter or smoother: beliefs at all steps, log-evidence and status.

A *cloud* has the particles of all runs at one step, with their weights. A posterior has, of each
step, a cloud of the answer in `_clouds`, and those of the forward sweep: in `_ahead` before the
step's measurements, and in `_filtered` given them. `_model` is the network with its evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import inf
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from pgm.beliefs.particles.left_out import without_each
from pgm.beliefs.particles.settings import ParticleSettings
from pgm.beliefs.points.cloud import Cloud
from pgm.beliefs.points.components import parts
from pgm.beliefs.points.laws import Some
from pgm.beliefs.points.measurements import expected, readings_of, unread
from pgm.beliefs.points.model import ParticleModel, Sensor
from pgm.beliefs.points.particle_belief import ParticleBelief
from pgm.beliefs.points.point_mixture import PointMixture
from pgm.compile import DynamicGraph
from pgm.cpds.mixture import UnidentifiedCPD
from pgm.display import Summary
from pgm.errors import EvidenceError
from pgm.evidence import Reading
from pgm.factors.scope import Scope, as_scope, listed
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.stochastic import Dense
from pgm.posteriors.associations import Found, collected
from pgm.posteriors.belief_kind import FILTERED, PREDICTED, Kind, require_smoothed
from pgm.posteriors.hidden import measured, require_step
from pgm.posteriors.left_out import LeftOut, require_all
from pgm.posteriors.outcome import Outcome
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import over_time
from pgm.resources import require_memory
from pgm.schedules.options import Call
from pgm.schedules.schedule import Filtering, FixedLag, Schedule, Smoothing
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class ParticleOutcome(Outcome[ParticleBelief]):
    """The beliefs of a dynamic network as weighted draws.

    Attributes
    ----------
    graph : DynamicGraph
        The compiled network.
    particles : ParticleSettings
        The user's choice: how many particles there are, and how they were drawn.
    kind : Kind
        Filtered, fixed-lag or smoothed. A smoother's particles are trajectories: the i-th of each
        step are one draw of all steps together.
    log_evidence : ndarray
        (*runs): the logarithm of an unbiased estimate of p(measurements).
    status : Status
        How many particles are effective, and where measurements were impossible.
    filtered, predicted : ParticleOutcome
        The beliefs of the forward sweep, given each step's measurements and before them.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> posterior = pgm.filter(walk, {z: [[4.0]]}, belief=pgm.Particles(10_000, seed=0))
    >>> posterior.joint(x.at(1)).std.round(1)
    array([1.])
    >>> posterior[x].mean.ravel().round(1)
    array([0., 2.])
    """

    graph: DynamicGraph
    particles: ParticleSettings
    kind: Kind
    log_evidence: Array
    status: Status
    _model: ParticleModel
    _clouds: tuple[Cloud, ...]
    _filtered: tuple[Cloud, ...]
    _ahead: tuple[Cloud, ...]

    def __post_init__(self) -> None:
        self.log_evidence.flags.writeable = False
        for cloud in (*self._clouds, *self._filtered, *self._ahead):
            cloud.states.flags.writeable = cloud.log_weights.flags.writeable = False

    beliefs: ClassVar[str] = "particles"
    called: ClassVar[str] = "particles"
    moving: ClassVar[bool] = True
    silent: ClassVar[str] = "particles are drawn from slice to slice: there are no messages to show"

    @property
    def family(self) -> ParticleSettings:
        """The family of beliefs that was given: the same as `particles`."""
        return self.particles

    def again(self, seed: int) -> ParticleOutcome:
        """The posterior of the same evidence by particles that are drawn with another seed."""
        schedule: Schedule = FixedLag(int(self.kind.lag)) if self.kind.lag < inf else Smoothing()
        call = Call(Filtering() if self.kind == FILTERED else schedule)
        family: Any = self.particles.with_seed(seed)
        found: ParticleOutcome = family.infer(self.graph, self._model.bound, call)
        return found

    @property
    def readings(self) -> Sequence[Reading]:
        """The measurements, sensor by sensor."""
        return [sensor.reading for sensor in self._model.sensors]

    def __getitem__(self, variable: Variable) -> Any:
        """The marginal of a hidden variable, or of a measurement not taken, by step or of one."""
        layout = self.graph.layout
        if measured(layout, variable) is None:
            return self.joint(variable)
        belief = expected if self.kind == PREDICTED else unread
        return belief(self._model, layout, variable, self._clouds)

    def _readings_of(self, variable: Variable) -> tuple[Integers, Array]:
        return readings_of(self._model, variable)

    @property
    def _hidden(self) -> Scope:
        return tuple(self._model.places)

    @property
    def log_evidence_kind(self) -> str:
        """``particles``: neither exact nor linearised, but an estimate."""
        return "particles"

    def sample(self, count: int, rng: np.random.Generator) -> dict[Variable, Array]:
        """So many of a smoother's trajectories for each run: (count, *runs, steps, d)."""
        require_smoothed(self.kind)
        last, lead = self._clouds[-1], self.log_evidence.shape
        runs = last.runs
        require_memory(
            2 * count * runs * sum(cloud.states.shape[0] for cloud in self._clouds),
            f"{count:,} trajectories in {runs:,} runs",
            "draw fewer at a time",
        )
        places = np.empty((count, runs), dtype=np.intp)
        for run, (first, end) in enumerate(pairwise(last.starts.tolist())):
            weights = np.exp(last.log_weights[first:end])
            by_weight = Dense(weights[None])
            places[:, run] = first + by_weight.draw(np.zeros(count, dtype=np.intp), rng)
        values = np.stack([cloud.states[:, places] for cloud in self._clouds])
        drawn: dict[Variable, Array] = {}
        for variable in self._hidden:
            first = 0 if variable in self.graph.layout.states else 1
            own = values[first:, self._model.places[variable]]
            moved = np.moveaxis(own, (2, 3), (0, 1))
            drawn[variable] = moved.reshape(count, *lead, *moved.shape[2:])
        return drawn

    @cached_property
    def associations(self) -> Found:
        """For each sensor with sightings of unknown things, the probabilities of the candidates.

        A sighting is a measurement of a thing, such as a landmark, which is a parent of the sensor.
        Where the evidence gives ``pgm.unknown`` for this parent, the thing is one of several
        candidates. A sensor's `Associations` have, for each sighting, the probability of each
        candidate, of a new thing, and of a spurious sighting.
        """
        lead = self.log_evidence.shape
        return MappingProxyType(
            dict(
                collected(s.reading, self._responsible(s), len(s.reading.cpd.candidates), lead)
                for s in self._model.sensors
                if isinstance(s.reading.cpd, UnidentifiedCPD)
            )
        )

    def _responsible(self, sensor: Sensor) -> Iterator[Array]:
        """The association probabilities (runs, k + 2) of each of a sensor's sightings in turn.

        The sensor has sightings of unknown things. The probabilities are those of k candidates for
        the thing, of a spurious sighting and of a new thing, averaged over the particles of the
        sighting's step by their weights.
        """
        for row, step in enumerate(sensor.reading.step.tolist()):
            cloud = self._clouds[step]
            total = list[Array]()
            for run in range(cloud.runs):
                place = cloud.of(run)
                states = cloud.states[:, place]
                owner = None if cloud.runs == 1 else np.full(states.shape[1], run)
                found = sensor.responsibilities(row, Some(step, states, states, owner))
                weighs = cloud.weights[place] > 0.0
                total.append(found[:, weighs] @ cloud.weights[place][weighs])
            yield np.stack(total)

    @property
    def filtered(self) -> ParticleOutcome:
        """The filtered beliefs, those of the forward sweep; of a filter, the posterior itself."""
        if self.kind == FILTERED:
            return self
        return replace(self, kind=FILTERED, _clouds=self._filtered)

    @cached_property
    def predicted(self) -> ParticleOutcome:
        """The beliefs before each step's measurements, of these too; those of the forward sweep."""
        clouds = tuple(cloud.normalised(cloud.log_weights)[0] for cloud in self._ahead)
        return replace(self, kind=PREDICTED, _clouds=clouds)

    @cached_property
    def left_out(self) -> LeftOut:
        """The beliefs of readings given all but their own, by sensor."""
        require_all(self.kind)
        sensors = [reading.cpd.child for reading in self.readings]
        return LeftOut(sensors, self._left_out_of)

    def _left_out_of(self, variable: Variable) -> PointMixture:
        every = self._model.sensors
        sensor = next(each for each in every if each.reading.cpd.child == variable)
        return without_each(self._model, sensor, self._clouds)

    def joint(self, *variables: Variable) -> ParticleBelief:
        """The joint belief of variables at one step; of a smoother, also of several steps.

        Parameters
        ----------
        *variables : Variable
            ``x, m``, of all steps, or at steps, ``x.at(3), x.at(4)``.

        Returns
        -------
        ParticleBelief
            The joint belief, with the variables in the order given.

        Raises
        ------
        EvidenceError
            If a variable is no hidden variable of the network, none is named, some are at a step
            and some over time, a hidden control is at step 0, or the variables are of several
            steps, which a filter or a fixed-lag smoother has not drawn together.
        ModelError
            If a variable stands after the last step, or is named twice.
        """
        if not variables:
            raise EvidenceError("joint takes variables of the network, like x.at(3), m.at(3)")
        scope = as_scope(variables, "a joint")
        for variable in scope:
            if variable.template not in self._model.places or variable.lag:
                raise EvidenceError(
                    f"{variable!r} is no hidden variable of the network; those are "
                    f"{listed(self._model.places)}",
                    variable=variable,
                )
        runs = self.log_evidence.shape
        each = [require_step(variable, self.graph.steps) for variable in scope]
        firsts = [self._model.places[variable.template].start for variable in scope]
        controls = any(variable.template in self.graph.model.controls for variable in scope)
        if set(each) == {None}:
            first = 1 if controls else 0
            found = parts(list(zip(scope, firsts, strict=True)))
            steps = np.arange(first, len(self._clouds))
            return ParticleBelief(found, self._clouds[first:], runs, steps)
        if None in each:
            raise EvidenceError(
                f"a joint is of variables at steps, or of all over time, not of {listed(scope)}"
            )
        for variable, step in zip(scope, each, strict=True):
            if step == 0 and variable.template in self.graph.model.controls:
                raise EvidenceError(
                    f"{variable!r}: controls begin at step 1", variable=variable, step=0
                )
        if len(set(each)) == 1:
            found = parts(list(zip(scope, firsts, strict=True)))
            return ParticleBelief(found, [self._clouds[each[0] or 0]], runs)
        if self.kind.name != "smoothed":
            raise EvidenceError(
                f"{self.kind} particles of several steps were not drawn together, so that they "
                f"have no joint of {listed(scope)}; a smoother's have",
                variable=scope[0],
            )
        states, places, end = [], [], 0
        for variable, step in zip(scope, each, strict=True):
            states.append(self._clouds[step or 0].states[self._model.places[variable.template]])
            places.append((variable, end))
            end += variable.dimension
        first_cloud = self._clouds[0]
        cloud = Cloud(np.concatenate(states), first_cloud.log_weights, first_cloud.starts)
        return ParticleBelief(parts(places), [cloud], runs)

    @property
    def _title(self) -> str:
        runs = self.log_evidence.shape
        which = f", runs {runs}" if runs else ""
        return (
            f"Posterior({self.kind}, over {list(self._model.places)}, {self.particles.n:,} "
            f"particles, {self.graph.steps + 1} steps{which})"
        )

    def _summary(self) -> Summary:
        runs, last = self.log_evidence.shape, self.graph.steps
        return over_time(self._title, self, tuple(self._model.places), runs, last)
