"""What filters and smoothers on a grid return: the states' beliefs and the log-evidence.

Point masses are the centres of a grid's cells, or particles; posteriors by either have one base
class, which stands here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from pgm.compile import DynamicGraph
from pgm.display import NoArray, Shown, Summary, Viewed
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence
from pgm.factors.scope import Scope, as_scope, listed
from pgm.inference.associations import Found
from pgm.inference.belief_kind import FILTERED, Kind
from pgm.inference.grid.associations import associations
from pgm.inference.grid.belief import GridBelief, PointMassBelief, require_step, scope_axes
from pgm.inference.grid.lattice import Lattice
from pgm.inference.grid.status import GridStatus
from pgm.inference.grid.value import Grid
from pgm.inference.labelled import Labelled
from pgm.inference.posterior import require_variable
from pgm.inference.summaries import over_time
from pgm.kernels.arrays import Array
from pgm.variables import Variable

Belief = TypeVar("Belief", bound=PointMassBelief)


class PointPosterior(Labelled, Viewed, Shown, NoArray, Generic[Belief]):
    """Base of posteriors over time by point masses: cells of a grid, or particles.

    They cannot be iterated over (`__iter__` is None). `_arrays` has words for the error that says,
    where a posterior is taken for an array, which arrays to take.
    """

    # Python would else iterate by asking for the variables 0, 1, ...
    __iter__: ClassVar[None] = None

    _arrays: ClassVar[str] = ".mean and .cov by variable, posterior[x].mean"

    def __getitem__(self, variable: Variable) -> Belief:
        """The marginal of a state, or of a hidden control that was drawn.

        Parameters
        ----------
        variable : Variable
            ``x``, of all steps, or ``x.at(3)``.

        Returns
        -------
        GridBelief or ParticleBelief
            Leading axes (*runs, T+1) of a state over time, (*runs, T) of a hidden control,
            (*runs) at a step.

        Raises
        ------
        EvidenceError
            If the posterior has no beliefs over the variable.
        ModelError
            If the variable stands after the last step.
        """
        return self.joint(require_variable(variable))

    def joint(self, *variables: Variable) -> Belief:
        """The joint belief of some variables, of all steps or at given ones, in the order given."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False, repr=False)
class GridPosterior(PointPosterior[GridBelief]):
    """The beliefs of a dynamic network's states on a grid.

    Attributes
    ----------
    graph : DynamicGraph
        The compiled network.
    grid : Grid
        The grid at the resolution that was used: the finest, if the user's grid was refined.
    kind : Kind
        Filtered, fixed-lag or smoothed.
    log_evidence : ndarray
        (*runs): ln p(measurements), of the point masses; the probability that has left the bounds
        is missing.
    status : GridStatus
        The figures by which to judge the posterior: losses at the bounds, cells too wide.
    filtered : GridPosterior
        The posterior with the beliefs of the forward sweep; of a filter, the posterior itself.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> grid = pgm.Grid({"x": (-8.0, 8.0, 160)})
    >>> posterior = pgm.smooth(walk, {z: [[4.0]]}, belief=grid)
    >>> posterior[x].mean.ravel().round(2)
    array([1., 2.])
    >>> posterior[x.at(1)].std.round(2)
    array([1.])
    >>> posterior.joint(x.at(1)).mean.round(2)
    array([2.])
    """

    graph: DynamicGraph
    grid: Grid
    kind: Kind
    log_evidence: Array
    status: GridStatus
    _lattice: Lattice
    _bound: BoundEvidence
    _values: npt.NDArray[Any]
    _filtered: npt.NDArray[Any] | None = None

    def __post_init__(self) -> None:
        self.log_evidence.flags.writeable = False

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
        values = self._values.reshape(-1, *self._values.shape[self.log_evidence.ndim :])
        return associations(self._lattice, self._bound, values)

    @property
    def filtered(self) -> GridPosterior:
        """The posterior with the filtered beliefs; of a filter, the posterior itself."""
        if self._filtered is None:
            return self
        return replace(self, kind=FILTERED, _values=self._filtered, _filtered=None)

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

    @property
    def _title(self) -> str:
        over: Scope = self._lattice.states
        runs = self.log_evidence.shape
        which = f", runs {runs}" if runs else ""
        return (
            f"GridPosterior({self.kind}, over {list(over)}, {self._lattice.size:,} cells, "
            f"{self.graph.steps + 1} steps{which})"
        )

    def _summary(self) -> Summary:
        runs, last = self.log_evidence.shape, self.graph.steps
        return over_time(self._title, self, self._lattice.states, runs, last)
