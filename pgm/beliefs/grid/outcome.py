"""Outcomes of filters and smoothers on a grid: the states' beliefs and the log-evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from pgm.beliefs.grid.associations import associations
from pgm.beliefs.grid.belief import GridBelief, scope_axes
from pgm.beliefs.grid.cloud import CellClouds
from pgm.beliefs.grid.draws import draws
from pgm.beliefs.grid.figures import GridFigures
from pgm.beliefs.grid.lattice import Lattice
from pgm.beliefs.grid.measurements import predicted, without_each
from pgm.beliefs.grid.room import require_room
from pgm.beliefs.grid.settings import GridSettings
from pgm.beliefs.points.measurements import expected, readings_of, unread
from pgm.beliefs.points.model import ParticleModel
from pgm.beliefs.points.point_mixture import PointMixture
from pgm.compile import DynamicGraph
from pgm.display import Summary
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence, Reading
from pgm.factors.scope import Scope, as_scope, listed
from pgm.kernels.arrays import Array, Integers
from pgm.posteriors.associations import Found
from pgm.posteriors.belief_kind import FILTERED, PREDICTED, Kind, require_smoothed
from pgm.posteriors.hidden import measured, require_step
from pgm.posteriors.left_out import LeftOut, require_all
from pgm.posteriors.outcome import Outcome
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import over_time
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class GridOutcome(Outcome[GridBelief]):
    """The beliefs of a dynamic network's states on a grid.

    Attributes
    ----------
    graph : DynamicGraph
        The compiled network.
    grid : GridSettings
        The grid at the resolution that was used: the finest, if the user's grid was refined.
    kind : Kind
        Filtered, fixed-lag or smoothed.
    log_evidence : ndarray
        (*runs): ln p(measurements), of the point masses; the probability that has left the bounds
        is missing.
    status : Status
        The figures by which to judge the posterior: losses at the bounds, cells too wide.
    filtered : GridOutcome
        The posterior with the beliefs of the forward sweep; of a filter, the posterior itself.
    predicted : GridOutcome
        The posterior with the beliefs before each step's measurements.
    """

    graph: DynamicGraph
    grid: GridSettings
    kind: Kind
    log_evidence: Array
    status: Status
    _lattice: Lattice
    _bound: BoundEvidence
    _values: npt.NDArray[Any]
    _filtered: npt.NDArray[Any] | None = None

    def __post_init__(self) -> None:
        self.log_evidence.flags.writeable = False

    beliefs: ClassVar[str] = "beliefs on a grid"
    called: ClassVar[str] = "grid"
    silent: ClassVar[str] = (
        "a grid sends probabilities of cells from slice to slice, and keeps no messages"
    )

    @property
    def family(self) -> GridSettings:
        """The family of beliefs that was given: the same as `grid`."""
        return self.grid

    @property
    def readings(self) -> Sequence[Reading]:
        """The measurements, sensor by sensor."""
        return self._bound.readings

    def __getitem__(self, variable: Variable) -> Any:
        """The marginal of a state, or of a measurement not taken, at all steps or at one."""
        layout = self.graph.layout
        if measured(layout, variable) is None:
            return self.joint(variable)
        belief = expected if self.kind == PREDICTED else unread
        clouds = CellClouds(self._lattice, self._by_run(self._values))
        return belief(self._points, layout, variable, clouds)

    def _readings_of(self, variable: Variable) -> tuple[Integers, Array]:
        return readings_of(self._points, variable)

    @cached_property
    def _points(self) -> ParticleModel:
        """The network with its evidence, whose CPDs are evaluated at centres of cells."""
        return ParticleModel(self.graph.model, self._bound, np.float64)

    def _by_run(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Beliefs (*runs, T + 1, *cells) with one axis of runs."""
        return values.reshape(-1, *values.shape[self.log_evidence.ndim :])

    @property
    def figures(self) -> GridFigures:
        """The figures by which to judge the posterior: losses at the bounds, cells too wide."""
        found = self.status._figures
        assert isinstance(found, GridFigures)
        return found

    @property
    def _hidden(self) -> Scope:
        return self._lattice.states

    @property
    def log_evidence_kind(self) -> str:
        """The kind of the log-evidence, ``grid``: it is neither exact nor linearised."""
        return "grid"

    @cached_property
    def associations(self) -> Found:
        """By sensor, the `Associations` of its measurements of a parent given as `unknown`.

        They have for each such measurement the probability of each candidate, that it is spurious,
        and that it is of a new thing.
        """
        return associations(self._lattice, self._bound, self._by_run(self._values))

    @property
    def filtered(self) -> GridOutcome:
        """The posterior with the filtered beliefs; of a filter, the posterior itself."""
        if self._filtered is None:
            return self
        return replace(self, kind=FILTERED, _values=self._filtered, _filtered=None)

    @cached_property
    def predicted(self) -> GridOutcome:
        """The beliefs before each step's measurements, of these too; made when first asked for."""
        filtered = self._by_run(self.filtered._values)
        runs, steps = filtered.shape[:2]
        require_room(self._lattice, self.grid, steps, runs, 2)
        values = predicted(self._lattice, self.graph, self._bound, filtered)
        shape = self._values.shape
        known = self.filtered._values
        return replace(self, kind=PREDICTED, _values=values.reshape(shape), _filtered=known)

    @cached_property
    def left_out(self) -> LeftOut:
        """The beliefs of readings given all but their own, by sensor."""
        require_all(self.kind)
        return LeftOut([each.cpd.child for each in self.readings], self._left_out_of)

    def _left_out_of(self, variable: Variable) -> PointMixture:
        return self._each_left_out[variable]

    @cached_property
    def _each_left_out(self) -> dict[Variable, PointMixture]:
        """The beliefs of readings given all but their own, of all sensors by one pass back."""
        lattice, bound, ahead = self._lattice, self._bound, self._by_run(self.predicted._values)
        rows = sum(len(reading.step) for reading in bound.readings)
        require_room(lattice, self.grid, rows + len(ahead[0]), bound.runs, 1)
        return without_each(lattice, self.graph, bound, ahead)

    def joint(self, *variables: Variable) -> GridBelief:
        """The joint belief of some states of one slice.

        Parameters
        ----------
        *variables : Variable
            ``x, m``, of all steps, or both at a step, ``x.at(3), m.at(3)``.

        Returns
        -------
        GridBelief
            Over the components of the states, in the order given.

        Raises
        ------
        EvidenceError
            If a variable is no state of the network, if the variables are of several steps, or if
            there are none.
        ModelError
            If a variable stands after the last step, or is given twice.
        """
        if not variables:
            raise EvidenceError("joint takes states of one step, like x.at(3), m.at(3)")
        scope = as_scope(variables, "a joint")
        states = tuple(v.template for v in scope)
        for variable in scope:
            if variable.template not in self._lattice.states or variable.lag:
                raise EvidenceError(
                    f"{variable!r} is no state that the grid covers; those are "
                    f"{listed(self._lattice.states)}",
                    variable=variable,
                )
        if len({v.step for v in scope}) != 1:
            raise EvidenceError(
                f"a grid has joints of states of one step, not of {listed(scope)}",
                variable=scope[0],
            )
        step = require_step(scope[0], self.graph.steps)
        every, lattice = self._values, self._lattice
        places = scope_axes(lattice.axes, states)
        count = every.ndim - len(lattice.axes)
        steps = None if step is not None else np.arange(every.shape[count - 1])
        if step is not None:
            every = every[(slice(None),) * (count - 1) + (step,)]
        return GridBelief(lattice.axes, every, steps)._over(places)

    def sample(self, count: int, rng: np.random.Generator) -> dict[Variable, Array]:
        """So many trajectories of centres for each run: (count, *runs, steps, d) by state."""
        require_smoothed(self.kind)
        found = draws(self, count, rng)
        lead = self.log_evidence.shape
        drawn: dict[Variable, Array] = {}
        for variable, places in self._lattice.of.items():
            own = np.moveaxis(found[:, list(places)], (0, 1), (2, 3))
            drawn[variable] = own.reshape(count, *lead, *own.shape[2:])
        return drawn

    @property
    def _title(self) -> str:
        over: Scope = self._lattice.states
        runs = self.log_evidence.shape
        which = f", runs {runs}" if runs else ""
        return (
            f"Posterior({self.kind}, over {list(over)}, {self._lattice.size:,} cells, "
            f"{self.graph.steps + 1} steps{which})"
        )

    def _summary(self) -> Summary:
        runs, last = self.log_evidence.shape, self.graph.steps
        return over_time(self._title, self, self._lattice.states, runs, last)
