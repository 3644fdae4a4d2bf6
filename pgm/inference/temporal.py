"""Running a schedule on a dynamic network, with the family of beliefs that it takes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from pgm.compile import DynamicGraph
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence
from pgm.inference.associations import by_density
from pgm.inference.chain.marginals import KeptPosterior
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.grid.online import OnlineGrid
from pgm.inference.grid.posterior import GridPosterior
from pgm.inference.grid.posterior import run as run_grid
from pgm.inference.grid.value import Grid
from pgm.inference.markov.posterior import StatePosterior
from pgm.inference.markov.run import run as run_tables
from pgm.inference.options import Start
from pgm.inference.particles.online import OnlineParticles
from pgm.inference.particles.posterior import ParticlePosterior
from pgm.inference.particles.posterior import run as run_particles
from pgm.inference.particles.value import Particles
from pgm.inference.parts.run import Keep
from pgm.inference.parts.run import run as run_moments
from pgm.inference.schedule import ONCE, Schedule
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork

if TYPE_CHECKING:
    from concurrent.futures import Executor

PointMasses = Grid | Particles


def online_points(
    belief: PointMasses,
    model: Any,
    lineariser: Any = TAYLOR,
    schedule: Any = None,
    lag: int | None = None,
) -> OnlineGrid | OnlineParticles:
    """The online filter of such beliefs, where nothing is asked for that it has no use of."""
    require_points(belief, model)
    asked = None if schedule == ONCE else schedule
    require_no_others(belief, lineariser, schedule=asked, lag=lag)
    if isinstance(belief, Grid):
        return OnlineGrid(model, belief)
    return OnlineParticles(model, belief)


def require_points(belief: Any, model: Any) -> None:
    """Refuse a belief that is neither grid nor particles, and a network that has neither."""
    if not isinstance(belief, Grid | Particles):
        raise ModelError(f"belief= is a pgm.Grid(...) or pgm.Particles(...), not {titled(belief)}")
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"a dynamic network was due, not {titled(model)}")
    if model.discrete:
        raise ModelError(
            "a network of tables has the probabilities of its states, exactly: leave belief= out"
        )


def require_no_others(belief: PointMasses, lineariser: Any, **given: Any) -> None:
    """Refuse arguments that beliefs as Gaussians take, and point masses have no use of."""
    named = [name for name, value in given.items() if value is not None]
    if lineariser is not TAYLOR and lineariser != TAYLOR:
        named.insert(0, "lineariser")
    if named and isinstance(belief, Grid):
        raise ModelError(
            f"{named[0]}= is for beliefs that are Gaussian; a grid linearises nothing, has no lag "
            "online, and works one run after another: leave it out"
        )
    if named:
        raise ModelError(
            f"{named[0]}= is for beliefs that are Gaussian; particles linearise nothing, are of "
            "all runs at once, and have no lag online: leave it out"
        )


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
