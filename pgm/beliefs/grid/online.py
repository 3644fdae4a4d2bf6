"""Filtering on a grid in a robot's loop, one step at a time.

A call of `predict` or `update` has its evidence in `bound`, with arrays for all
runs. The work on one run is done by its `GridSlices`, which has the run's prior, motion and
measurements. Weights of measurements are densities divided by e^s, s being their log-scale.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from pgm.beliefs.grid.belief import GridBelief, scope_axes
from pgm.beliefs.grid.cloud import cloud_of
from pgm.beliefs.grid.cut_off import Tails
from pgm.beliefs.grid.figures import GridFigures
from pgm.beliefs.grid.lattice import Lattice, resolve
from pgm.beliefs.grid.room import require_room
from pgm.beliefs.grid.settings import GridSettings
from pgm.beliefs.grid.slices import GridModel, GridSlices, Tested, Worst
from pgm.beliefs.points.filter import PointFilter
from pgm.beliefs.points.measurements import online
from pgm.beliefs.points.model import ParticleModel
from pgm.beliefs.points.point_mixture import PointMixture
from pgm.display import Summary
from pgm.errors import EvidenceError, ModelError
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
class OnlineGridBelief(OnlineBelief):
    """The belief of an online filter at one step, on a grid.

    It holds no past steps: `behind`, where the beliefs of a filter with a lag have theirs, is None.

    Attributes
    ----------
    step : int
        The time step that the belief is of.
    log_evidence : ndarray
        (*runs): ln p of all measurements so far.
    status : Status
        The status of all steps so far.
    kind : Kind
        Filtered after an update, predicted before.

    Examples
    --------
    >>> from pgm.examples import walk, x
    >>> belief = pgm.OnlineFilter(walk, belief=pgm.Grid({"x": (-8.0, 8.0, 160)})).initial()
    >>> belief[x].std.round(2), str(belief.kind)
    (array([1.]), 'predicted')
    """

    step: int
    log_evidence: Array
    status: Status
    kind: Kind
    _lattice: Lattice
    _model: DynamicBayesianNetwork
    _values: npt.NDArray[Any]
    _tails: tuple[Tails, ...]  # run by run
    beliefs: ClassVar[str] = "beliefs on a grid"
    # Online beliefs with a lag hold past steps here; beliefs on a grid hold none.
    behind: ClassVar[None] = None

    @property
    def figures(self) -> GridFigures:
        """The figures by which to judge the belief, of all steps so far."""
        found = self.status._figures
        assert isinstance(found, GridFigures)
        return found

    def __post_init__(self) -> None:
        self._values.flags.writeable = self.log_evidence.flags.writeable = False

    @property
    def lead(self) -> tuple[int, ...]:
        """The shape of the axes of runs."""
        return self.log_evidence.shape

    def __getitem__(self, variable: Variable) -> GridBelief:
        """The marginal of a state at the belief's step, with leading axes of runs.

        Raises
        ------
        EvidenceError
            If it is no state of the network, or of another step.
        """
        lattice, template = self._lattice, require_variable(variable).template
        if template not in lattice.states or variable.step not in (None, self.step):
            raise EvidenceError(
                f"the belief at step {self.step} is over {list(lattice.states)}, not {variable!r}"
                f"{namesake(variable, lattice.states)}",
                variable=variable,
                step=self.step,
            )
        places = scope_axes(lattice.axes, (template,))
        return GridBelief(lattice.axes, self._values)._over(places)

    def _measurement(
        self, variable: Variable, given: Mapping[Variable, Any]
    ) -> GridBelief | PointMixture:
        if variable in self._lattice.states:
            return self[variable]
        require_parents(self._model, variable, given, self.step)
        bound, alone = step_evidence.unread(self._model, self, variable, given)
        bound = step_evidence.at_step(bound, self.step)
        model = ParticleModel(self._model, bound, np.float64, self.step)
        runs = _broadcast(np.arange(len(self._tails)), self.lead, bound)
        values = self._values.reshape(-1, *self._lattice.shape)[runs]
        return online(model, cloud_of(self._lattice, values), variable, alone=alone)

    @property
    def _title(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        return f"OnlineBelief({self.kind}, step {self.step}, {self._lattice.size:,} cells{runs})"

    def _summary(self) -> Summary:
        return at_a_step(self._title, self, self._lattice.states, self.lead)


Kept = TypeVar("Kept", np.float64, np.intp)


class GridSteps(PointFilter[OnlineGridBelief]):
    """A filter on a grid for one step at a time; made by ``OnlineFilter(model, belief=grid)``.

    Runs are worked through one at a time.

    Parameters
    ----------
    model : DynamicBayesianNetwork
        A model of continuous CPDs.
    belief : GridSettings
        The grid; it must not ask for `refine`, which runs again over recorded evidence.

    Raises
    ------
    ModelError
        If the grid has `refine`, does not give cells to exactly the components of the states, or
        has beliefs that would not fit in memory.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> robot = pgm.OnlineFilter(walk, belief=pgm.Grid({"x": (-8.0, 8.0, 160)}))
    >>> belief = robot.predict(robot.initial())
    >>> belief = robot.update(belief, {z: [4.0]})
    >>> belief[x].mean.round(2)
    array([2.])
    """

    belief: GridSettings

    def __init__(self, model: DynamicBayesianNetwork, belief: GridSettings) -> None:
        if belief.refine is not None:
            raise ModelError(
                f"{belief!r} asks for refine=, which runs again over recorded evidence: find the "
                "resolution with pgm.filter, and give the grid without it online"
            )
        self._set(model=model, belief=belief)
        require_room(self._lattice, belief, 1, int(np.prod(model.lead)), 1)

    @cached_property
    def _lattice(self) -> Lattice:
        return resolve(self.belief, self.model.states)

    @cached_property
    def _tested(self) -> Tested:
        return Tested.nothing()

    def initial(self) -> OnlineGridBelief:
        """The prior belief, at step 0, with the model's leading axes of runs."""
        lead = self.model.lead
        bound = BoundEvidence(0, lead, (), ())
        found = self._each(bound, 0, None, lambda slices, _: (slices.prior(), 0.0))
        return self._belief(0, PREDICTED, bound, None, found)

    def _predicted(self, belief: OnlineGridBelief, bound: BoundEvidence) -> OnlineGridBelief:
        step = belief.step + 1
        found = self._each(
            bound, belief.step, belief, lambda slices, values: (slices.forward(step, values), 0.0)
        )
        return self._belief(step, PREDICTED, bound, belief, found)

    def _updated(self, belief: OnlineGridBelief, bound: BoundEvidence) -> OnlineGridBelief:
        step = belief.step
        left = _broadcast(belief.status.outside_by_step[..., -1], belief.lead, bound)

        def taken(slices: GridSlices, values: Array) -> tuple[Array, float]:
            """A run's belief times the weights of the step's measurements, and the log-scale.

            `values` is the predicted belief, (*cells), and `slices` has the run's measurements. The
            log-scale is that of the weights.
            """
            slices.begin(step, values, float(left[slices.run]))
            weights, scale = slices.likelihood(step)
            joint = values if weights is None else values * weights
            slices.look(step, joint)
            return joint, scale

        return self._belief(step, FILTERED, bound, belief, self._each(bound, step, belief, taken))

    def _owns(self, belief: Any) -> bool:
        mine = isinstance(belief, OnlineGridBelief) and belief._model is self.model
        return mine and belief._lattice.like(self._lattice)

    def _each(
        self,
        bound: BoundEvidence,
        first: int,
        before: OnlineGridBelief | None,
        work: Callable[[GridSlices, Array], tuple[Array, float]],
    ) -> list[tuple[GridSlices, Array, float]]:
        """Do some work in each run: a list of (`GridSlices`, belief afterwards, log-density).

        first: The step at which the work is done; for a prediction the step before.
        before: The belief to go on from, whose runs broadcast to the evidence's; None for the
            prior.
        work: A function of a run's slices and its belief (*cells), an empty array if `before` is
            None. It returns probabilities (*cells) that need not sum to one, and a log-scale.

        The belief in the list is these probabilities (*cells), normalised; the log-density is the
        logarithm of their sum, plus the log-scale. A sum of zero is refused by an EvidenceError.
        """
        model = GridModel(self._lattice, self.model, bound, self._tested, first)
        shape = self._lattice.shape
        sources = np.zeros(bound.runs, dtype=int)
        if before is not None:
            sources = _broadcast(np.arange(len(before._tails)), before.lead, bound)
        found = []
        for run, source in enumerate(sources):
            slices, values = GridSlices(model, run), np.zeros(0)
            if before is not None:
                unresolved = float(before.status.unresolved.flat[source]) ** 2
                slices = GridSlices(model, run, None, before._tails[source], unresolved)
                values = before._values.reshape(-1, *shape)[source].astype(np.float64)
            joint, scale = work(slices, values)
            total = float(joint.sum())
            if not total > 0.0:
                slices.refuse(first, joint, run)
            log_density = float(np.log(total)) + scale
            slices.surprised(first, log_density)
            found.append((slices, joint / total, log_density))
        return found

    def _belief(
        self,
        step: int,
        kind: Kind,
        bound: BoundEvidence,
        before: OnlineGridBelief | None,
        found: list[tuple[GridSlices, Array, float]],
    ) -> OnlineGridBelief:
        """The belief of all runs, with the log-evidence and the status of all steps so far.

        before: The belief at the step before, or before the update; None for the prior.
        found: For each run its slices, its belief (*cells) at the step, and the log-density of the
            measurements taken in there.
        """
        lead, lattice = bound.lead, self._lattice
        values = np.array([belief for _, belief, _ in found], dtype=self.belief.dtype)
        log_density = np.array([density for *_, density in found]).reshape(lead)
        outside = np.array([s.outside.get(step, 0.0) for s, *_ in found]).reshape(*lead, 1)
        worst = reduce(Worst.of, (s.worst for s, *_ in found))
        unresolved = np.sqrt([s.unresolved for s, *_ in found]).reshape(lead)
        added = {
            axis.label: np.array([s.added[k] * axis.width**2 for s, *_ in found]).reshape(lead)
            for k, axis in enumerate(lattice.axes)
        }
        split = {
            axis.label for k, axis in enumerate(lattice.axes) for s, *_ in found if k in s.split
        }
        if before is not None:
            split |= set(before.status.split)
            log_density = log_density + before.log_evidence
            added = {name: value + before.status.added[name] for name, value in added.items()}
            past = before.status.outside_by_step
            past = np.broadcast_to(past, (*lead, past.shape[-1]))
            outside = past.copy() if kind == FILTERED else np.concatenate([past, outside], axis=-1)
            worst = worst.of(before.figures._worst)
        figures = GridFigures(outside, added, unresolved, worst, sorted(split))
        figures.warn(None if before is None else before.figures)
        status = Status.of_figures(figures, lead)
        values = values.reshape(*lead, *lattice.shape)
        log_density = np.asarray(log_density)
        tails = tuple(slices.tails for slices, *_ in found)
        return OnlineGridBelief(step, log_density, status, kind, lattice, self.model, values, tails)


def _broadcast(
    each: npt.NDArray[Kept], lead: tuple[int, ...], bound: BoundEvidence
) -> npt.NDArray[Kept]:
    """Values of a belief's runs, broadcast to the flattened runs of the evidence, (runs,).

    `each` has one value for each of the belief's runs, flattened too; `lead` is the shape of their
    axes. A belief of one run may be followed by evidence of many.
    """
    return np.broadcast_to(each.reshape(lead), bound.lead).reshape(bound.runs)
