"""Predictions and updates of many runs, as of `moments`, along rows: the last axis is the runs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import LOG_2PI, Array
from pgm.kernels.roots import NEGLIGIBLE

# A B and A Bᵀ, the latter the faster one.
_PRODUCT, _TIMES_TRANSPOSED = "ijr,jkr->ikr", "ijr,kjr->ikr"
# By how much a mild measurement shrinks a variance at most.
_MILD = 1e3
# Below this a product of pivots has lost digits.
_SMALLEST = float(np.finfo(np.float64).tiny)


def push(cov: Array, matrix: Array, noise: Array, out: Array) -> None:
    """Put the covariance F P Fᵀ + noise into `out`, (d, d, runs)."""
    half = np.einsum(_TIMES_TRANSPOSED, matrix, cov)
    np.einsum(_TIMES_TRANSPOSED, half, matrix, out=out)
    out += noise
    _mirror(out)


class Update(NamedTuple):
    """N(mean, cov), (n, runs), given a measurement, and ln N(r; 0, S).

    S = U diag(pivots) Uᵀ, of whose unit lower U only what is below the diagonal is there; `mild`
    says whether no variance has fallen more than a thousand times.
    """

    mean: Array
    cov: Array
    log_density: Array
    unit: Array
    pivots: Array
    mild: bool

    @property
    def lower(self) -> Array:
        """The Cholesky factor of S, (d, d, runs)."""
        return _lower(self.unit, np.sqrt(self.pivots))


def sharpness(noise: Array, least: float = NEGLIGIBLE) -> Array:
    """The value of det S from which on a measurement with this noise is sharp, (runs or 1,).

    Below, S is at most a thousand times the noise in any direction: no variance falls more than
    that, P − K S Kᵀ loses three of sixteen digits at most, and S is regular. Where the noise is not
    regular by a thousand times what is asked, or its determinant too small a number, this is 0.
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
    """A regular `moments.update` with S = H P Hᵀ + noise; None if that is singular.

    Shapes are (n, runs), (n, n, runs), H (d, n, runs), r = z − H mean (d, runs) and noise (d, d,
    runs or 1); the covariance is exactly symmetric, moments go `out`, `sharp` is the `sharpness` of
    the noise, where at hand. S is singular where those before it leave a component no larger share
    than `least`.
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
    """The smallest L_ii² / P_ii over (n, n, runs): the conditional share of a variance.

    Overwrites; components without a variance do not count.
    """
    variances = np.einsum("iir->ir", cov)
    variances[variances == 0.0] = 1.0
    whole = np.abs(variances)
    return float((_eliminate(cov) / whole).min(initial=1.0))


def inflation(cov: Array) -> Array:
    """The variance inflation factors of covariances (n, n, runs) added up: tr C⁻¹, (runs,).

    C are the correlations; a factor is a variance over the share of it that all other components
    leave open. With C = U D Uᵀ it is Σ_k Σ_i (U⁻¹)²_ki / D_k. Overwrites; the factor of a component
    without a variance is one, and the sum is infinite where C is not positive definite.
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
    """The smallest ratio of variance after to before, over (n, n, runs); zeros do not count."""
    was, left = (np.einsum("iir->ir", cov) for cov in (before, after))
    counts = (left != 0.0) & (was > 0.0)
    return float((left[counts] / was[counts]).min(initial=1.0))


def _eliminate(matrix: Array, right: Array | None = None) -> Array:
    """The pivots D of A = U D Uᵀ, (d, runs); puts U below the diagonal of A, and B U⁻ᵀ into B."""
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
    """The lower triangular U diag(r) of a unit lower triangular U (n, n, R) and roots r (n, R)."""
    lower = np.zeros_like(unit)
    for j in range(len(unit)):
        lower[j, j] = root[j]
        np.multiply(unit[j + 1 :, j], root[j], out=lower[j + 1 :, j])
    return lower


def _is_regular(unit: Array, pivots: Array, least: float) -> bool:
    """Whether each pivot is more than the `least` share of its diagonal entry.

    `unit` holds U below its diagonal and diag(pivots) Uᵀ above it, so that entry j of the diagonal
    is the pivot plus Σₖ U_jk U_kj, k < j: the part of it that elimination has taken.
    """
    for j, pivot in enumerate(pivots):
        taken = sum(unit[j, k] * unit[k, j] for k in range(j))
        if not (pivot > least * (pivot + taken)).all():
            return False
    return True


def _sum_of_squares(gain: Array, cov: Array, matrix: Array, noise: Array, out: Array) -> None:
    """Put Joseph's form (1 − G H) P (1 − G H)ᵀ + G R Gᵀ, (n, n, runs), with noise R, into `out`."""
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
    """The F with F L = J for J (d, n, runs)."""
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
