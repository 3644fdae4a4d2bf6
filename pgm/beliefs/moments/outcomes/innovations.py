"""Innovations ν = z − h(x̂) of the measurements z of a forward pass at its predicted means x̂."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.outcomes.measurements import read
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.beliefs.moments.steps.vector import stacks
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.dense import Stack
from pgm.kernels.step import innovation
from pgm.posteriors.innovations import Innovations


def innovations(plan: ChainPlan, sensor: Sensor, forward: Forward) -> Innovations:
    """The innovations of one sensor of a plan, at the predicted beliefs of a forward pass.

    The sensor is linearised as the plan has it. NIS and degrees of freedom are of this sensor
    alone.
    """
    found, lead = read(sensor, forward.predicted_mean, forward.ahead), plan.lead
    residual, cov = sensor.values - found.mean, found.spread.cov
    given = sensor.taken if sensor.gated is None else sensor.gated.given
    taken = np.broadcast_to(True if given is None else given, residual.shape)
    rejected = np.zeros(residual.shape[:2], dtype=bool)
    if sensor.gated is not None:
        rejected |= sensor.gated.rejected
    taken = taken & ~found.spread.unknown
    nis, dof = by_step(plan, [sensor], forward)
    back = np.argsort(sensor.order)

    def out(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        result = array.swapaxes(0, 1).reshape(*lead, array.shape[0], *array.shape[2:])
        result.flags.writeable = False
        return result

    return Innovations(
        out(np.where(taken, residual, np.nan)[back]),
        out(np.where(taken[..., None] & taken[..., None, :], cov, np.nan)[back]),
        found.step[back],
        out(nis),
        out(dof),
        out(rejected[back]),
    )


def by_step(plan: ChainPlan, sensors: list[Sensor], forward: Forward) -> tuple[Array, Integers]:
    """The NIS of each step over all components that `sensors` measured, and its degrees of freedom.

    Both are (T+1, runs); the NIS is NaN where nothing was measured. The degrees of freedom are the
    number of components `measured`, less the number of their combinations of which nothing was
    known, given a flat prior.
    """
    shape = plan.steps + 1, plan.runs
    nis, dof = np.full(shape, np.nan), np.zeros(shape, dtype=np.intp)
    for steps, matrix, residual, noise, missing in stacks(plan, sensors, forward.predicted_mean):
        ahead = forward.ahead.at(steps)
        residual, spread, unknown = ahead.innovations(matrix, residual, noise)
        square = innovation(Stack.column(residual), Stack(spread, True)).square
        seen = residual.shape[-1] - missing - unknown
        dof[steps] = seen
        nis[steps] = np.where(seen > 0, square, np.nan)
    return nis, dof


def measured(plan: ChainPlan, *sensors: Sensor) -> Integers:
    """How many components were measured at each step, and not rejected by a gate, (T+1, runs).

    They are of some sensors, or of all.
    """
    found = np.zeros((plan.steps + 1, plan.runs), dtype=np.intp)
    for sensor in sensors or plan.read:
        if sensor.taken is None:
            found += sensor.height * np.diff(sensor.edges)[:, None]
        else:
            np.add.at(found, sensor.family.step, sensor.taken.sum(axis=-1))
    return found
