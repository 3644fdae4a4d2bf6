"""The marginals that a user's own family of beliefs shows: moments, draws, or values of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.beliefs.own.kept import closed
from pgm.beliefs.points.cloud import Cloud
from pgm.beliefs.points.components import parts
from pgm.beliefs.points.particle_belief import ParticleBelief
from pgm.boundary import as_floats
from pgm.display import InCode
from pgm.display.shown import articled
from pgm.errors import EvidenceError, ModelError, NumericalError
from pgm.factors import Gaussian
from pgm.factors.arrays import covariance_fault, symmetrised
from pgm.factors.scope import Scope, listed
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Discrete

if TYPE_CHECKING:
    from pgm.beliefs.own.family import BeliefFamily


@dataclass(frozen=True, eq=False)
class Asked(InCode):
    """A question to a family's beliefs: the marginal of some variables, at one step or at many.

    Attributes
    ----------
    scope : tuple of Variable
    columns : ndarray
        The indices of the variables' components among the d of a slice.
    lead : tuple of int
        The user's axes of runs, which are one axis in a family's beliefs.
    steps : ndarray or None
        The numbers of the steps, one a belief; None if one step is asked for, whose marginal has no
        axis of steps.
    size : int
        The number of components of a slice, d.
    """

    scope: Scope
    columns: Integers
    lead: tuple[int, ...]
    steps: Integers | None
    size: int

    @property
    def axes(self) -> tuple[int, ...]:
        """The leading axes of the marginal: of runs, and of steps if there are several."""
        return self.lead if self.steps is None else (*self.lead, len(self.steps))

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return int(np.prod(self.lead))


def pair(family: BeliefFamily[Any], method: str, found: Any, due: str) -> tuple[Any, Any]:
    """The two results of a family's method; anything else is refused by a ModelError."""
    if isinstance(found, tuple) and len(found) == 2:
        return found
    what = f"a tuple of {len(found)}" if isinstance(found, tuple) else type(found).__name__
    raise ModelError(f"{family!r}: {method} returns {due}, not {what}")


def shown(family: BeliefFamily[Any], beliefs: Sequence[Any], asked: Asked) -> Any:
    """The marginal that is asked of a family's beliefs, the family's own values, one a step."""
    if not beliefs:  # of a hidden control, which begins at step 1, where there is no such step
        wide = len(asked.columns)
        return _gaussian(asked, np.zeros((*asked.axes, wide)), np.zeros((*asked.axes, wide, wide)))
    beliefs = [closed(belief) for belief in beliefs]
    found = family.marginal(beliefs, asked)
    if found is not None:
        return found
    each = [family.points(belief) for belief in beliefs]
    if each[0] is not None:
        return _draws(family, each, asked)
    return _moments(family, beliefs, asked)


def with_moments(family: BeliefFamily[Any], found: Any, asked: Asked) -> Any:
    """A marginal that has moments and is indexed by runs and steps, for summaries and pages.

    One of the family's own form is shown by the Gaussian of its mean and covariance. One that has
    none raises an EvidenceError.
    """
    discrete = any(isinstance(variable, Discrete) for variable in asked.scope)
    due = ("probabilities",) if discrete else ("mean", "cov")
    if not all(hasattr(found, name) for name in due):
        raise EvidenceError(
            f"{family!r} shows {listed(asked.scope)} as {articled(found)}, which has no ."
            + " and .".join(due)
        )
    if discrete or isinstance(found, Gaussian | ParticleBelief):
        return found
    whose, wide = f"{family!r}: the marginal of {listed(asked.scope)}", len(asked.columns)
    mean, cov = (as_floats(v, whose, ModelError) for v in (found.mean, found.cov))
    shapes = (*asked.axes, wide), (*asked.axes, wide, wide)
    if (mean.shape, cov.shape) != shapes:
        raise ModelError(
            f"{whose} has a mean of shape {mean.shape} and a cov of shape {cov.shape}; {shapes[0]} "
            f"and {shapes[1]} were due: runs, steps if several are asked for, components"
        )
    return _gaussian(asked, np.array(mean), _covariance(whose, mean, cov))


def _covariance(whose: str, mean: Array, cov: Array) -> Array:
    """Covariances (..., k, k), symmetric to the last digit; a NumericalError refuses others.

    It refuses means (..., k) that are not finite, too; `whose` they are, for the text.
    """
    cov = symmetrised(cov)
    fault = covariance_fault(cov)
    if fault or not np.isfinite(mean).all():
        what = f"a covariance that {fault}" if fault else "a mean that is not finite"
        raise NumericalError(f"{whose} has {what}")
    return np.array(cov)


def _gaussian(asked: Asked, mean: Array, cov: Array) -> Gaussian:
    return Gaussian._make(asked.scope, mean, cov, asked.steps)


def _moments(family: BeliefFamily[Any], beliefs: Sequence[Any], asked: Asked) -> Gaussian:
    """The Gaussian of the moments of beliefs, (*lead, steps, ...)."""
    means, covs, columns, size = [], [], asked.columns, asked.size
    for k, belief in enumerate(beliefs):
        told = pair(family, "moments(belief)", family.moments(belief), "a mean and a covariance")
        mean, cov = (as_floats(each, f"{family!r}: moments(belief)", ModelError) for each in told)
        if mean.shape != (asked.runs, size) or cov.shape != (asked.runs, size, size):
            raise ModelError(
                f"{family!r}: moments(belief) has shapes {mean.shape} and {cov.shape}; "
                f"({asked.runs}, {size}) and ({asked.runs}, {size}, {size}) were due: runs, "
                "components of a slice"
            )
        whose = f"{family!r}: moments(belief), for the {_th(k, asked.steps)},"
        cov = _covariance(whose, mean, cov)
        means.append(mean[:, columns])
        covs.append(cov[:, columns[:, None], columns])
    mean, cov, wide = np.stack(means, axis=1), np.stack(covs, axis=1), len(columns)
    return _gaussian(asked, mean.reshape(*asked.axes, wide), cov.reshape(*asked.axes, wide, wide))


def _draws(family: BeliefFamily[Any], each: Sequence[Any], asked: Asked) -> ParticleBelief:
    """The weighted draws of beliefs, over a scope's components."""
    places, end = [], 0
    for variable in asked.scope:
        places.append((variable, end))
        end += variable.dimension
    clouds = [_cloud(family, draws, asked.columns, asked.runs, asked.size) for draws in each]
    return ParticleBelief(parts(places), clouds, asked.lead, asked.steps)


def _cloud(family: BeliefFamily[Any], draws: Any, columns: Integers, runs: int, size: int) -> Cloud:
    """Draws (runs, n, d), with their log-weights (runs, n) or None, as a cloud of some rows."""
    points, log_weights = pair(family, "points(belief)", draws, "points and their log-weights")
    points = as_floats(points, f"{family!r}: the points of points(belief)", ModelError)
    if points.ndim != 3 or len(points) != runs or points.shape[2] != size:
        raise ModelError(
            f"{family!r}: points(belief) has points of shape {points.shape}; ({runs}, n, {size}) "
            "was due: runs, points, components of a slice"
        )
    count = points.shape[1]
    logs: Array = np.full((runs, count), -np.log(max(count, 1)))
    if log_weights is not None:
        logs = as_floats(log_weights, f"{family!r}: the log-weights of points(belief)", ModelError)
        if logs.shape != (runs, count):
            raise ModelError(
                f"{family!r}: points(belief) has log-weights of shape {logs.shape}; ({runs}, "
                f"{count}) was due"
            )
        with np.errstate(invalid="ignore"):  # which is refused below
            logs = logs - np.logaddexp.reduce(logs, axis=1, keepdims=True)
    if not (count and np.isfinite(points).all()) or np.isnan(logs).any():
        raise NumericalError(
            f"{family!r}: points(belief) has no points, points that are not finite, or log-weights "
            "that are NaN or infinite, or all of them minus infinity"
        )
    states = np.ascontiguousarray(points[..., columns].reshape(runs * count, -1).T)
    return Cloud(states, logs.reshape(-1), np.arange(runs + 1) * count)


def _th(k: int, steps: Integers | None) -> str:
    """The belief of a step, in words."""
    return "belief" if steps is None else f"belief of step {int(steps[k])}"
