"""The forward sweep of many runs: little but arithmetic between one user's function and the next.

It leaves what the general sweep leaves. A step that is out of the ordinary goes the general way;
where a number is not finite, the whole sweep does, and refuses it.
"""

from __future__ import annotations

import numpy as np

from pgm.errors import PgmError
from pgm.inference.chain.forward import Forward, put, start
from pgm.inference.chain.many_parts import Move, Read, runs_last
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.update import NEARLY_SINGULAR, sensors_due, update
from pgm.kernels import along_runs, memory, roots
from pgm.kernels.arrays import Array, Mask

Moments = tuple[Array, Array]
# From this many runs on there is more arithmetic than calls.
MANY = 32


def suits(plan: ChainPlan) -> bool:
    """Whether there are many runs, of a network that has nothing out of the ordinary."""
    return (
        plan.runs >= MANY
        and plan.layout.single
        and Move.suits(plan.transition[0])
        and all(Read.suits(sensor, plan.layout.slice_size) for sensor in plan.sensors)
    )


def run(plan: ChainPlan) -> tuple[Forward, Mask] | None:
    """Sweep forward, each CPD linearised once; whether a run has nothing to iterate, (runs,).

    None where the general sweep has to find out what is wrong.
    """
    memory.retain()
    move, reads = Move(plan.transition[0]), [Read(sensor) for sensor in plan.sensors]
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):  # see above
        try:
            out = _sweep(plan, move, reads)
        except PgmError:
            out = None
    for prepared in (move, *reads):
        prepared.settle(lost=out is None)
    if out is None:
        return None
    linear = all(read.family.exact for read in reads if read.family.step.size)
    return out, np.full(plan.runs, linear)


def _sweep(plan: ChainPlan, move: Move, reads: list[Read]) -> Forward | None:
    out = Forward.empty(plan)
    predicted_mean, predicted_cov, kept_mean, kept_cov = map(
        runs_last, (out.predicted_mean, out.predicted_cov, out.mean, out.cov)
    )
    first, spread = start(plan, linearise=True)
    out.predicted_mean[0] = first
    put(out.predicted_cov[0], slice(None), spread)
    for step in range(plan.steps + 1):
        mean, cov = predicted_mean[step], predicted_cov[step]
        if step:
            move.predict(step - 1, kept_mean[step - 1], kept_cov[step - 1], (mean, cov))
        kept = kept_mean[step], kept_cov[step]
        out.log_density[step] = _update(plan, reads, step, (mean, cov), kept)
    # What is not finite stays so from one step to the next.
    total = kept_mean[-1].sum() + kept_cov[-1].sum() + out.log_density.sum()
    return out if np.isfinite(total) else None


def _update(
    plan: ChainPlan, reads: list[Read], step: int, belief: Moments, kept: Moments
) -> Array | float:
    """Take the readings of a step into a belief; their log-density."""
    mean, cov = belief
    parts = [
        read.read(row, mean, cov) for read in reads for row in range(*read.bounds[step : step + 2])
    ]
    if not parts:
        kept[0][...], kept[1][...] = mean, cov
        return 0.0
    matrix, residual, noise = parts[0] if len(parts) == 1 else _stacked(parts)
    found = along_runs.update(mean, cov, matrix, residual, noise, kept)
    if found is not None:
        _, _, log_density, lower = found
        singular = len(parts) > 1 and (
            roots.smallest_pivot(np.moveaxis(lower, -1, 0)) < NEARLY_SINGULAR
        )
        if not singular:
            return log_density
    runs_first = np.moveaxis(mean, -1, 0), np.moveaxis(cov, -1, 0)
    new_mean, new_cov, log_density = update(sensors_due(plan.sensors, step), step, *runs_first)
    kept[0][...], kept[1][...] = np.moveaxis(new_mean, 0, -1), np.moveaxis(new_cov, 0, -1)
    return log_density


def _stacked(parts: list[tuple[Array, Array, Array]]) -> tuple[Array, Array, Array]:
    """Several readings as one: H, residual, noise."""
    matrices, residuals, noises = zip(*parts, strict=True)
    size, width, runs = sum(map(len, residuals)), parts[0][0].shape[1], residuals[0].shape[-1]
    matrix, residual = np.empty((size, width, runs)), np.concatenate(residuals)
    noise = np.zeros((size, size, max(each.shape[-1] for each in noises)))
    top = 0
    for its_matrix, its_noise in zip(matrices, noises, strict=True):
        rows = slice(top, top := top + len(its_matrix))
        matrix[rows], noise[rows, rows] = its_matrix, its_noise
    return matrix, residual, noise
