"""The posterior of a network on a grid, and the associations of its open sightings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from pgm.compile import DynamicGraph
from pgm.cpds.mixture import UnidentifiedCPD
from pgm.display import NoArray, Shown, Summary
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence, Reading
from pgm.factors.scope import Scope, as_scope, listed
from pgm.inference.associations import Found, collected
from pgm.inference.grid.belief import GridBelief, require_step, scope_axes
from pgm.inference.grid.dependence import centres
from pgm.inference.grid.lattice import Lattice
from pgm.inference.grid.status import GridStatus
from pgm.inference.grid.value import Grid
from pgm.inference.grid.values import at_a_time, known_at
from pgm.inference.posterior import Labelled, Viewed, require_variable
from pgm.inference.status import FILTERED, Kind
from pgm.inference.summaries import over_time
from pgm.kernels.arrays import Array
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class GridPosterior(Labelled, Viewed, Shown, NoArray):
    """The beliefs of a dynamic network's states on a grid.

    Attributes
    ----------
    graph : DynamicGraph
    grid : Grid
        At the resolution that was used.
    kind : Kind
        Filtered, fixed-lag or smoothed.
    log_evidence : ndarray
        (*runs): ln p(measurements), of the point masses; what has left the bounds is missing.
    status : GridStatus
    filtered : GridPosterior
        The beliefs of the forward sweep; itself, of a filter.

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

    # Python would else iterate by asking for the variables 0, 1, ...
    __iter__: ClassVar[None] = None

    _arrays: ClassVar[str] = ".mean and .cov by variable, posterior[x].mean"

    def __post_init__(self) -> None:
        self.log_evidence.flags.writeable = False

    @property
    def _hidden(self) -> Scope:
        return self._lattice.states

    @property
    def log_evidence_kind(self) -> str:
        """``grid``: neither exact nor linearised."""
        return "grid"

    @cached_property
    def associations(self) -> Found:
        """The `Associations` by sensor, of sightings whose parent was `unknown`."""
        values = self._values.reshape(-1, *self._values.shape[self.log_evidence.ndim :])
        return associations(self._lattice, self._bound, values)

    @property
    def filtered(self) -> GridPosterior:
        """The beliefs of the forward sweep."""
        if self._filtered is None:
            return self
        return replace(self, kind=FILTERED, _values=self._filtered, _filtered=None)

    def __getitem__(self, variable: Variable) -> GridBelief:
        """The marginal of a state.

        Parameters
        ----------
        variable : Variable
            ``x``, of all steps, or ``x.at(3)``.

        Returns
        -------
        GridBelief
            Leading axes (*runs, T+1) of a state over time, (*runs) at a step.

        Raises
        ------
        EvidenceError
            If it is no state of the network.
        ModelError
            If it stands after the last step.
        """
        return self.joint(require_variable(variable))

    def joint(self, *variables: Variable) -> GridBelief:
        """The joint of some states of one slice.

        Parameters
        ----------
        *variables : Variable
            ``x, m``, or both at a step, ``x.at(3), m.at(3)``.

        Returns
        -------
        GridBelief
            In the order given.

        Raises
        ------
        EvidenceError
            If one is no state of the network, they are of several steps, or none is named.
        ModelError
            If one stands after the last step, or is named twice.
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


# Cells that are less probable than this share of the most probable one count for nothing.
_NEGLIGIBLE = 1e-12


def associations(lattice: Lattice, bound: BoundEvidence, values: npt.NDArray[Any]) -> Found:
    """The associations of all sensors, under the beliefs (runs, T + 1, *cells)."""
    every, lead = ((reading, reading.cpd) for reading in bound.readings), bound.lead
    open_ = [(reading, cpd) for reading, cpd in every if isinstance(cpd, UnidentifiedCPD)]
    return MappingProxyType(
        dict(
            collected(reading, _by_row(lattice, reading, cpd, values), len(cpd.candidates), lead)
            for reading, cpd in open_
        )
    )


def _by_row(
    lattice: Lattice, reading: Reading, cpd: UnidentifiedCPD, values: npt.NDArray[Any]
) -> Iterator[Array]:
    """The probabilities of what each sighting may be of, (runs, k + 2)."""
    for row, step in enumerate(reading.step.tolist()):
        yield np.stack(
            [_responsible(lattice, reading, cpd, row, k, v[step]) for k, v in enumerate(values)]
        )


def _responsible(
    lattice: Lattice,
    reading: Reading,
    cpd: UnidentifiedCPD,
    row: int,
    run: int,
    belief: npt.NDArray[Any],
) -> Array:
    """The probabilities of what a sighting of a run may be of, (k + 2,)."""

    def of(rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.asarray(rows[row, run if rows.shape[1] > 1 else 0])

    total = np.zeros(len(cpd.candidates) + 2)
    if not of(reading.taken).any():
        return np.full(len(total), np.nan)
    child = np.where(of(reading.taken), of(reading.values), np.nan)
    inputs = {parent: of(rows) for parent, rows in reading.inputs.items()}
    flat = np.flatnonzero(belief > _NEGLIGIBLE * belief.max())
    length, step = at_a_time(cpd), int(reading.step[row])
    for first in range(0, len(flat), length):
        some = flat[first : first + length]
        cells = np.stack(np.unravel_index(some, lattice.shape), axis=-1)
        points = lattice.values(centres(lattice, cells))
        wide, known = known_at(cpd, child, points, inputs, step)
        total += cpd.responsibilities(wide, known) @ belief.flat[some].astype(np.float64)
    total /= total.sum()
    return total
