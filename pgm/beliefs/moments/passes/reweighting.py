"""Weighing all measurements of robust noise at once; weights as results show them.

A *sighting* is one measurement by a sensor, of which a step may have several; those of a sensor
have M rows, sorted by step, and d components each. The steps are 0..T; a *slice* is the vector of
all hidden variables of a step, of n components. A sighting with robust noise counts as a Gaussian
of covariance R / w, w being its weight. Its *surplus* is the robust log-density less that of this
Gaussian.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.kernels.arrays import Array, Mask, block
from pgm.kernels.prefixes import gather
from pgm.linearisation.weights import bound_kind, shown
from pgm.posteriors.weights import Weights
from pgm.schedules.iteration import Point


def reweigh(plan: ChainPlan, at: Point, active: Mask | None) -> None:
    """Weigh all robust sightings at a point, the beliefs at which the plan was linearised.

    Their noise in the plan becomes R / w, plus the covariance of the linearisation's error. Runs
    that are not `active` (runs,) keep their weights and noise; None means all are active.
    """
    for sensor in plan.robust:
        family = sensor.family
        error = None if family.taylor else family.noise - family.own_noise
        square = squares(sensor, at.mean, at.known_cov, plan.first, error)
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
    """The squares νᵀR⁻¹ν of a sensor's residuals ν by its linearisation, (M, runs).

    `mean` (T+1, runs, n) and `cov` (T+1, runs, n, n) are the beliefs over the slices, the first of
    them at step `first`. By Taylor's rule ν is the residual of the means; with a lineariser that
    takes expectations the squares are expected under the beliefs, and `error` (M, runs, d, d) is
    the covariance of its approximation error, None for zero.
    """
    family, parents, places = sensor.family, sensor.parents, sensor.family.step - first
    residual = sensor.moved - family.value(slice(None), gather(mean, places)[..., parents])
    if not family.expects:
        return sensor.weights.squares(residual)
    spread = block(gather(cov, places), parents, parents)
    return sensor.weights.squares(residual, family.matrix, spread, error)


def settled(plan: ChainPlan) -> Mask | bool:
    """Whether graduated losses have reached the losses of the model, (runs,), or True for all.

    A graduated loss begins wide, and is sharpened from one linearisation to the next.
    """
    found: Mask | bool = True
    for sensor in plan.robust:
        found = found & sensor.weights.staged
    return found


def surplus(plan: ChainPlan, step: int) -> Array | float:
    """The surplus of a step's robust sightings, added up, (runs,); zero without any."""
    found: Array | float = 0.0
    for sensor in plan.robust:
        found = found + sensor.weights.surplus(sensor.rows(step)).sum(axis=0)
    return found


def by_step(plan: ChainPlan) -> Array | float:
    """The surplus of each step's robust sightings, added up, (T+1, runs); zero without any."""
    if not plan.robust:
        return 0.0
    return np.array([np.broadcast_to(surplus(plan, k), plan.runs) for k in range(plan.steps + 1)])


def weights(plan: ChainPlan) -> Weights:
    """The weights (*runs, M) that a plan holds, by sensor, in the order of the user's evidence."""
    found = {}
    for sensor in plan.sensors:
        weight = sensor.weights.weight if sensor.robust else np.ones(sensor.family.shape[:2])
        rows = np.broadcast_to(shown(weight, sensor.taken), weight.shape)
        back = np.argsort(sensor.order)
        found[sensor.variable] = rows[back].swapaxes(0, 1).reshape(*plan.lead, len(back))
    return Weights(found)


def evidence_kind(plan: ChainPlan, *, fixed: bool) -> str:
    """The kind of a log-evidence in words.

    With Gaussian noise it is ``exact`` if all CPDs are affine; ``laplace`` if all are linearised by
    Taylor's rule, and `fixed` says that this was at a fixed point of a smoother; else
    ``linearised``. With robust noise it is ``unnormalised`` if a density has no finite integral;
    else ``bound``, a lower one, if all CPDs are affine, and ``linearised bound`` if not.
    """
    affine = all(family.exact for family in plan.families)
    if not plan.robust:
        taylor = all(family.taylor for family in plan.families)
        return "exact" if affine else "laplace" if fixed and taylor else "linearised"
    return bound_kind([sensor.family for sensor in plan.robust], affine=affine)
