"""The forward sweep of many runs: little but arithmetic between one user's function and the next.

It leaves what the general sweep leaves. A step that is out of the ordinary goes the general way;
where a number is not finite, the whole sweep does, and refuses it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.errors import PgmError
from pgm.inference.chain import forward
from pgm.inference.chain.forward import Forward, start
from pgm.inference.chain.many_parts import Move, Read, Reading, Unusual, runs_last
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.update import NEARLY_SINGULAR, sensors_due, update
from pgm.inference.schedule import ONCE
from pgm.kernels import along_runs, memory
from pgm.kernels.arrays import Array, vacant
from pgm.kernels.roots import NEGLIGIBLE

Moments = tuple[Array, Array]
# From this many runs on there is more arithmetic than calls.
MANY = 32
# And so many at a time: what a step touches then stays in a cache of some megabytes.
MOST = 10_000
# Between readings that are mild, beliefs are looked at every so many steps, at the last, and where
# a variance has grown by so much since.
_EVERY, _GROWN = 8, 1e2


def suits(plan: ChainPlan) -> bool:
    """Whether there are many runs, of a network that has nothing out of the ordinary."""
    return (
        plan.runs >= MANY
        and plan.layout.single
        and Move.suits(plan.transition[0])
        and all(Read.suits(sensor, plan.layout.slice_size) for sensor in plan.sensors)
    )


@dataclass(frozen=True, eq=False)
class Filtered:
    """The beliefs of a filter, from which all else that a sweep leaves is found when asked for.

    Attributes
    ----------
    mean, cov, log_density : ndarray
        As of a `Forward`.
    closest : float
        The smallest share of a variance that the components before it leave open, of the beliefs
        looked at, and of the variance before a sharp reading: those before and after sharp
        readings, where variances have grown, and of some steps between.
    """

    plan: ChainPlan
    mean: Array
    cov: Array
    log_density: Array
    closest: float = 1.0

    @cached_property
    def whole(self) -> Forward:
        """What a sweep leaves; the plan holds its linearisations only then."""
        return forward.run(self.plan, ONCE)[0]


def run(plan: ChainPlan) -> Forward | None:
    """Sweep forward, each CPD linearised once.

    None where the general sweep has to find out what is wrong.
    """
    out = Forward.empty(plan)
    predicted = runs_last(out.predicted_mean), runs_last(out.predicted_cov)
    kept = runs_last(out.mean), runs_last(out.cov)
    return None if _run(plan, predicted, kept, out.log_density, store=True) is None else out


def filtered(plan: ChainPlan, room: Moments | None = None) -> Filtered | None:
    """The same, but for the beliefs alone, in the room for their moments, if there is any."""
    size, shape = plan.layout.slice_size, (plan.steps + 1, plan.runs)
    mean, cov = room or (vacant(shape, (size,)), vacant(shape, (size, size)))
    log_density = np.empty(shape)
    parts, closest = math.ceil(plan.runs / MOST), 1.0
    edges = [part * plan.runs // parts for part in range(parts + 1)]
    for runs in map(slice, edges, edges[1:]):
        part = plan.of(runs) if parts > 1 else plan
        # One row serves all steps.
        predicted = np.empty((1, size, part.runs)), np.empty((1, size, size, part.runs))
        kept = runs_last(mean)[..., runs], runs_last(cov)[..., runs]
        found = _run(part, predicted, kept, log_density[:, runs], store=False)
        if found is None:
            return None
        closest = min(closest, found)
    return Filtered(plan, mean, cov, log_density, closest)


def _run(
    plan: ChainPlan, predicted: Moments, kept: Moments, log_density: Array, *, store: bool
) -> float | None:
    """Sweep, and return how close components come; None where a number is not finite."""
    closest = 1.0
    memory.retain()
    move = Move(plan.transition[0], store=store)
    reads = [Read(sensor, store=store) for sensor in plan.sensors]
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):  # see above
        try:
            closest = _sweep(plan, move, reads, predicted, kept, log_density)
            # A covariance that is not finite stays so from one step to the next.
            total = kept[0].sum() + kept[1][-1].sum() + log_density.sum()
            done = bool(np.isfinite(total))
        except (PgmError, Unusual):
            done = False
    for prepared in (move, *reads):
        prepared.settle(lost=not done)
    return closest if done else None


def _sweep(
    plan: ChainPlan,
    move: Move,
    reads: list[Read],
    predicted: Moments,
    kept: Moments,
    log_density: Array,
) -> float:
    closest, level = 1.0, np.full((plan.layout.slice_size, plan.runs), np.inf)
    first, spread = start(plan, linearise=True)
    predicted[0][0], predicted[1][0] = np.moveaxis(first, 0, -1), np.moveaxis(spread, 0, -1)
    for step in range(plan.steps + 1):
        row = step if len(predicted[0]) > 1 else 0
        belief = predicted[0][row], predicted[1][row]
        if step:
            move.predict(step - 1, kept[0][step - 1], kept[1][step - 1], belief)
        known = kept[0][step], kept[1][step]
        log_density[step], mild = _update(plan, reads, step, belief, known)
        spread = np.einsum("iir->ir", belief[1])
        regular = mild and not (spread > _GROWN * level).any()
        if not regular:
            level = spread.copy()
            closest = min(closest, along_runs.open_share(belief[1].copy()))
        if not mild:
            closest = min(closest, along_runs.least_left(belief[1], known[1]))
        if not step:
            level = np.einsum("iir->ir", known[1]).copy()
        if not regular or step == plan.steps or (step and step % _EVERY == 0):
            level = np.minimum(level, np.einsum("iir->ir", known[1]))
            closest = min(closest, along_runs.open_share(known[1].copy()))
    return closest


def _update(
    plan: ChainPlan, reads: list[Read], step: int, belief: Moments, kept: Moments
) -> tuple[Array | float, bool]:
    """Take the readings of a step into a belief; their log-density, and whether they are mild."""
    mean, cov = belief
    parts = [
        read.read(step, row, mean, cov)
        for read in reads
        for row in range(*read.bounds[step : step + 2])
    ]
    if not parts:
        kept[0][...], kept[1][...] = mean, cov
        return 0.0, True
    if len(parts) == 1:
        [(matrix, residual, noise, sharp)], least = parts, NEGLIGIBLE
    else:
        (matrix, residual, noise), sharp, least = _stacked(parts), None, NEARLY_SINGULAR
    found = along_runs.update(mean, cov, matrix, residual, noise, kept, sharp=sharp, least=least)
    if found is not None:
        return found.log_density, found.mild
    if not all(read.store for read in reads):
        raise Unusual
    runs_first = np.moveaxis(mean, -1, 0), np.moveaxis(cov, -1, 0)
    new_mean, new_cov, log_density = update(sensors_due(plan.sensors, step), step, *runs_first)
    kept[0][...], kept[1][...] = np.moveaxis(new_mean, 0, -1), np.moveaxis(new_cov, 0, -1)
    return log_density, False


def _stacked(parts: list[Reading]) -> tuple[Array, Array, Array]:
    """Several readings as one: H, residual, noise."""
    matrices, residuals, noises, _ = zip(*parts, strict=True)
    size, width, runs = sum(map(len, residuals)), parts[0][0].shape[1], residuals[0].shape[-1]
    matrix, residual = np.empty((size, width, runs)), np.concatenate(residuals)
    noise = np.zeros((size, size, max(each.shape[-1] for each in noises)))
    top = 0
    for its_matrix, its_noise in zip(matrices, noises, strict=True):
        rows = slice(top, top := top + len(its_matrix))
        matrix[rows], noise[rows, rows] = its_matrix, its_noise
    return matrix, residual, noise
