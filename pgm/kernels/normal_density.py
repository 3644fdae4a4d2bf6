"""Normal densities by the root of a covariance, singular ones too: draws, whitening, log-density.

To the density a component that those before it determine adds nothing: it is that of the others.
Points stand along the last axis but one, (..., S, d), so that one root (..., d, d) serves all of
them.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import (
    LOG_2PI,
    Array,
    Integers,
    Mask,
    apply,
    transpose,
)
from pgm.kernels.roots import NEGLIGIBLE, determined
from pgm.kernels.solving import log_determinant, solve_lower

# The part of a point and of the mean by which what users compute may take it off a subspace.
INEXACT = 1e-9
# The part of its deviation by which a component may differ from what those before it determine:
# three times what a root takes for zero.
SLACK = 3.0 * NEGLIGIBLE**0.5


def draw(mean: Array, lower: Array, white: Array) -> Array:
    """Points of N(mean, L Lᵀ), (..., d), for white noise."""
    return mean + apply(lower, white)


def whitened(lower: Array, residual: Array) -> tuple[Array, Array | None]:
    """White residuals, (..., S, d), zero at zero pivots, and the residual left there."""
    white = transpose(solve_lower(lower, transpose(residual)))
    fixed = determined(lower)
    if not fixed.any():
        return white, None
    return _without(fixed, white), _without(~fixed, white)


def whitener(lower: Array) -> Array | None:
    """L⁻¹, by which many residuals are whitened at once; None where a component is determined."""
    if determined(lower).any():
        return None
    return solve_lower(lower, np.broadcast_to(np.eye(lower.shape[-1]), lower.shape))


def _without(gone: Mask, vectors: Array) -> Array:
    """Vectors (..., S, d) with zero in the components that are `gone`."""
    return np.where(gone[..., None, :], 0.0, vectors)


def log_density(lower: Array, white: Array) -> Array:
    """The log-density −½ (|s|² + ln |2π L Lᵀ|) of the open components, (..., S), at white s."""
    fixed = determined(lower)
    dimension: int | Integers = lower.shape[-1]
    if fixed.any():
        dimension = dimension - fixed.sum(axis=-1)
    constant = log_determinant(lower) + dimension * LOG_2PI
    value: Array = -0.5 * ((white * white).sum(axis=-1) + constant[..., None])
    return value


def off(lower: Array, left: Array, error: Array) -> Mask:
    """Whether residuals (..., S, d), wrong by at most `error`, leave the subspace of the noise."""
    # What is left depends linearly on the residuals: by this matrix.
    spread = np.abs(solve_lower(lower, np.broadcast_to(np.eye(lower.shape[-1]), lower.shape)))
    deviations = np.sqrt((lower * lower).sum(axis=-1))
    allowed = error @ transpose(spread) + SLACK * deviations[..., None, :]
    far: Mask = (np.abs(left) > allowed).any(axis=-1)
    return far
