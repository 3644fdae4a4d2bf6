"""Classes of the version before that are one class now, under their names: each with a note.

Grids, particles and tables had posteriors, statuses and online filters of their own, which programs
told apart by ``isinstance``. The classes here stand for those, and ``isinstance`` still does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from warnings import warn

from pgm.beliefs.grid.family import Grid
from pgm.beliefs.grid.figures import GridFigures
from pgm.beliefs.grid.online import OnlineGridBelief
from pgm.beliefs.grid.outcome import GridOutcome
from pgm.beliefs.markov.outcome import StateOutcome
from pgm.beliefs.moments.outcomes.kept_outcome import KeptOutcome
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.own.family import BeliefFamily
from pgm.beliefs.particles.family import Particles
from pgm.beliefs.particles.figures import ParticleFigures
from pgm.beliefs.particles.online import OnlineParticleBelief
from pgm.beliefs.particles.outcome import ParticleOutcome
from pgm.inference.online import OnlineFilter
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.posterior import Posterior
from pgm.posteriors.status import Status


def _part(name: str, whole: type, among: Callable[[Any], bool], **more: Any) -> Any:
    """A class of that name whose instances are those values of the whole that are `among` it."""

    class Part(type(whole)):  # type: ignore[misc]
        def __instancecheck__(cls, value: Any) -> bool:
            # A subclass of a user's own has the instances that are made of it.
            if cls is not found:
                return bool(super().__instancecheck__(value))
            return isinstance(value, whole) and among(value)

    found = Part(name, (whole,), {"__module__": __name__, "__doc__": whole.__doc__, **more})
    return found


def _posterior(name: str, outcome: type) -> Any:
    return _part(name, Posterior, lambda found: isinstance(found._outcome, outcome))


def _status(name: str, figures: type) -> Any:
    return _part(name, Status, lambda found: isinstance(found._figures, figures))


def _online(name: str, family: type) -> Any:
    def __init__(self: Any, model: DynamicBayesianNetwork, belief: BeliefFamily[Any]) -> None:
        OnlineFilter.__init__(self, model, belief=belief)

    return _part(
        name, OnlineFilter, lambda found: isinstance(found.belief, family), __init__=__init__
    )


# Here by name, too, as the filters are pickled.
OnlineGrid = _online("OnlineGrid", Grid)
OnlineParticles = _online("OnlineParticles", Particles)

# By name the class, and what stands for it now: with how those of a family are told from others.
_ONE = "is pgm.results.Posterior now, as every posterior; ask"
_FIGURES = "is pgm.results.Status now, as every status; ask"
_BELIEF = "is pgm.results.OnlineBelief now, as every belief online; ask"
_FILTER = "is pgm.OnlineFilter now, with the belief by name:"
OLD: dict[str, tuple[Any, str]] = {
    "ChainPosterior": (
        _posterior("ChainPosterior", ChainOutcome),
        f"{_ONE} for posterior.kind, which is None without time, and of what posterior[x] is",
    ),
    "GridPosterior": (
        _posterior("GridPosterior", GridOutcome),
        f'{_ONE} whether posterior.log_evidence_kind == "grid"',
    ),
    "KeptPosterior": (
        _posterior("KeptPosterior", KeptOutcome),
        f'{_ONE} whether hasattr(posterior, "predicted"), which one of keep= has not',
    ),
    "ParticlePosterior": (
        _posterior("ParticlePosterior", ParticleOutcome),
        f'{_ONE} whether posterior.log_evidence_kind == "particles"',
    ),
    "StatePosterior": (
        _posterior("StatePosterior", StateOutcome),
        f"{_ONE} whether isinstance(posterior[x], pgm.Table)",
    ),
    "GridStatus": (
        _status("GridStatus", GridFigures),
        f'{_FIGURES} whether "outside" in status.numbers',
    ),
    "ParticleStatus": (
        _status("ParticleStatus", ParticleFigures),
        f'{_FIGURES} whether "effective" in status.numbers',
    ),
    "OnlineGridBelief": (
        OnlineGridBelief,
        f"{_BELIEF} whether isinstance(belief[x], pgm.results.GridBelief)",
    ),
    "OnlineParticleBelief": (
        OnlineParticleBelief,
        f"{_BELIEF} whether isinstance(belief[x], pgm.results.ParticleBelief)",
    ),
    "OnlineGrid": (OnlineGrid, f"{_FILTER} pgm.OnlineFilter(model, belief=grid)"),
    "OnlineParticles": (OnlineParticles, f"{_FILTER} pgm.OnlineFilter(model, belief=particles)"),
}


def old(package: str, name: str) -> Any:
    """The class of an old name, with a DeprecationWarning to the caller of a ``__getattr__``.

    Any other name is an AttributeError of the package.
    """
    if name not in OLD:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    found, told = OLD[name]
    warn(f"{package}.{name} {told}", DeprecationWarning, stacklevel=3)
    return found


def __getattr__(name: str) -> Any:
    """The classes by name, by which they are pickled."""
    if name in OLD:
        return OLD[name][0]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
