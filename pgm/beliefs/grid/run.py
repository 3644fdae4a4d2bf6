"""Running a schedule on a grid, on finer cells where the user asks for it.

The user asks by `Grid.refine`, a *figure* that is to settle as cells are halved: the log-evidence,
or a function of the posterior. It has settled where it changes by no more than `Grid.tolerance`.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np

from pgm.beliefs.grid.figures import GridFigures, Refinement
from pgm.beliefs.grid.lattice import resolve
from pgm.beliefs.grid.outcome import GridOutcome
from pgm.beliefs.grid.room import require_room
from pgm.beliefs.grid.settings import GridSettings
from pgm.beliefs.grid.slices import GridModel, GridSlices, Worst
from pgm.beliefs.markov.chain import StateChain
from pgm.compile import DynamicGraph
from pgm.errors import ModelError
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import Array
from pgm.posteriors.belief_kind import SMOOTHED, Kind
from pgm.posteriors.posterior import Posterior
from pgm.posteriors.status import Status
from pgm.progress import counted
from pgm.schedules.schedule import Schedule, kind_of


def run(
    graph: DynamicGraph, bound: BoundEvidence, schedule: Schedule | None, grid: GridSettings
) -> GridOutcome:
    """The posterior on a grid, given the evidence `bound`.

    The schedule says whether to filter or to smooth, and with what lag; None smooths. A
    `GridWarning` is given for each fault that the status shows.
    """
    kind = kind_of(schedule, "beliefs on a grid")
    found = _refined(graph, bound, kind, grid)
    found.figures.warn()
    return found


def _refined(
    graph: DynamicGraph, bound: BoundEvidence, kind: Kind, grid: GridSettings
) -> GridOutcome:
    """The posterior on the first lattice on which the user's figure has settled.

    The number of cells along each axis is doubled until the figure has settled, or as often as
    `Grid.doublings` allows; the status has a record of each resolution. Without `refine` it is the
    posterior on the grid as it is. A figure whose shape differs from resolution to resolution is
    refused by a ModelError.
    """
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
    figures = found.figures.refined(record, settled)
    lead = found.log_evidence.shape
    return replace(found, status=Status.of_figures(figures, lead, bool(figures.converged)))


def _figure(grid: GridSettings, found: GridOutcome) -> Array:
    """The figure that is to settle: the log-evidence, or the user's function of the posterior.

    A function that fails, or has values that are not finite, is refused by a ModelError.
    """
    if not callable(grid.refine):
        return found.log_evidence
    try:
        figure = np.asarray(grid.refine(Posterior(found)), dtype=np.float64)
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


def _at(graph: DynamicGraph, bound: BoundEvidence, kind: Kind, grid: GridSettings) -> GridOutcome:
    """The posterior on the lattice of a grid, without refinement.

    Runs are filtered one after another, and smoothed if `kind` is smoothed or of a fixed lag.
    """
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
    figures = GridFigures(
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
    status = Status.of_figures(figures, lead, bool(figures.converged))
    return GridOutcome(graph, grid, kind, log_evidence, status, lattice, bound, *values)


class _Kept(StateChain):
    """The forward and backward messages of one run, whose filtered beliefs go into a given array.

    slices: The time slices of the run, as the chain of states that messages are sent along.
    made: The array for the filtered beliefs, (T+1, *cells).
    """

    def __init__(self, slices: GridSlices, made: Any) -> None:
        super().__init__(slices, dtype=made.dtype.type)
        self._made: Array = made

    def room(self, like: Array) -> Array:
        """The array for the beliefs of all steps, (T+1, *cells): the one that was given.

        `like`, a belief whose shape a new array would have, is not used.
        """
        return self._made
