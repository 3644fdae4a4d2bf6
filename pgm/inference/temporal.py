"""Running a schedule on a dynamic network, with the family of beliefs that it takes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from pgm.compile import DynamicGraph
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence
from pgm.inference.associations import by_density
from pgm.inference.chain.marginals import KeptPosterior
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.grid.posterior import GridPosterior
from pgm.inference.grid.run import run as run_grid
from pgm.inference.grid.value import Grid
from pgm.inference.markov.posterior import StatePosterior
from pgm.inference.markov.run import run as run_tables
from pgm.inference.options import Start
from pgm.inference.particles.posterior import ParticlePosterior
from pgm.inference.particles.run import run as run_particles
from pgm.inference.parts.run import Keep
from pgm.inference.parts.run import run as run_moments
from pgm.inference.points import PointMasses, require_no_others, require_points
from pgm.inference.schedule import Schedule
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork

if TYPE_CHECKING:
    from concurrent.futures import Executor

PointPosterior = GridPosterior | ParticlePosterior
TemporalPosterior = ChainPosterior | KeptPosterior | StatePosterior | PointPosterior


def runner(
    model: DynamicBayesianNetwork, belief: PointMasses | None = None
) -> Callable[..., TemporalPosterior]:
    """The function that sends the messages: of Gaussians' moments, tables, grids or particles."""
    if belief is not None:
        require_points(belief, model)
        return partial(_run_points, belief)
    return _run_tables if model.discrete else run_moments


def _run_points(
    belief: PointMasses,
    graph: DynamicGraph,
    bound: BoundEvidence,
    schedule: Schedule | None,
    lineariser: Lineariser,
    start: Start | None,
    keep: Keep | None,
    executor: Executor | None,
) -> PointPosterior:
    require_no_others(belief, lineariser, start=start, keep=keep, executor=executor)
    bound = by_density(bound)
    if isinstance(belief, Grid):
        return run_grid(graph, bound, schedule, belief)
    return run_particles(graph, bound, schedule, belief)


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
