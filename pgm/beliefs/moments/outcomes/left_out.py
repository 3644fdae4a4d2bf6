r"""The beliefs of readings of a chain given all readings but their own, of smoothed beliefs.

A reading z = F x + b + e, e ~ N(0, R), has the likelihood N(z; y, R) of y = F x + b. Let y be
smoothed to N(m, S). Without the reading y has the belief N(m⁻, S⁻) with 1/S⁻ = 1/S − 1/R, which is
an update by a covariance −R:

.. math:: D = R - S, \quad m^- = m + S D^{-1} (m - z), \quad S^- = S + S D^{-1} S,

and what would be read is N(m⁻, S⁻ + R). With R = L Lᵀ the eigenvalues of L⁻¹ D L⁻ᵀ are between 0
and 1: they are the shares R / (S⁻ + R), and the digits that are lost are their logarithms.

References
----------
de Jong, A cross-validation filter for time series models, 1988.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.moments.outcomes.measurements import Expected, read, unweighed
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.errors import NumericalError, Unanswered
from pgm.factors import Gaussian
from pgm.factors.scope import in_run
from pgm.kernels import roots, solving
from pgm.kernels.arrays import Array, Mask, independent, transpose

# A share R / (S⁻ + R) below this leaves fewer than six digits of what is found.
_LEAST = 1e-9


def left_out(plan: ChainPlan, sensor: Sensor, mean: Array, spread: Diffuse) -> Gaussian:
    """The belief of each reading of a sensor given all others, in the order of the evidence.

    `mean` (T+1, runs, n) and `spread` are the smoothed beliefs over slices. Readings are as they
    were linearised and weighed for these. A NumericalError refuses a reading that alone tells what
    it measures, or that is read without noise.
    """
    family = sensor.family
    if sensor.is_correlated:
        raise Unanswered(
            f"left_out[{sensor.variable!r}]: its sightings of a step are linearised as one vector, "
            "whose errors are correlated, and none can be left out by itself"
        )
    found = read(sensor, mean, spread)
    at = spread.at(family.step).of(sensor.parents)
    smoothed = at.measured(family.matrix, np.zeros_like(family.noise)).cov
    taken = np.broadcast_to(True if sensor.taken is None else sensor.taken, found.mean.shape)
    # Components that were not read have nothing to be removed.
    root = roots.root(independent(family.noise, taken))
    cross = solving.solve_lower(root, np.where(taken[..., None], smoothed, 0.0))
    within = np.where(taken[..., None, :], cross, 0.0)
    white = solving.solve_lower(root, transpose(within))
    share = np.eye(sensor.height) - 0.5 * (white + transpose(white))
    least = np.linalg.eigvalsh(np.where(np.isfinite(share), share, 0.0))[..., 0]
    singular = roots.determined(root).any(axis=-1) | ~(least > _LEAST)
    if singular.any():
        raise _refusal(plan, sensor, singular)
    away = np.where(taken, found.mean - sensor.values, 0.0)
    off = solving.solve_lower(root, away[..., None])
    gain = transpose(solving.solve(roots.root(share), cross))
    noise = family.noise if not sensor.robust else unweighed(sensor, mean, spread).noise
    cov = smoothed + gain @ cross + noise
    rows = Expected(
        family.step,
        found.mean + (gain @ off)[..., 0],
        found.spread._replace(cov=0.5 * (cov + transpose(cov))),
    )
    return rows.at(np.argsort(sensor.order)).gaussian(sensor.variable, plan.lead)


def _refusal(plan: ChainPlan, sensor: Sensor, singular: Mask) -> NumericalError:
    """The error for readings (rows, runs) that a mask marks, which cannot be left out."""
    row = int(singular.any(axis=-1).argmax())
    step = int(sensor.family.step[row])
    return NumericalError(
        f"left_out[{sensor.variable!r}]: the reading at step {step}"
        f"{in_run(singular[row].reshape(plan.lead))} has no noise, or tells by itself nearly all "
        "that is known of what it measures, and removing it leaves too few digits; smooth again "
        "without it, NaN in its place",
        variable=sensor.variable,
        step=step,
    )
