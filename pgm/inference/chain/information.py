"""Backward messages in information form, for those who want to read them.

Marginals and joints do not need them: they come from the reversed chain, which exists where these
do not (a static state read exactly).
"""

from __future__ import annotations

import numpy as np

from pgm.inference.chain.backward import transition
from pgm.inference.chain.forward import Forward
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.readings import stored
from pgm.kernels import canonical, roots
from pgm.kernels.arrays import LOG_2PI, Array, apply, inner, sandwich, transpose
from pgm.kernels.canonical import Canonical
from pgm.kernels.moments import Conditional


def backward_messages(plan: ChainPlan, forward: Forward) -> list[Canonical]:
    """The likelihood of the readings after each step, as a function of the states at it.

    Messages are carried about the filtered mean, so that large coordinates cost no digits, and
    moved to the origin at the end. NaN in runs where the message does not exist.
    """
    states, size = plan.layout.state_places, plan.layout.state_size
    message: Canonical = (
        np.zeros((plan.runs, size, size)),
        np.zeros((plan.runs, size)),
        np.zeros(plan.runs),
    )
    messages = [message]
    conditionals = transition(plan)
    for later in range(plan.steps, 0, -1):
        conditional, likelihood = absorbed(plan, forward, conditionals, later)
        message = canonical.backward(*conditional, *message)
        if likelihood is not None:
            message = canonical.product(message, likelihood)
        messages.append(message)
    return [
        canonical.shift(*message, forward.mean[step][..., states])
        for step, message in enumerate(reversed(messages))
    ]


def absorbed(
    plan: ChainPlan, forward: Forward, conditionals: Conditional, later: int
) -> tuple[Conditional, Canonical | None]:
    """The states at a step given those before it and the step's readings, and what these say.

    Both about the filtered means: of the states at the step, and of those before it, of which the
    readings' likelihood is a function.
    """
    layout = plan.layout
    select = np.eye(layout.slice_size)[layout.state_places]
    matrix, noise = conditionals.matrix[later - 1], conditionals.cov[later - 1]
    predicted = forward.predicted_mean[later]
    offset = np.zeros_like(predicted)
    likelihood: Canonical | None = None
    found = stored(plan, later, predicted)
    if found is not None:
        matrix, offset, noise, likelihood = absorb_readings(matrix, noise, *found)
    shift = offset + predicted - forward.mean[later]
    return Conditional(select @ matrix, apply(select, shift), sandwich(select, noise)), likelihood


def absorb_readings(
    matrix: Array,
    noise: Array,
    h_matrix: Array,
    residual: Array,
    reading_noise: Array,
    missing: Array | None,
) -> tuple[Array, Array, Array, Canonical]:
    """Bring a step's readings into its transition w = A x + q, both about predicted means.

    Returns the conditional of w given x and the readings, and their likelihood as a function of
    x, through S = H Q Hᵀ + noise of the reading, which has to be regular.
    """
    cross = h_matrix @ noise
    lower = canonical.strict_root(cross @ transpose(h_matrix) + reading_noise)
    gain = roots.gain(transpose(cross), lower)
    reach = h_matrix @ matrix
    white = roots.solve_lower(lower, reach)
    white_residual = roots.solve_lower(lower, residual[..., None])
    keep = np.eye(noise.shape[-1]) - gain @ h_matrix
    absorbed = sandwich(keep, noise) + sandwich(gain, reading_noise)
    h = (transpose(white) @ white_residual)[..., 0]
    white_residual = white_residual[..., 0]
    g = -0.5 * (
        inner(white_residual, white_residual)
        + roots.log_determinant(lower)
        + residual.shape[-1] * LOG_2PI
    )
    if missing is not None:
        g = g + 0.5 * LOG_2PI * missing
    likelihood = (transpose(white) @ white, h, g)
    return keep @ matrix, apply(gain, residual), absorbed, likelihood
