"""Linear models of functions by regression on sigma points.

The N points s are sigma points of a standard normal vector of n components, mapped to x = m + L s
by a root L of the covariance of x; the values Y of the function at them are regressed on s by
weighted least squares. The weights of means and of covariances (N,) are those of the rule that the
points belong to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels import roots
from pgm.kernels.arrays import Array, apply, transpose


def regress(
    s: Array,
    values: Array,
    mean_weights: Array,
    cov_weights: Array,
    lower: Array,
    *,
    known: bool = False,
) -> tuple[Array, Array, Array]:
    """The regression line through values (..., N, d) at points s (..., N, n) of N(0, I).

    Returns the slope J (..., d, n), the line's value at s = 0, (..., d), and the covariance of the
    residuals, (..., d, d). A column of J is zero where that of L = `lower`, (..., n, n), is zero.
    The mean and covariance of s are those of the sample, or, if `known`, 0 and I; then the
    residual covariance may be indefinite.
    """
    value_mean, s_mean = mean_weights @ values, mean_weights @ s
    deviation, ds = values - value_mean[..., None, :], s - s_mean[..., None, :]
    unused = roots.determined(lower)
    if unused.any():
        ds = np.where(unused[..., None, :], 0.0, ds)
    weighted = transpose(cov_weights[:, None] * ds)
    moment = weighted @ deviation
    if known:
        spread = transpose(cov_weights[:, None] * deviation) @ deviation
        return transpose(moment), value_mean, spread - transpose(moment) @ moment
    normal = weighted @ ds
    if unused.any():
        normal = normal + unused[..., None] * np.eye(unused.shape[-1])
    slope = transpose(np.asarray(np.linalg.solve(normal, moment), dtype=np.float64))
    left = deviation - ds @ transpose(slope)
    noise = transpose(cov_weights[:, None] * left) @ left
    return slope, value_mean - apply(slope, s_mean), noise


class Fit(NamedTuple):
    """The regression on fixed points, as one matrix to multiply values Y (N, d) with.

    For N points of n components, the product of `rows` (N, N) and Y has, row by row: the line's
    value at s = 0; the transposed slope Jᵀ, n rows; and N − n − 1 rows R, by which the covariance
    of the residuals is Rᵀ diag(signs) R. `signs` (N − n − 1,) are ±1; None stands for all +1.
    """

    rows: Array
    signs: Array | None


def fit(s: Array, mean_weights: Array, cov_weights: Array) -> Fit:
    """The weighted regression on points s (N, n), as one matrix to multiply values Y (N, d) with.

    The product has the regression line's value at s = 0, its slope, and a root of the covariance of
    the residuals. The matrix holds for a root L without a zero column. The mean and covariance of s
    are those of the sample.
    """
    count, size = s.shape
    s_mean = mean_weights @ s
    ds = s - s_mean
    weighted = transpose(cov_weights[:, None] * ds)
    deviation = np.eye(count) - mean_weights
    slope = np.asarray(np.linalg.solve(weighted @ ds, weighted @ deviation), dtype=np.float64)
    left = deviation - ds @ slope
    # As many squares as there are points more than a line passes through.
    values, vectors = np.linalg.eigh(transpose(left) @ (cov_weights[:, None] * left))
    largest = np.argsort(np.abs(values))[size + 1 :]
    root = (np.sqrt(np.abs(values)) * vectors)[:, largest].T
    moments = np.vstack([mean_weights - s_mean @ slope, slope])
    signs = np.sign(values[largest])
    return Fit(np.vstack([moments, root]), None if (signs > 0.0).all() else signs)


def range_inverse(lower: Array, std: Array) -> tuple[Array, Array]:
    """A generalised inverse L⁻ of a root L (..., n, n), and the matrix I − L L⁻, (..., n, n).

    L⁻ is pinv(D⁻¹ L) D⁻¹, so that it does not depend on units. D is the diagonal matrix of the
    standard deviations `std` (..., n) of the components, with one in place of a deviation of zero.
    I − L L⁻ is zero on the range of L: it leaves what lies in directions without variance.
    """
    unit = np.where(std > 0.0, std, 1.0)
    inverse = np.linalg.pinv(lower / unit[..., None], rcond=1e-10) / unit[..., None, :]
    return inverse, np.eye(lower.shape[-1]) - lower @ inverse
