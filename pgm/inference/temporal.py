"""Running a schedule on a dynamic network, with the family of beliefs that it takes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from pgm.compile import DynamicGraph
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence
from pgm.inference.chain.marginals import KeptPosterior
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.grid.posterior import GridPosterior
from pgm.inference.grid.run import require_grid
from pgm.inference.grid.run import run as run_grid
from pgm.inference.grid.value import Grid
from pgm.inference.markov.posterior import StatePosterior
from pgm.inference.markov.run import run as run_tables
from pgm.inference.parts.run import Keep
from pgm.inference.parts.run import run as run_moments
from pgm.inference.schedule import Schedule
from pgm.inference.start import Start
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork

if TYPE_CHECKING:
    from concurrent.futures import Executor

TemporalPosterior = ChainPosterior | KeptPosterior | StatePosterior | GridPosterior


def runner(
    model: DynamicBayesianNetwork, belief: Grid | None = None
) -> Callable[..., TemporalPosterior]:
    """The function that sends the messages: of Gaussians' moments, tables of states, or grids."""
    if belief is not None:
        return partial(_run_grid, require_grid(belief, model))
    return _run_tables if model.discrete else run_moments


def _run_grid(
    grid: Grid,
    graph: DynamicGraph,
    bound: BoundEvidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
    keep: Keep | None,
    executor: Executor | None,
) -> GridPosterior:
    given = {"start": start, "keep": keep, "executor": executor}
    named = [name for name, value in given.items() if value is not None]
    if lineariser is not TAYLOR and lineariser != TAYLOR:
        named.append("lineariser")
    if named:
        raise ModelError(
            f"{named[0]}= is for beliefs that are Gaussian; a grid linearises nothing and works "
            "one run after another: leave it out"
        )
    return run_grid(graph, bound, schedule, grid)


def _run_tables(
    graph: DynamicGraph,
    bound: BoundEvidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
    keep: Keep | None,
    executor: Executor | None,
) -> StatePosterior:
    if start is not None:
        raise EvidenceError("a start is for nonlinear CPDs; a discrete network has none")
    given = {"keep": keep, "executor": executor}
    named = [name for name, value in given.items() if value is not None]
    if lineariser != TAYLOR:
        named.append("lineariser")
    if named:
        raise ModelError(f"{named[0]}= is for networks of Gaussian CPDs, and this one is of tables")
    return run_tables(graph, bound, schedule)
