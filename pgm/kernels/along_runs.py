"""Gaussian predictions and updates of many runs at once; the last axis of all arrays is the runs.

Each operation on a component goes along a contiguous row of runs. Covariances P (n, n, runs) are
exactly symmetric. A measurement of a belief N(m, P) is z = H x + v, v ~ N(0, R), of d components;
r = z − H m is its residual, S = H P Hᵀ + R the covariance of r. The measurement is *mild* where S
is at most a thousand times R in every direction: then it shrinks no variance more than a thousand
times.

Symmetric matrices are factorised as U D Uᵀ, with U unit lower triangular and D the diagonal of
pivots: a pivot is the variance of a component given those before it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import LOG_2PI, Array
from pgm.kernels.roots import NEGLIGIBLE

# A B and A Bᵀ, the latter the faster one.
_PRODUCT, _TIMES_TRANSPOSED = "ijr,jkr->ikr", "ijr,kjr->ikr"
# The largest factor by which a mild measurement shrinks a variance.
_MILD = 1e3
# Below this a product of pivots has lost digits.
_SMALLEST = float(np.finfo(np.float64).tiny)


def push(cov: Array, matrix: Array, noise: Array, out: Array) -> None:
    """Put the covariance F P Fᵀ + Q of a prediction F x + w, w ~ N(0, Q), into `out`, (d, d, runs).

    F is `matrix`, (d, n, runs), P = `cov`, (n, n, runs), the covariance of x, and Q = `noise`,
    (d, d, runs or 1).
    """
    half = np.einsum(_TIMES_TRANSPOSED, matrix, cov)
    np.einsum(_TIMES_TRANSPOSED, half, matrix, out=out)
    out += noise
    _mirror(out)


class Update(NamedTuple):
    """The belief N(mean, cov) after a measurement, and the factors of S = U diag(pivots) Uᵀ.

    `mean` is (n, runs) and `cov` (n, n, runs); `log_density` (runs,) is ln N(r; 0, S). `pivots` is
    (d, runs). Of `unit` (d, d, runs) only the entries below the diagonal are those of U. `mild`:
    whether the measurement is known to be mild in all runs, so that no digits can have been lost.
    Where it is not, the covariance has been found by Joseph's form already.
    """

    mean: Array
    cov: Array
    log_density: Array
    unit: Array
    pivots: Array
    mild: bool

    @property
    def lower(self) -> Array:
        """The lower triangular Cholesky factor L of S = L Lᵀ, (d, d, runs)."""
        return _lower(self.unit, np.sqrt(self.pivots))


def sharpness(noise: Array, least: float = NEGLIGIBLE) -> Array:
    """The bound 1000 det R on det S, (runs or 1,): a measurement with a smaller det S is mild.

    `noise` is R, (d, d, runs or 1). Since S ≥ R, a smaller det S leaves S at most 1000 R in every
    direction: S is then regular, and the new covariance P − G S Gᵀ, with the gain G = P Hᵀ S⁻¹,
    loses at most three of sixteen digits. The bound is 0, so that no measurement counts as mild,
    where a pivot of R is at most 1000 · `least` times its diagonal entry, or det R is no more than
    the smallest normal float64.
    """
    pivots = _eliminate(noise.copy())
    regular = (pivots > _MILD * least * np.einsum("iir->ir", noise)).all(axis=0)
    det = pivots.prod(axis=0)
    bound: Array = np.where(regular & (det > _SMALLEST), _MILD * det, 0.0)
    return bound


def update(
    mean: Array,
    cov: Array,
    matrix: Array,
    residual: Array,
    noise: Array,
    out: tuple[Array, Array] | None = None,
    *,
    sharp: Array | None = None,
    least: float = NEGLIGIBLE,
) -> Update | None:
    """Condition beliefs N(m, P) on a measurement each; None if S is singular in some run.

    The mean is m + G r with the gain G = P Hᵀ S⁻¹. The covariance is P − G S Gᵀ if the measurement
    is mild in all runs, else (I − G H) P (I − G H)ᵀ + G R Gᵀ, which keeps more digits. `mean` is m
    (n, runs), `cov` P (n, n, runs), `matrix` H (d, n, runs), `residual` r (d, runs) and `noise` R
    (d, d, runs or 1).

    The new moments are written into `out`, if given: a mean (n, runs) and a covariance (n, n,
    runs), other arrays than `mean` and `cov`. `sharp` (runs or 1,) is the bound on det S below
    which a measurement counts as mild; it is computed from R if None. S counts as singular in a run
    where one of its pivots is at most `least` times its diagonal entry, unless the measurement is
    mild in all runs.
    """
    size, runs, height = len(cov), cov.shape[-1], len(residual)
    new_mean, new_cov = (np.empty((size, runs)), np.empty_like(cov)) if out is None else out
    # [r, P Hᵀ], then [r, P Hᵀ] L⁻ᵀ.
    white = np.empty((1 + size, height, runs))
    white[0] = residual
    cross = np.einsum(_TIMES_TRANSPOSED, cov, matrix, out=white[1:])
    unit: Array = np.einsum(_PRODUCT, matrix, cross)
    unit += noise
    pivots = _eliminate(unit, white)
    det = np.multiply.reduce(pivots)
    if sharp is None:
        sharp = sharpness(noise, least)
    # Rounding alone can leave S below the noise, and then its pivots are not all positive.
    mild = bool((det < sharp).all() and (pivots > 0.0).all())
    if not (mild or _is_regular(unit, pivots, least)):
        return None
    root = np.sqrt(pivots)
    white /= root
    if mild:
        change = np.einsum(_TIMES_TRANSPOSED, white[1:], white)
        np.add(mean, change[:, 0], out=new_mean)
        np.subtract(cov, change[:, 1:], out=new_cov)
        log_det = np.log(det, out=det)
    else:
        gain = divide(white[1:], _lower(unit, root))
        _sum_of_squares(gain, cov, matrix, noise, new_cov)
        np.einsum("ijr,jr->ir", gain, residual, out=new_mean)
        new_mean += mean
        log_det = np.log(pivots).sum(axis=0)  # where their product could be too small a number
    log_density: Array = np.add.reduce(np.square(white[0]))
    log_density += log_det
    log_density += height * LOG_2PI
    log_density *= -0.5
    return Update(new_mean, new_cov, log_density, unit, pivots, mild)


def open_share(cov: Array) -> float:
    """The least share of a component's variance that the components before it leave open.

    The share of component i is its variance given the components before it, divided by its whole
    variance: L_ii² / P_ii for P = L Lᵀ. The least is over all components and runs, and at most 1.
    `cov` is P, (n, n, runs), and is overwritten; components without a variance do not count.
    """
    variances = np.einsum("iir->ir", cov)
    variances[variances == 0.0] = 1.0
    whole = np.abs(variances)
    return float((_eliminate(cov) / whole).min(initial=1.0))


def inflation(cov: Array) -> Array:
    """The sum of the variance inflation factors of each covariance (n, n, runs), as (runs,).

    The factor of a component is its variance divided by its variance given all other components.
    The sum is tr C⁻¹ for the correlations C, and with C = U D Uᵀ it is Σ_k Σ_i (U⁻¹)²_ki / D_k.
    `cov` is overwritten; the factor of a component without a variance is one, and the sum is
    infinite where C is not positive definite.
    """
    size = len(cov)
    own = np.einsum("iir->ir", cov)
    unit = np.sqrt(np.abs(own))
    unit[unit == 0.0] = 1.0
    cov /= unit
    cov /= unit[:, None]
    np.einsum("iir->ir", cov)[...] = 1.0
    total = np.zeros(cov.shape[-1])
    rows: list[list[Array]] = []  # of U⁻¹, up to the one on its diagonal
    with np.errstate(all="ignore"):  # of what is singular; see below
        pivots = _eliminate(cov)
        for k in range(size):
            row = [-cov[k, i] for i in range(k)]
            for i in range(k):
                for j in range(i + 1, k):
                    row[i] = row[i] - cov[k, j] * rows[j][i]
            rows.append(row)
            total += (1.0 + sum(part * part for part in row)) / pivots[k]
    total[~(pivots > 0.0).all(axis=0)] = np.inf
    return total


def least_left(before: Array, after: Array) -> float:
    """The smallest ratio of a variance in `after` to the same component's in `before`, at most 1.

    Both are covariances (n, n, runs); the smallest is over all components and runs. A component
    with a variance of zero after, or none above zero before, does not count.
    """
    was, left = (np.einsum("iir->ir", cov) for cov in (before, after))
    counts = (left != 0.0) & (was > 0.0)
    return float((left[counts] / was[counts]).min(initial=1.0))


def _eliminate(matrix: Array, right: Array | None = None) -> Array:
    """Factorise symmetric A = U D Uᵀ in place; returns the pivots D, (d, runs).

    `matrix` A (d, d, runs) becomes U below the diagonal, D on it and D Uᵀ above; `right` B (m, d,
    runs), if given, becomes B U⁻ᵀ.
    """
    for j in range(1, len(matrix)):
        for k in range(j):
            part = matrix[j, k]
            for i in range(k):
                part -= matrix[j, i] * matrix[i, k]
            matrix[k, j] = part  # U D, which the symmetric half has room for
            part /= matrix[k, k]
            matrix[j, j] -= part * matrix[k, j]
            if right is not None:
                right[:, j] -= part * right[:, k]
    size, _, runs = matrix.shape
    return matrix.reshape(size * size, runs)[:: size + 1]


def _lower(unit: Array, root: Array) -> Array:
    """The lower triangular U diag(`root`), (d, d, runs), `root` being (d, runs).

    U has ones on its diagonal, and below it the entries of `unit` (d, d, runs).
    """
    lower = np.zeros_like(unit)
    for j in range(len(unit)):
        lower[j, j] = root[j]
        np.multiply(unit[j + 1 :, j], root[j], out=lower[j + 1 :, j])
    return lower


def _is_regular(unit: Array, pivots: Array, least: float) -> bool:
    """Whether each pivot of S = U D Uᵀ is above `least` times S's diagonal entry, in all runs.

    `pivots` (d, runs) are the diagonal of D. `unit` (d, d, runs) is as `_eliminate` leaves it: U
    below its diagonal, D Uᵀ above it. Entry j of the diagonal of S is pivot j plus
    Σₖ U_jk (D Uᵀ)_kj, k < j, which elimination has taken from it.
    """
    for j, pivot in enumerate(pivots):
        taken = sum(unit[j, k] * unit[k, j] for k in range(j))
        if not (pivot > least * (pivot + taken)).all():
            return False
    return True


def _sum_of_squares(gain: Array, cov: Array, matrix: Array, noise: Array, out: Array) -> None:
    """Put the covariance after an update, (I − G H) P (I − G H)ᵀ + G R Gᵀ, into `out`.

    This form, Joseph's, holds for any gain G. `out` and P = `cov` are (n, n, runs), G = `gain`
    (n, d, runs), H = `matrix` (d, n, runs) and R = `noise` (d, d, runs or 1).
    """
    size, height, runs = gain.shape
    # [1 − G H, G] and [(1 − G H) P, G noise].
    factor, spread = np.empty((2, size, size + height, runs))
    keep, factor[:, size:] = factor[:, :size], gain
    np.einsum(_PRODUCT, gain, matrix, out=keep)
    np.negative(keep, out=keep)
    for i in range(size):
        keep[i, i] += 1.0
    np.einsum(_TIMES_TRANSPOSED, keep, cov, out=spread[:, :size])
    np.einsum(_PRODUCT, gain, np.broadcast_to(noise, (height, height, runs)), out=spread[:, size:])
    np.einsum(_TIMES_TRANSPOSED, spread, factor, out=out)
    _mirror(out)


def divide(matrix: Array, lower: Array) -> Array:
    """The solution F of F L = J, (d, n, runs), for J = `matrix` and lower triangular L = `lower`.

    J is (d, n, runs), L (n, n, runs).
    """
    result = np.empty_like(matrix)
    for j in reversed(range(len(lower))):
        column = matrix[:, j]
        for k in range(j + 1, len(lower)):
            column = column - result[:, k] * lower[k, j]
        np.divide(column, lower[j, j], out=result[:, j])
    return result


def _mirror(matrix: Array) -> None:
    """Copy the upper triangle of matrices (n, n, ...) onto the lower one, in place."""
    for i in range(1, len(matrix)):
        matrix[i, :i] = matrix[:i, i]
