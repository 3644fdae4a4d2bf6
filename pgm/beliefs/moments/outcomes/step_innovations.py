"""The innovations of the last step of a plan, and the gains of its measurements.

The gain of measurements z = H x + e of a step is K = P Hᵀ S⁻¹, P being the covariance of the slice
before them and S = H P Hᵀ + R that of their residuals, of all sensors together.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.moments.outcomes.innovations import innovations
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.vector import stacks
from pgm.kernels import moments, step
from pgm.kernels.arrays import Array
from pgm.kernels.dense import Stack
from pgm.posteriors.innovations import Innovations
from pgm.variables import Variable

# Of a sensor, its innovations and its gains (*lead, M, n, d), by hidden variable of n components.
Found = tuple[Innovations, dict[Variable, Array]]


def at_last_step(plan: ChainPlan, forward: Forward) -> dict[Variable, Found]:
    """The innovations and gains of each sensor that has measurements at a plan's last step.

    `forward` is the forward pass over the plan, which has its linearisations.
    """
    plan, forward = plan.window(plan.steps, plan.steps), forward.last
    for sensor in plan.sensors:  # the only step of the pass is its first
        sensor.family.step = sensor.family.step - plan.first
    gains = _gains(plan, forward)
    return {s.variable: (innovations(plan, s, forward), gains[s.variable]) for s in plan.read}


def _gains(plan: ChainPlan, forward: Forward) -> dict[Variable, dict[Variable, Array]]:
    """By sensor of a plan of one step, and by hidden variable, the gains (*lead, M, n, d)."""
    found: dict[Variable, dict[Variable, Array]] = {}
    for _, matrix, _, noise, _ in stacks(plan, plan.read, forward.predicted_mean):
        cov = forward.predicted_cov if forward.diffuse is None else forward.diffuse.cov
        root = Stack(moments.predict(cov, matrix, noise), True).root()
        whole = step.gain(root, Stack(matrix) @ Stack(cov, True)).array[0]
        if forward.diffuse is not None:
            open_ = np.any(forward.diffuse.open[0], axis=(-2, -1), keepdims=True)
            whole = np.where(open_, np.nan, whole)
        top = 0
        for sensor in plan.read:
            count, height = len(sensor.values), sensor.height
            own = whole[..., top : top + count * height]
            top += count * height
            rows = np.moveaxis(own.reshape(*own.shape[:-1], count, height), -2, 1)
            rows = rows[:, np.argsort(sensor.order)]
            places = plan.layout.places
            found[sensor.variable] = {
                variable: rows[..., place, :].reshape(*plan.lead, count, -1, height)
                for variable, place in places.items()
            }
    return found
