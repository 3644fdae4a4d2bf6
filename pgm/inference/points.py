"""Beliefs as point masses, on a grid or drawn: which networks have them, and what they take."""

from __future__ import annotations

from typing import Any

from pgm.display import titled
from pgm.errors import ModelError
from pgm.inference.grid.online import OnlineGrid
from pgm.inference.grid.value import Grid
from pgm.inference.particles.online import OnlineParticles
from pgm.inference.particles.value import Particles
from pgm.inference.schedule import ONCE
from pgm.linearisers import TAYLOR
from pgm.networks import DynamicBayesianNetwork

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
