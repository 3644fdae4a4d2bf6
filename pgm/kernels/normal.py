"""Normal densities by the root L of the covariance, and squared lengths of innovations.

A component that those before it determine (`roots.determined`) adds nothing to the density, which
is that of the others. Points stand along the last axis but one, (..., S, d), so that one root
(..., d, d) serves all of them.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels import roots
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, apply, transpose
from pgm.kernels.roots import NEGLIGIBLE

# The part of a point and of the mean by which what users compute may take it off a subspace.
INEXACT = 1e-9
# The part of its deviation by which a component may differ from what those before it determine:
# three times what a root takes for zero.
SLACK = 3.0 * roots.NEGLIGIBLE**0.5


def draw(mean: Array, lower: Array, white: Array) -> Array:
    """Points of N(mean, L Lᵀ), (..., d), for white noise."""
    return mean + apply(lower, white)


def whitened(lower: Array, residual: Array) -> tuple[Array, Array | None]:
    """White residuals, (..., S, d), zero where determined; and what is left there."""
    white = transpose(roots.solve_lower(lower, transpose(residual)))
    fixed = roots.determined(lower)
    if not fixed.any():
        return white, None
    return _without(fixed, white), _without(~fixed, white)


def whitener(lower: Array) -> Array | None:
    """L⁻¹, by which many residuals are whitened at once; None where a component is determined."""
    if roots.determined(lower).any():
        return None
    return roots.solve_lower(lower, np.broadcast_to(np.eye(lower.shape[-1]), lower.shape))


def _without(gone: Mask, vectors: Array) -> Array:
    return np.where(gone[..., None, :], 0.0, vectors)


def log_density(lower: Array, white: Array) -> Array:
    """The log-density −½ (|s|² + ln |2π L Lᵀ|) of the open components, (..., S), at white s."""
    fixed = roots.determined(lower)
    dimension: int | Integers = lower.shape[-1]
    if fixed.any():
        dimension = dimension - fixed.sum(axis=-1)
    constant = roots.log_determinant(lower) + dimension * LOG_2PI
    value: Array = -0.5 * ((white * white).sum(axis=-1) + constant[..., None])
    return value


def off(lower: Array, left: Array, error: Array) -> Mask:
    """Whether residuals (..., S, d), wrong by at most `error`, leave the subspace of the noise."""
    # What is left depends linearly on the residuals: by this matrix.
    spread = np.abs(roots.solve_lower(lower, np.broadcast_to(np.eye(lower.shape[-1]), lower.shape)))
    deviations = np.sqrt((lower * lower).sum(axis=-1))
    allowed = error @ transpose(spread) + SLACK * deviations[..., None, :]
    far: Mask = (np.abs(left) > allowed).any(axis=-1)
    return far


def square_within(probability: float, dimension: Integers) -> Array:
    """The squared length, in deviations, within which a normal vector is with a probability."""
    from scipy.special import chdtri  # here, since it is slow to import

    return np.asarray(chdtri(dimension, 1.0 - probability), dtype=np.float64)


def squares(residual: Array, cov: Array) -> Array:
    """The value νᵀ S⁻¹ ν of stacked innovations ν (k, d, *batch), S (k, d, d, *batch).

    Components are eliminated one after another, all of the stack at once.
    """
    size = residual.shape[1]
    if size == 1:
        return _share(residual[:, 0], cov[:, 0, 0], cov[:, 0, 0])
    residual, cov = residual.copy(), cov.copy()
    diagonal = np.einsum("kii...->ki...", cov).copy()
    total = np.zeros(residual[:, 0].shape)
    for j in range(size):
        pivot, left = cov[:, j, j].copy(), residual[:, j].copy()
        total = total + _share(left, pivot, diagonal[:, j])
        if j + 1 == size:
            break
        proper = pivot > NEGLIGIBLE * diagonal[:, j]
        factor = cov[:, j + 1 :, j] / np.where(proper, pivot, np.inf)[:, None]
        residual[:, j + 1 :] -= factor * left[:, None]
        cov[:, j + 1 :, j + 1 :] -= factor[:, :, None] * cov[:, None, j, j + 1 :]
    return total


def _share(left: Array, pivot: Array, diagonal: Array) -> Array:
    proper = pivot > NEGLIGIBLE * diagonal
    if proper.all():
        return left * left / pivot
    return np.where(proper, left * left / np.where(proper, pivot, 1.0), 0.0)
