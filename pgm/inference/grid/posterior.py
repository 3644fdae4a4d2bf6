"""The posterior of a network on a grid: the runs that make it, on finer cells where asked for."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from pgm.compile import DynamicGraph
from pgm.cpds.mixture import UnidentifiedCPD
from pgm.display import NoArray, Shown, Summary
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence, Reading
from pgm.factors.scope import Scope, as_scope, listed
from pgm.inference.associations import Found, collected
from pgm.inference.grid.belief import GridBelief, PointMassBelief, require_step, scope_axes
from pgm.inference.grid.dependence import centres
from pgm.inference.grid.lattice import Lattice, resolve
from pgm.inference.grid.slices import GridModel, GridSlices, Worst
from pgm.inference.grid.status import GridStatus, Refinement
from pgm.inference.grid.value import Grid
from pgm.inference.grid.values import at_a_time, known_at
from pgm.inference.markov.chain import StateChain, kind_of, require_chain
from pgm.inference.posterior import Labelled, Viewed, require_variable
from pgm.inference.schedule import Schedule
from pgm.inference.status import FILTERED, SMOOTHED, Kind
from pgm.inference.summaries import over_time
from pgm.kernels.arrays import Array
from pgm.progress import counted
from pgm.resources import NUMBER, gibibytes, require_memory
from pgm.variables import Variable

Belief = TypeVar("Belief", bound=PointMassBelief)


class PointPosterior(Labelled, Viewed, Shown, NoArray, Generic[Belief]):
    """Base of posteriors over time whose beliefs are point masses."""

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
            If it is no hidden variable of the network that beliefs are over.
        ModelError
            If it stands after the last step.
        """
        return self.joint(require_variable(variable))

    def joint(self, *variables: Variable) -> Belief:
        """The joint of some variables."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False, repr=False)
class GridPosterior(PointPosterior[GridBelief]):
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


# Arrays of one belief's size that a step works with.
_WORK = 12


def run(
    graph: DynamicGraph, bound: BoundEvidence, schedule: Schedule | None, grid: Grid
) -> GridPosterior:
    """Send the messages of a schedule on a grid, and warn of what its status tells."""
    require_chain(graph, "beliefs on a grid")
    kind = kind_of(schedule, "beliefs on a grid")
    found = _refined(graph, bound, kind, grid)
    found.status.warn()
    return found


def _refined(graph: DynamicGraph, bound: BoundEvidence, kind: Kind, grid: Grid) -> GridPosterior:
    if grid.refine is None:
        return _at(graph, bound, kind, grid)
    record = list[Refinement]()
    used = grid
    for doubling in range(grid.doublings + 1):
        began = time.perf_counter()
        found = _at(graph, bound, kind, used)
        seconds = time.perf_counter() - began
        figure = _figure(grid, found)
        change = np.nan
        if record:
            if figure.shape != record[-1].figure.shape:
                raise ModelError(
                    f"the figure of refine= has shape {figure.shape} at {found._lattice.shape} "
                    f"cells, {record[-1].figure.shape} before; give one that does not depend on "
                    "the number of cells, such as a mean"
                )
            change = float(np.abs(figure - record[-1].figure).max(initial=0.0))
        cells = tuple(axis.cells for axis in found._lattice.axes)
        record.append(Refinement(cells, figure, change, seconds))
        settled = change <= grid.tolerance
        if settled or doubling == grid.doublings:
            break
        used = used.finer()
    return replace(found, status=found.status.refined(record, settled))


def _figure(grid: Grid, found: GridPosterior) -> Array:
    if not callable(grid.refine):
        return found.log_evidence
    try:
        figure = np.asarray(grid.refine(found), dtype=np.float64)
    except Exception as error:
        raise ModelError(
            f"the function of refine= failed on {found!r}: {type(error).__name__}: {error}"
        ) from error
    if not np.isfinite(figure).all():
        raise ModelError(
            "the function of refine= has values that are NaN or infinite; give a figure that can "
            "settle"
        )
    return figure


def _at(graph: DynamicGraph, bound: BoundEvidence, kind: Kind, grid: Grid) -> GridPosterior:
    lattice = resolve(grid, graph.model.states)
    smoothing = kind.lag > 0
    require_room(lattice, grid, bound.steps + 1, bound.runs, 3 if smoothing else 1)
    model = GridModel(lattice, graph.model, bound)
    shape = (bound.runs, bound.steps + 1, *lattice.shape)
    filtered = np.zeros(shape, dtype=grid.dtype)
    smoothed = np.zeros(shape, dtype=grid.dtype) if smoothing else None
    log_evidence, outside = np.zeros(bound.runs), np.zeros((bound.runs, bound.steps + 1))
    unresolved = np.zeros(bound.runs)
    added = np.zeros((bound.runs, len(lattice.axes)))
    worst, split = Worst(), frozenset[int]()
    for k in counted(range(bound.runs), "runs"):
        slices = GridSlices(model, k, grid.dtype if smoothing else None)
        chain = _Kept(slices, filtered[k]).run()
        slices.look(bound.steps, filtered[k, -1])
        for step, log_density in enumerate(chain.log_density.tolist()):
            slices.surprised(step, log_density)
        if smoothed is not None:
            every = chain.smoothed() if kind == SMOOTHED else chain.lagged(int(kind.lag))
            for step, belief in every:
                smoothed[k, step] = belief
        log_evidence[k] = float(chain.log_density.sum())
        outside[k] = [slices.outside[step] for step in range(bound.steps + 1)]
        added[k] = slices.added
        unresolved[k] = math.sqrt(slices.unresolved)
        worst = worst.of(slices.worst)
        split |= slices.split
    lead = bound.lead
    status = GridStatus(
        outside.reshape(*lead, -1),
        {
            axis.label: (added[:, k] * axis.width**2).reshape(lead)
            for k, axis in enumerate(lattice.axes)
        },
        unresolved.reshape(lead),
        worst,
        tuple(axis.label for k, axis in enumerate(lattice.axes) if k in split),
    )
    filtered = filtered.reshape(*lead, *shape[1:])
    values = (filtered,) if smoothed is None else (smoothed.reshape(filtered.shape), filtered)
    log_evidence = log_evidence.reshape(lead)
    return GridPosterior(graph, grid, kind, log_evidence, status, lattice, bound, *values)


class _Kept(StateChain):
    def __init__(self, slices: GridSlices, made: Any) -> None:
        super().__init__(slices, dtype=made.dtype.type)
        self._made: Array = made

    def room(self, like: Array) -> Array:
        return self._made


def require_room(lattice: Lattice, grid: Grid, steps: int, runs: int, sets: int) -> None:
    """Refuse a grid whose beliefs would not fit memory, before any is made."""
    share = np.dtype(grid.dtype).itemsize / NUMBER
    kept = int(sets * steps * runs * lattice.size * share)
    cells = " × ".join(str(axis.cells) for axis in lattice.axes)
    over = f"{steps} steps" + (f" of {runs} runs" if runs > 1 else "")
    narrower = "" if grid.dtype == np.float32 else ", or dtype=np.float32"
    require_memory(
        kept + _WORK * lattice.size,
        f"the beliefs of {cells} = {lattice.size:,} cells ({gibibytes(lattice.size)} each) at "
        f"{over}",
        f"take wider cells or closer bounds, fewer steps or runs to a call{narrower}",
    )
