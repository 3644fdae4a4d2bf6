"""The marginals that a user's own family of beliefs shows: moments, draws, or values of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pgm.boundary import as_floats
from pgm.errors import ModelError, NumericalError
from pgm.factors import Gaussian
from pgm.factors.scope import Scope
from pgm.inference.particles.belief import ParticleBelief
from pgm.inference.particles.cloud import Cloud
from pgm.inference.particles.components import parts
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.inference.belief_family import BeliefFamily
    from pgm.inference.outcome import Outcome


class OverTime(NamedTuple):
    """Marginals of one kind, such as those predicted, by variable: ``marginals[x]``."""

    outcome: Outcome[Any]

    def __getitem__(self, variable: Variable) -> Any:  # type: ignore[override]
        """The marginal of a hidden variable, at all steps or at one."""
        return self.outcome[variable]


def pair(family: BeliefFamily[Any], method: str, found: Any, due: str) -> tuple[Any, Any]:
    """The two results of a family's method; anything else is refused by a ModelError."""
    if isinstance(found, tuple) and len(found) == 2:
        return found
    what = f"a tuple of {len(found)}" if isinstance(found, tuple) else type(found).__name__
    raise ModelError(f"{family!r}: {method} returns {due}, not {what}")


def shown(
    family: BeliefFamily[Any],
    beliefs: Sequence[Any],
    scope: Scope,
    columns: Integers,
    lead: tuple[int, ...],
    steps: Integers | None,
    size: int,
) -> Any:
    """The marginal over some variables of a family's beliefs, one a step.

    beliefs: The family's own values, of the steps, or of one step if `steps` is None.
    columns: The indices of the variables' components among the d of a slice.
    lead: The shape of the user's axes of runs.
    size: The number of components of a slice, d.
    """
    found = family.marginal(beliefs, scope, columns)
    if found is not None:
        return found
    each = [family.draws(belief) for belief in beliefs]
    if each[0] is not None:
        return _draws(family, each, scope, columns, lead, steps, size)
    return _moments(family, beliefs, scope, columns, lead, steps, size)


def _moments(
    family: BeliefFamily[Any],
    beliefs: Sequence[Any],
    scope: Scope,
    columns: Integers,
    lead: tuple[int, ...],
    steps: Integers | None,
    size: int,
) -> Gaussian:
    """The Gaussian of the moments of beliefs, (*lead, steps, ...)."""
    means, covs, runs = [], [], int(np.prod(lead))
    for k, belief in enumerate(beliefs):
        told = pair(family, "moments(belief)", family.moments(belief), "a mean and a covariance")
        mean, cov = (as_floats(each, f"{family!r}: moments(belief)", ModelError) for each in told)
        if mean.shape != (runs, size) or cov.shape != (runs, size, size):
            raise ModelError(
                f"{family!r}: moments(belief) has shapes {mean.shape} and {cov.shape}; "
                f"({runs}, {size}) and ({runs}, {size}, {size}) were due: runs, components of a "
                "slice"
            )
        own = np.diagonal(cov, axis1=-2, axis2=-1)
        if not (np.isfinite(mean).all() and np.isfinite(cov).all() and (own >= 0.0).all()):
            raise NumericalError(
                f"{family!r}: moments(belief) has a mean or a covariance that is not finite, or a "
                f"variance below zero, for the {_th(k, steps)}"
            )
        means.append(mean[:, columns])
        covs.append(cov[:, columns[:, None], columns])
    mean, cov = np.stack(means, axis=1), np.stack(covs, axis=1)
    shape = lead if steps is None else (*lead, len(beliefs))
    wide = len(columns)
    return Gaussian._make(scope, mean.reshape(*shape, wide), cov.reshape(*shape, wide, wide), steps)


def _draws(
    family: BeliefFamily[Any],
    each: Sequence[Any],
    scope: Scope,
    columns: Integers,
    lead: tuple[int, ...],
    steps: Integers | None,
    size: int,
) -> ParticleBelief:
    """The weighted draws of beliefs, over a scope's components."""
    places, end = [], 0
    for variable in scope:
        places.append((variable, end))
        end += variable.dimension
    clouds = [_cloud(family, draws, columns, int(np.prod(lead)), size) for draws in each]
    return ParticleBelief(parts(places), clouds, lead, steps)


def _cloud(family: BeliefFamily[Any], draws: Any, columns: Integers, runs: int, size: int) -> Cloud:
    """Draws (runs, n, d), with their log-weights (runs, n) or None, as a cloud of some rows."""
    points, log_weights = pair(family, "draws(belief)", draws, "points and their log-weights")
    points = as_floats(points, f"{family!r}: the points of draws(belief)", ModelError)
    if points.ndim != 3 or len(points) != runs or points.shape[2] != size:
        raise ModelError(
            f"{family!r}: draws(belief) has points of shape {points.shape}; ({runs}, n, {size}) "
            "was due: runs, points, components of a slice"
        )
    count = points.shape[1]
    logs: Array = np.full((runs, count), -np.log(max(count, 1)))
    if log_weights is not None:
        logs = as_floats(log_weights, f"{family!r}: the log-weights of draws(belief)", ModelError)
        if logs.shape != (runs, count):
            raise ModelError(
                f"{family!r}: draws(belief) has log-weights of shape {logs.shape}; ({runs}, "
                f"{count}) was due"
            )
        with np.errstate(invalid="ignore"):  # which is refused below
            logs = logs - np.logaddexp.reduce(logs, axis=1, keepdims=True)
    if not (count and np.isfinite(points).all()) or np.isnan(logs).any():
        raise NumericalError(
            f"{family!r}: draws(belief) has no points, points that are not finite, or log-weights "
            "that are NaN or infinite, or all of them minus infinity"
        )
    states = np.ascontiguousarray(points[..., columns].reshape(runs * count, -1).T)
    return Cloud(states, logs.reshape(-1), np.arange(runs + 1) * count)


def _th(k: int, steps: Integers | None) -> str:
    """The belief of a step, in words."""
    return "belief" if steps is None else f"belief of step {int(steps[k])}"
