"""Weighing all sightings of robust noise at once, and their log-densities by step."""

from __future__ import annotations

import numpy as np

from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.sensor import Sensor
from pgm.inference.iteration import Point
from pgm.kernels.arrays import Array, Mask, block
from pgm.kernels.elements import gather


def reweigh(plan: ChainPlan, at: Point, active: Mask | None) -> None:
    """Weigh all sightings, of active runs, at the beliefs where the plan was linearised."""
    for sensor in plan.robust:
        family = sensor.family
        error = None if family.taylor else family.noise - family.own_noise
        square = squares(sensor, at.mean, at.cov, plan.first, error)
        sensor.weights.take(square, active)
        noise = sensor.weights.scaled(family.own_noise)
        if error is not None:
            noise = noise + error
        family.keep_errors()
        if active is not None:
            noise = np.where(active[:, None, None], noise, family.noise)
        family.noise[...] = noise


def squares(
    sensor: Sensor, mean: Array, cov: Array, first: int, error: Array | None = None
) -> Array:
    """The squares of a sensor's residuals, (M, runs), as it is linearised."""
    family, parents, places = sensor.family, sensor.parents, sensor.family.step - first
    residual = sensor.moved - family.value(slice(None), gather(mean, places)[..., parents])
    if not family.expects:
        return sensor.weights.squares(residual)
    spread = block(gather(cov, places), parents, parents)
    return sensor.weights.squares(residual, family.matrix, spread, error)


def settled(plan: ChainPlan) -> Mask | bool:
    """Whether all losses are those that were asked for, (runs,)."""
    found: Mask | bool = True
    for sensor in plan.robust:
        found = found & sensor.weights.staged
    return found


def surplus(plan: ChainPlan, step: int) -> Array | float:
    """The log-density of a step's measurements beyond that of the Gaussians, (runs,)."""
    found: Array | float = 0.0
    for sensor in plan.robust:
        found = found + sensor.weights.surplus(sensor.rows(step)).sum(axis=0)
    return found


def by_step(plan: ChainPlan) -> Array | float:
    """The same of all steps, (T+1, runs)."""
    if not plan.robust:
        return 0.0
    return np.array([np.broadcast_to(surplus(plan, k), plan.runs) for k in range(plan.steps + 1)])
