"""Messages back along a chain and the potentials of its clusters, in information form.

Messages are for users who ask for them: marginals and joints come from the reversed chain. A
canonical form (K, h, g) is exp(−½ xᵀK x + hᵀx + g); K is (..., n, n), h (..., n) and g (...).
*About* the filtered means it is a function of the deviation of x from its filtered mean. A *slice*
is the vector of all hidden variables of a step, states and controls. Cluster 0 is over the states
at step 0, cluster t over the states at t − 1 and the slice at t; T is the last step. An *element*
describes a segment of consecutive steps: the conditional of the states at its end given those at
its start and its measurements, with the likelihood of these measurements over the states at its
start.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.passes.backward import Ahead, stepwise_is_faster, transition
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.passes.reweighting import by_step, surplus
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import stored
from pgm.beliefs.moments.steps.vector import stacks
from pgm.kernels import canonical, elements, solving, step
from pgm.kernels.arrays import LOG_2PI, Array, apply, block, inner, sandwich, transpose
from pgm.kernels.canonical import Canonical
from pgm.kernels.dense import Stack, StackRoot
from pgm.kernels.elements import Element
from pgm.kernels.moments import Conditional
from pgm.kernels.prefixes import levels, prefixes, take


def backward_messages(plan: ChainPlan, forward: Forward) -> Canonical:
    """The messages p(measurements after t | states at t), t = 0..T, as (K, h, g), (T+1, runs, ...).

    NaN where a message has no canonical form. Messages are carried back about the filtered means,
    so that large coordinates cost no digits, by a scan, or step by step where that is faster; at
    the end they become functions of the states themselves.
    """
    states, size = plan.layout.state_places, plan.layout.state_size
    message: Canonical = (
        np.zeros((plan.runs, size, size)),
        np.zeros((plan.runs, size)),
        np.zeros(plan.runs),
    )
    found = None
    if not stepwise_is_faster(plan.steps, plan.runs):
        found = _scanned(plan, forward, message)
    if found is None:
        found = _stepwise(plan, forward, message)
    return canonical.shift(*found, forward.mean[..., states])


def _stepwise(plan: ChainPlan, forward: Forward, message: Canonical) -> Canonical:
    """The messages about the filtered means, (T+1, runs, ...), step by step from the last one.

    The last is `message` (runs, ...), that of step T: with no measurements after it, all zeros.
    """
    messages = [message]
    conditionals = transition(plan)
    for later in range(plan.steps, 0, -1):
        conditional, likelihood = absorbed(plan, forward, conditionals, later)
        message = canonical.backward(*conditional, *message)
        if likelihood is not None:
            message = canonical.product(message, likelihood)
        messages.append(message)
    K, h, g = (np.stack(parts[::-1]) for parts in zip(*messages, strict=True))
    return K, h, g


def _scanned(plan: ChainPlan, forward: Forward, last: Canonical) -> Canonical | None:
    """The messages about the filtered means, (T+1, runs, ...), by a scan of 2 log₂ T rounds.

    `last` (runs, ...) is the message of step T, all zeros. None if any message is not finite, since
    a root or inverse does not exist.
    """
    segments = take(absorbed_at_once(plan, forward), slice(None, None, -1))
    tree = levels(segments, lambda later, sooner: elements.compose(sooner, later))
    found = prefixes(_Message(*(part[None] for part in last)), tree, _passed)
    if not all(np.isfinite(part).all() for part in found):
        return None
    K, h, g = (np.concatenate([a[None], b])[::-1] for a, b in zip(last, found, strict=True))
    return K, h, g


class _Message(NamedTuple):
    """Canonical forms (K, h, g) over the states, (steps, runs, ...)."""

    K: Array
    h: Array
    g: Array


def _passed(message: _Message, segment: Element) -> _Message:
    """The message at the start of a segment; `message` is the one at the segment's end.

    `segment` is the element of the segment. The result includes the segment's measurements.
    """
    K, h, g = canonical.backward(*segment[:3], *message)
    assert segment.g is not None
    return _Message(K + segment.K, h + segment.h, g + segment.g)


def absorbed_at_once(plan: ChainPlan, forward: Forward) -> Element:
    """The elements p(x[t], z[t] | x[t − 1]) of steps 1..T about the filtered means, (T, runs, ...).

    x are the states and z a step's measurements. An element consists of the factors
    p(x[t] | x[t − 1], z[t]) and p(z[t] | x[t − 1]), found here for all steps in batched calls.
    """
    layout = plan.layout
    select = np.eye(layout.slice_size)[layout.state_places]
    matrix, _, noise = transition(plan)
    size, shape = layout.state_size, (plan.steps, plan.runs)
    matrix, noise = matrix.copy(), np.broadcast_to(noise, (*shape, *noise.shape[2:])).copy()
    offset = np.zeros((*shape, layout.slice_size))
    K, h, g = np.zeros((*shape, size, size)), np.zeros((*shape, size)), np.zeros(shape)
    read = [sensor for sensor in plan.sensors if sensor.family.step.size]
    for steps, *measured in stacks(plan, read, forward.predicted_mean):
        later = steps > 0
        rows = steps[later] - 1
        if rows.size:
            parts = (part[later] for part in measured)
            keep, shift, left, likelihood = absorb_readings(matrix[rows], noise[rows], *parts)
            matrix[rows], offset[rows], noise[rows] = keep, shift, left
            K[rows], h[rows], g[rows] = likelihood
    offset += forward.predicted_mean[1:] - forward.mean[1:]
    if plan.robust:
        g += np.asarray(by_step(plan))[1:]
    return Element(select @ matrix, apply(select, offset), sandwich(select, noise), K, h, g)


def absorbed(
    plan: ChainPlan, forward: Forward, conditionals: Conditional, later: int
) -> tuple[Conditional, Canonical | None]:
    """p(x[t] | x[t − 1], z[t]) and p(z[t] | x[t − 1]) of one step t, which is the argument `later`.

    x are the states, z the measurements. The first result is an affine conditional, the second a
    likelihood (K, h, g) over x[t − 1], None if the step has no measurements; both are about the
    filtered means, with (runs, ...) arrays. `conditionals` (T, runs, ...) are the transitions: row
    t − 1 is the slice at t given the states at t − 1.
    """
    layout = plan.layout
    select = np.eye(layout.slice_size)[layout.state_places]
    matrix, noise = conditionals.matrix[later - 1], conditionals.cov[later - 1]
    predicted = forward.predicted_mean[later]
    offset = np.zeros_like(predicted)
    likelihood: Canonical | None = None
    found = stored(plan, later, predicted)
    if found is not None:
        matrix, offset, noise, (K, h, g) = absorb_readings(matrix, noise, *found)
        likelihood = K, h, g + surplus(plan, later)
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
    """Condition transitions w = A x + q, q ~ N(0, Q), on measurements z = H w + n, n ~ N(0, R).

    `matrix` is A (..., n, m), `noise` Q (..., n, n), `h_matrix` H (..., D, n), `reading_noise`
    R (..., D, D), and `residual` (..., D) z less its expected value at x = 0. `missing` (...)
    counts the components not measured, which have H = 0, no residual and unit variance; None if
    there are none. Returns the conditional of w given x and z, in three arrays, and the likelihood
    (K, h, g) of z over x. With the gain G = Q Hᵀ S⁻¹, S = H Q Hᵀ + R, the conditional has the
    matrix (I − G H) A, the offset G · residual and the covariance (I − G H) Q. All are NaN where
    S is singular.
    """
    start, spread = Stack.column(np.zeros(noise.shape[-1])), Stack(noise, True)
    slope, off, error = Stack(h_matrix), Stack.column(residual), Stack(reading_noise, True)
    cross, ahead = step.crossed(spread, slope, error)
    root = StackRoot(canonical.strict_root(ahead.array))
    gain = step.gain(root, cross)
    after = step.given(start, spread, slope, off, error, root, gain)
    white = root.solve(slope @ Stack(matrix))
    g = -0.5 * (after.square + residual.shape[-1] * LOG_2PI) - after.volume
    if missing is not None:
        g = g + 0.5 * LOG_2PI * missing
    likelihood = ((white.T @ white).array, (white.T @ root.solve(off)).vector, g)
    kept = ((gain @ slope).one_minus() @ Stack(matrix)).array
    return kept, after.mean.vector, after.cov.array, likelihood


def likelihoods(plan: ChainPlan, reference: Array) -> Canonical:
    """The likelihood (K, h, g) of each step's measurements, over the slice less its reference.

    Its arrays are (T+1, runs, ...), with the plan's linearisations; NaN where the noise of a
    measurement is singular. `reference` is (T+1, runs, n).
    """
    size, shape = plan.layout.slice_size, (plan.steps + 1, plan.runs)
    K, h, g = np.zeros((*shape, size, size)), np.zeros((*shape, size)), np.zeros(shape)
    read = [sensor for sensor in plan.sensors if sensor.family.step.size]
    for steps, matrix, residual, noise, missing in stacks(plan, read, reference):
        lower = canonical.strict_root(noise)
        white = solving.solve_lower(lower, matrix)
        left = solving.solve_lower(lower, residual[..., None])[..., 0]
        K[steps] = transpose(white) @ white
        h[steps] = apply(transpose(white), left)
        log_scale = solving.log_determinant(lower) + (matrix.shape[-2] - missing) * LOG_2PI
        g[steps] = -0.5 * (inner(left, left) + log_scale)
    return K, h, g + by_step(plan)


def first_potential(plan: ChainPlan, forward: Ahead) -> Canonical:
    """The potential (K, h, g) of cluster 0, over its states: prior and measurements of step 0.

    Its arrays are (runs, ...). The prior's moments are the predicted ones of `forward` at step 0.
    """
    states = plan.layout.state_places
    reference = forward.predicted_mean
    K, h, g = (part[0] for part in likelihoods(plan, reference))
    mean = reference[0][:, states]
    said = canonical.shift(block(K, states, states), h[:, states], g, mean)
    cov = block(forward.predicted_cov[0], states, states)
    return canonical.product(canonical.from_moments(mean, cov, np.zeros(plan.runs)), said)


def potentials(plan: ChainPlan, forward: Ahead) -> Canonical:
    """The potentials of clusters 1..T, over the states of the step before and the slice.

    Their arrays (K, h, g) are (T, runs, ...), with the plan's linearisations; NaN where a noise is
    singular. They are computed about the means of `forward`, so that large coordinates cost no
    digits, and moved to the origin.
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
