"""The marginals that a user's own family of beliefs shows: moments, draws, or values of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pgm.errors import ModelError
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


def shown(
    family: BeliefFamily[Any],
    beliefs: Sequence[Any],
    scope: Scope,
    columns: Integers,
    lead: tuple[int, ...],
    steps: Integers | None,
) -> Any:
    """The marginal over some variables of a family's beliefs, one a step.

    beliefs: The family's own values, of the steps, or of one step if `steps` is None.
    columns: The indices of the variables' components among the d of a slice.
    lead: The shape of the user's axes of runs.
    """
    found = family.marginal(beliefs, scope, columns)
    if found is not None:
        return found
    each = [family.draws(belief) for belief in beliefs]
    if each[0] is not None:
        return _draws(family, each, scope, columns, lead, steps)
    return _moments(family, beliefs, scope, columns, lead, steps)


def _moments(
    family: BeliefFamily[Any],
    beliefs: Sequence[Any],
    scope: Scope,
    columns: Integers,
    lead: tuple[int, ...],
    steps: Integers | None,
) -> Gaussian:
    """The Gaussian of the moments of beliefs, (*lead, steps, ...)."""
    means, covs = [], []
    for belief in beliefs:
        mean, cov = (np.asarray(each, dtype=np.float64) for each in family.moments(belief))
        runs, size = int(np.prod(lead)), mean.shape[-1]
        if mean.shape != (runs, size) or cov.shape != (runs, size, size):
            raise ModelError(
                f"{family!r}: moments(belief) has shapes {mean.shape} and {cov.shape}; (runs, d) "
                f"and (runs, d, d) were due, of {runs} runs"
            )
        means.append(mean[:, columns])
        covs.append(cov[:, columns[:, None], columns])
    mean, cov = np.stack(means, axis=1), np.stack(covs, axis=1)
    shape = lead if steps is None else (*lead, len(beliefs))
    size = len(columns)
    return Gaussian._make(scope, mean.reshape(*shape, size), cov.reshape(*shape, size, size), steps)


def _draws(
    family: BeliefFamily[Any],
    each: Sequence[Any],
    scope: Scope,
    columns: Integers,
    lead: tuple[int, ...],
    steps: Integers | None,
) -> ParticleBelief:
    """The weighted draws of beliefs, over a scope's components."""
    places, end = [], 0
    for variable in scope:
        places.append((variable, end))
        end += variable.dimension
    clouds = [_cloud(family, draws, columns, int(np.prod(lead))) for draws in each]
    return ParticleBelief(parts(places), clouds, lead, steps)


def _cloud(family: BeliefFamily[Any], draws: Any, columns: Integers, runs: int) -> Cloud:
    """Draws (runs, n, d), with their log-weights (runs, n) or None, as a cloud of some rows."""
    points, log_weights = draws
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 3 or len(points) != runs:
        raise ModelError(
            f"{family!r}: draws(belief) has points of shape {points.shape}; (runs, n, d) was due, "
            f"of {runs} runs"
        )
    count = points.shape[1]
    logs: Array = np.full((runs, count), -np.log(count))
    if log_weights is not None:
        logs = np.asarray(log_weights, dtype=np.float64)
        logs = logs - np.logaddexp.reduce(logs, axis=1, keepdims=True)
    states = np.ascontiguousarray(points[..., columns].reshape(runs * count, -1).T)
    return Cloud(states, logs.reshape(-1), np.arange(runs + 1) * count)
