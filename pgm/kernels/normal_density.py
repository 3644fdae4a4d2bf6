"""Normal densities by the root of a covariance, singular ones too: draws, whitening, log-density.

L (..., d, d) is the lower root of the covariance, with a zero pivot for each component that those
before it determine; the others are *open*, and the density is that of the open components. Points
stand along the last axis but one, (..., S, d), so that one root serves all of them. A vector r is
*whitened* by solving L s = r: s ~ N(0, I) if r ~ N(0, L Lᵀ).
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

# The part of a point and of the mean by which users' arithmetic may take a point off the subspace
# to which a singular covariance confines it.
INEXACT = 1e-9
# The part of its standard deviation by which a component may differ from the value that those
# before it determine: three times what a root takes for zero.
SLACK = 3.0 * NEGLIGIBLE**0.5


def draw(mean: Array, lower: Array, white: Array) -> Array:
    """The points m + L w, (..., d): draws from N(m, L Lᵀ) if w was drawn from N(0, I).

    m is `mean` and w `white`, one point each, (..., d); L is `lower`.
    """
    return mean + apply(lower, white)


def whitened(lower: Array, residual: Array) -> tuple[Array, Array | None]:
    """The whitened residuals, and their rests at determined components, (..., S, d) both.

    `lower` is L, and `residual` (..., S, d) are vectors r, points less a mean. Whitened residuals
    are zero at determined components. The rest at a determined component is the residual less the
    value that the open components determine for it; at open components it is zero. None is returned
    for the rests if all components are open.
    """
    white = transpose(solve_lower(lower, transpose(residual)))
    fixed = determined(lower)
    if not fixed.any():
        return white, None
    return _without(fixed, white), _without(~fixed, white)


def whitener(lower: Array) -> Array | None:
    """The inverse L⁻¹, (..., d, d), to whiten many residuals; None if a component is determined."""
    if determined(lower).any():
        return None
    return solve_lower(lower, np.broadcast_to(np.eye(lower.shape[-1]), lower.shape))


def _without(gone: Mask, vectors: Array) -> Array:
    """Vectors (..., S, d) with zero in the components that `gone` (..., d) marks."""
    return np.where(gone[..., None, :], 0.0, vectors)


def log_density(lower: Array, white: Array) -> Array:
    """The log-density −½ (|s|² + ln |2π L Lᵀ|) of the open components, (..., S).

    `white` are the whitened residuals s, (..., S, d), zero at determined components.
    """
    fixed = determined(lower)
    dimension: int | Integers = lower.shape[-1]
    if fixed.any():
        dimension = dimension - fixed.sum(axis=-1)
    constant = log_determinant(lower) + dimension * LOG_2PI
    value: Array = -0.5 * ((white * white).sum(axis=-1) + constant[..., None])
    return value


def off(lower: Array, left: Array, error: Array) -> Mask:
    """The mask (..., S) of residuals that are off the range of L, where the density is zero.

    `left` (..., S, d) is, at each determined component, the residual less the value that the open
    components determine for it, and zero at open components. `error` (..., S, d) bounds how far
    each component of a residual may be wrong: this can change |left| by at most |L⁻¹| error, with
    ones for the zero pivots of L. A residual is off if |left| exceeds that bound by more than 10⁻⁶
    standard deviations in some component.
    """
    # What is left depends linearly on the residuals: by this matrix.
    spread = np.abs(solve_lower(lower, np.broadcast_to(np.eye(lower.shape[-1]), lower.shape)))
    deviations = np.sqrt((lower * lower).sum(axis=-1))
    allowed = error @ transpose(spread) + SLACK * deviations[..., None, :]
    far: Mask = (np.abs(left) > allowed).any(axis=-1)
    return far
