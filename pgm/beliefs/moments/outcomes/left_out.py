r"""The beliefs of readings of a chain given all readings but their own, of smoothed beliefs.

A reading z = F x + b + e, e ~ N(0, R), has the likelihood N(z; y, R) of y = F x + b. Let y be
smoothed to N(m, S). Without the reading y has the belief N(m⁻, S⁻) with 1/S⁻ = 1/S − 1/R, which is
an update by a covariance −R:

.. math:: D = R - S, \quad m^- = m + S D^{-1} (m - z), \quad S^- = S + S D^{-1} S,

and what would be read is N(m⁻, S⁻ + R). With R = L Lᵀ the eigenvalues of L⁻¹ D L⁻ᵀ are between 0
and 1: they are the shares R / (S⁻ + R), and the digits that are lost are their logarithms. Where
too many are lost, as of a reading without noise or of one that alone tells what it measures, the
chain is smoothed again without it, as it was linearised, in twice the digits.

References
----------
de Jong, A cross-validation filter for time series models, 1988.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pgm.beliefs.moments.digits import adjoint, careful
from pgm.beliefs.moments.digits.careful_belief import rounded_belief
from pgm.beliefs.moments.outcomes.measurements import Expected, read, unweighed
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.errors import NumericalError, Unanswered
from pgm.factors import Gaussian
from pgm.factors.scope import in_run
from pgm.kernels import roots, solving
from pgm.kernels.arrays import Array, Integers, Mask, independent, transpose
from pgm.progress import counted

# A share R / (S⁻ + R) below this leaves fewer than six digits of what is found.
_LEAST = 1e-9
# Numbers of the covariances of chains that are smoothed again at a time.
_NUMBERS = 2**18
# The rounding error of a mean, in standard deviations, from which on fewer than six are left.
_WORST = 1e-6


def left_out(plan: ChainPlan, sensor: Sensor, mean: Array, spread: Diffuse) -> Gaussian:
    """The belief of each reading of a sensor given all others, in the order of the evidence.

    `mean` (T+1, runs, n) and `spread` are the smoothed beliefs over slices. Readings are as they
    were linearised and weighed for these. A NumericalError refuses a reading without which too few
    digits are left.
    """
    family = sensor.family
    if sensor.is_correlated:
        raise Unanswered(
            f"left_out[{sensor.variable!r}]: its sightings of a step are linearised as one vector, "
            "whose errors are correlated, and none can be left out by itself; smooth again without "
            "it, NaN in its place"
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
    share = independent(share, np.broadcast_to(~singular[..., None], share.shape[:-1]))
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
    again = np.flatnonzero(singular.any(axis=-1))
    if again.size:
        rows = _smoothed_again(plan, sensor, rows, singular, noise, again)
    return rows.at(np.argsort(sensor.order)).gaussian(sensor.variable, plan.lead)


def _smoothed_again(
    plan: ChainPlan,
    sensor: Sensor,
    rows: Expected,
    singular: Mask,
    noise: Array,
    again: Integers,
) -> Expected:
    """The beliefs of readings, some of them by smoothing without each.

    `rows` are those of all, right but where `singular` (rows, runs) marks them; `again` are the
    rows that it marks in some run. `noise` is that of what would be read.
    """
    family, mean = sensor.family, rows.mean.copy()
    every = [part.copy() for part in rows.spread]
    # Angles of a reading stay on its branch.
    turned = sensor.moved - sensor.values
    for row, at, spread, error in _without_each(plan, sensor, again):
        own = singular[row]
        if (lost := ~(error <= _WORST) & own).any():
            raise _refusal(plan, sensor, row, lost)
        value = family.value(row, at[:, sensor.parents])
        if sensor.variable.angles:
            value = np.where(np.isfinite(turned[row]), value - turned[row], value)
        measured = spread.of(sensor.parents).measured(family.matrix[row], noise[row])
        mean[row] = np.where(own[:, None], value, mean[row])
        wide = max(every[1].shape[-1], measured.open.shape[-1])
        for k, new in enumerate(measured):
            if k:  # open directions, of which other rows may have fewer
                every[k], new = _widened(every[k], wide), _widened(new, wide)
            every[k][row] = np.where(own[:, None, None], new, every[k][row])
    return Expected(rows.step, mean, Diffuse(*every))


def _widened(columns: Array, wide: int) -> Array:
    """Columns (..., d, q) with further ones of zeros, (..., d, wide)."""
    more = wide - columns.shape[-1]
    return np.concatenate([columns, np.zeros((*columns.shape[:-1], more))], axis=-1)


def _without_each(
    plan: ChainPlan, sensor: Sensor, rows: Integers
) -> Iterator[tuple[int, Array, Diffuse, Array]]:
    """By row of a sensor, the belief over the slice of its step without it, and the means' error.

    The chain is as it was linearised and weighed; many copies of it are smoothed at a time, each
    without one reading. Moments are (runs, n) and (runs, n, n); the error (runs,) is in standard
    deviations.
    """
    place = next(k for k, each in enumerate(plan.sensors) if each is sensor)
    numbers = (plan.steps + 1) * plan.runs * plan.layout.slice_size**2
    size = max(_NUMBERS // numbers, 1)
    for begin in counted(range(0, rows.size, size), "readings left out"):
        some = rows[begin : begin + size]
        copies = plan.copies(some.size)
        copies.sensors[place] = copies.sensors[place].without(some)
        swept, _ = careful.sweep(copies)
        steps = sensor.family.step[some] - plan.first
        first, unknown = int(steps.min()), swept.steps[-1].taken.unknown
        slices = adjoint.smoothed(swept, plan.steps, first)
        for copy, (row, step) in enumerate(zip(some.tolist(), steps.tolist(), strict=True)):
            known, own = slices[step - first], slice(copy * plan.runs, (copy + 1) * plan.runs)
            mean, spread = rounded_belief(known.belief, unknown)
            error = known.belief.error(known.parts)
            yield row, mean[own], spread.at(own), error[own]


def _refusal(plan: ChainPlan, sensor: Sensor, row: int, lost: Mask) -> NumericalError:
    """The error for a reading that cannot be left out in the runs (runs,) that a mask marks."""
    step = int(sensor.family.step[row])
    return NumericalError(
        f"left_out[{sensor.variable!r}]: without the reading at step {step}"
        f"{in_run(lost.reshape(plan.lead))} twice the digits of float64 leave fewer than six of "
        "what the others tell of it; give the priors and the units less wide numbers",
        variable=sensor.variable,
        step=step,
    )
