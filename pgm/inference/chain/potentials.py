"""The potentials of a chain's clusters: CPDs as they were linearised, with their evidence."""

from __future__ import annotations

import numpy as np

from pgm.inference.chain.backward import Ahead, transition
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.reweighting import by_step
from pgm.inference.chain.vector import stacks
from pgm.kernels import canonical, roots
from pgm.kernels.arrays import LOG_2PI, Array, apply, block, inner, transpose
from pgm.kernels.canonical import Canonical


def likelihoods(plan: ChainPlan, reference: Array) -> Canonical:
    """The likelihood of each step's measurements, over the slice about a reference.

    (T+1, runs, ...), as the plan was linearised; NaN where the noise of a measurement is singular.
    """
    size, shape = plan.layout.slice_size, (plan.steps + 1, plan.runs)
    K, h, g = np.zeros((*shape, size, size)), np.zeros((*shape, size)), np.zeros(shape)
    read = [sensor for sensor in plan.sensors if sensor.family.step.size]
    for steps, matrix, residual, noise, missing in stacks(plan, read, reference):
        lower = canonical.strict_root(noise)
        white = roots.solve_lower(lower, matrix)
        left = roots.solve_lower(lower, residual[..., None])[..., 0]
        K[steps] = transpose(white) @ white
        h[steps] = apply(transpose(white), left)
        log_scale = roots.log_determinant(lower) + (matrix.shape[-2] - missing) * LOG_2PI
        g[steps] = -0.5 * (inner(left, left) + log_scale)
    return K, h, g + by_step(plan)


def first_potential(plan: ChainPlan, forward: Ahead) -> Canonical:
    """The potential of cluster 0, over its states: prior and measurements, (runs, ...)."""
    states = plan.layout.state_places
    reference = forward.predicted_mean
    K, h, g = (part[0] for part in likelihoods(plan, reference))
    mean = reference[0][:, states]
    said = canonical.shift(block(K, states, states), h[:, states], g, mean)
    cov = block(forward.predicted_cov[0], states, states)
    return canonical.product(canonical.from_moments(mean, cov, np.zeros(plan.runs)), said)


def potentials(plan: ChainPlan, forward: Ahead) -> Canonical:
    """The potentials of clusters 1..T, over the states of the step before and the slice.

    (T, runs, ...), as the plan was linearised and about the means of `forward`; NaN where a noise
    is singular.
    """
    layout, reference = plan.layout, forward.mean
    front, size = layout.state_size, layout.slice_size
    before = reference[:-1][..., layout.state_places]
    matrix, offset, noise = transition(plan)
    offset = apply(matrix, before) + offset - reference[1:]
    K, h, g = canonical.from_affine(matrix, offset, noise)
    order = np.roll(np.arange(size + front), front)  # the conditional's own scope comes first
    K, h = block(K, order, order), h[..., order]
    own_K, own_h, own_g = likelihoods(plan, reference)
    K[..., front:, front:] += own_K[1:]
    h[..., front:] += own_h[1:]
    return canonical.shift(K, h, g + own_g[1:], np.concatenate([before, reference[1:]], axis=-1))
