"""Gaussians in moment form, one or a batch: mean (n, *batch), covariance (n, n, *batch).

A measurement of d components of a belief N(m, P) is z = H x + v, v ~ N(0, R); S = H P Hᵀ + R is the
covariance of its residual z − H m. A component of a prediction F x + b + w, with the noise w, is
*bare* if w is zero in it, so that the component is that of F x + b.

Each function chooses the fastest code: for one small Gaussian, Python generated for its size
(`unrolled`); for a larger one LAPACK; for a batch of runs `along_runs`. Where S is nearly singular,
all updates are left to `moments`, which tells singular covariances from rounding.
"""

from __future__ import annotations

from functools import lru_cache
from math import log, sqrt
from types import ModuleType
from typing import NamedTuple

import numpy as np

from pgm.kernels import along_runs, moments, roots
from pgm.kernels.arrays import (
    LOG_2PI,
    Array,
    Index,
    components_first,
    components_last,
    symmetric,
)
from pgm.kernels.moments import ROUNDING
from pgm.kernels.unrolled import checking, predicting, updating

# A pivot of S below this part of its diagonal entry costs too many digits: S is nearly singular.
NEARLY_SINGULAR = 1e-6
# The same part for a covariance, below which its root is left to `roots`, which tells zeros from
# rounding.
_REGULAR = 1e-11


@lru_cache(maxsize=1)
def _lapack() -> ModuleType:
    """SciPy's module of LAPACK functions, imported at the first call."""
    from scipy.linalg import lapack  # here, since it is slow to import

    module: ModuleType = lapack
    return module


def deviations(cov: Array) -> Array:
    """The standard deviations (n, *batch) of covariances (n, n, *batch).

    A variance that rounding has left negative counts as zero.
    """
    found: Array = np.sqrt(np.maximum(np.einsum("ii...->i...", cov), 0.0))
    return found


def lengths(cov: Array) -> Array:
    """The length of each component over which a function may vary, (n, *batch), by P = `cov`.

    `cov` is (n, n, *batch). A length is the standard deviation √P_jj, or, if less, ten times what
    is left of it given the component that says most of it: 10 √(P_jj (1 − ρ²)), ρ being the
    largest correlation of j with another component; at least √P_jj / 1000. A function of the
    difference of two components, either of which is known far less than it, varies over such.
    """
    std = deviations(cov)
    unit = np.where(std > 0.0, std, 1.0)
    shared = (cov / unit / unit[:, None]) ** 2
    np.einsum("ii...->i...", shared)[...] = 0.0
    left = np.sqrt(np.maximum(1.0 - shared.max(axis=1, initial=0.0), 0.0))
    found: Array = std * np.clip(10.0 * left, 1e-3, 1.0)
    return found


def root(cov: Array) -> Array | None:
    """The lower triangular L with P = L Lᵀ, (n, n, *batch); None if any P is not clearly regular.

    P is `cov` (n, n, *batch). It is not clearly regular if a pivot L_jj² is at most 10⁻¹¹ P_jj.
    """
    if cov.ndim > 2:
        return roots.regular_root(cov, _REGULAR)
    lower, fault = _lapack().dpotrf(cov, 1)
    if fault:
        return None
    for pivot, entry in zip(lower.diagonal().tolist(), cov.diagonal().tolist(), strict=True):
        if not pivot * pivot > _REGULAR * entry:
            return None
    found: Array = lower
    return found


def divide(matrix: Array, lower: Array) -> Array:
    """The solution F of F L = J, (d, n, *batch), for J = `matrix` and lower triangular L = `lower`.

    J is (d, n, *batch), L (n, n, *batch).
    """
    if lower.ndim == 2:
        found: Array = _lapack().dtrtrs(lower, matrix.T, 1, 1)[0].T
        return found
    return along_runs.divide(matrix, lower)


def is_moderate(mean: Array, cov: Array, before: Array, least: float, far: float) -> bool:
    """Whether N(mean, cov) is well conditioned, and not far narrower than the covariance `before`.

    `mean` is (n, *batch), `cov` and `before` (n, n, *batch). In the whole batch each component is
    to have a variance given the earlier components of more than `least` times its variance, a
    variance of at least `least` times that in `before`, and a finite mean whose square is at most
    `far` times its variance. A component without a variance passes if it has none in `before` and
    its mean is finite.
    """
    if cov.ndim == 2:
        written = checking(len(cov), least, far)
        if written is not None and written(mean, cov, before):
            return True
    variances = np.einsum("ii...->i...", cov)
    fell = variances < least * np.einsum("ii...->i...", before)
    off = (mean * mean > far * variances) & (variances > 0.0) | ~np.isfinite(mean)
    return not (fell | off).any() and roots.is_regular(components_last(cov, 2), least)


def predict(cov: Array, matrix: Array, noise: Array, bare: tuple[int, ...] = ()) -> Array:
    """The covariance F P Fᵀ + noise of a prediction, (d, d, *batch).

    `cov` P (n, n, *batch) is exactly symmetric; of `matrix` F (d, n, *batch) and `noise`
    (d, d, *batch) the batch may be of length one. `bare` are the places in the prediction of its
    bare components: where the variance of such a component is no more than rounding, its variance
    and covariances become zero.
    """
    if cov.ndim == 2:
        written = predicting(len(noise), len(cov))
        if written is not None:
            spread = written(cov, matrix, noise)
        else:
            spread = symmetric(matrix.dot(cov).dot(matrix.T) + noise)
    else:
        spread = np.empty((len(matrix), len(matrix), *cov.shape[2:]))
        along_runs.push(cov, matrix, noise, spread)
    return _certain(spread, cov, matrix, bare) if bare else spread


def _certain(spread: Array, cov: Array, matrix: Array, bare: tuple[int, ...]) -> Array:
    """The covariance `spread` of a prediction, with zeros for bare components that are certain.

    `spread` is F P Fᵀ + noise, (d, d, *batch), F = `matrix` (d, n, *batch), P = `cov`
    (n, n, *batch). The row and column of each of the components `bare` become zero where its
    variance is only rounding: at most 10⁻¹⁴ of its entry of the diagonal of |F| |P| |F|ᵀ, the sizes
    of the terms that the variance is summed from.
    """
    variances = np.einsum("ii...->i...", cov)
    if cov.ndim == 2:
        std = [sqrt(max(v, 0.0)) for v in variances.tolist()]
        rows = (matrix[list(bare)]).tolist()
        # |F| σ bounds what is summed up.
        most = (sum(abs(f) * s for f, s in zip(row, std, strict=True)) for row in rows)
        if all(spread.item(i, i) > ROUNDING * m * m for i, m in zip(bare, most, strict=True)):
            return spread
    else:
        std = np.sqrt(np.maximum(variances, 0.0))
        for i in bare:
            most = np.einsum("jr,jr->r", np.abs(matrix[i]), std)
            if not (spread[i, i] > ROUNDING * most * most).all():
                break
        else:
            return spread
    size = np.abs(matrix)
    summed = np.einsum("ij...,jk...,ik...->i...", size, np.abs(cov), size)
    open_ = np.einsum("ii...->i...", spread) > ROUNDING * summed
    open_[[i for i in range(len(matrix)) if i not in bare]] = True
    return np.where(open_[:, None] & open_[None], spread, 0.0)


def extend(
    mean: Array,
    cov: Array,
    child: slice,
    parents: Index,
    matrix: Array,
    value: Array,
    noise: Array,
    bare: tuple[int, ...] = (),
) -> None:
    """Write the moments of a child y = F x + b + w into those of a joint that has room for it.

    `mean` (m, *batch) and `cov` (m, m, *batch) of the joint are changed in place at the components
    `child`; x is at the components `parents`. `value` (d, *batch) is the mean F E[x] + b of y,
    `matrix` F (d, number of parents, *batch) and `noise` (d, d, *batch) the covariance of w. `bare`
    are the places in y of its bare components: where the variance of such a component is no more
    than rounding, its variance and covariances become zero.
    """
    mean[child] = value
    if not matrix.shape[1]:
        cov[child, child] = noise
        return
    rows = cov[parents]
    cross = matrix.dot(rows) if cov.ndim == 2 else np.einsum("ijr,jkr->ikr", matrix, rows)
    own = predict(rows[:, parents], matrix, noise, bare)
    for i in bare:
        if not own[i, i].all():
            cross[i] = np.where(own[i, i] > 0.0, cross[i], 0.0)
    cov[child] = cross
    cov[:, child] = cross.swapaxes(0, 1)
    cov[child, child] = own


class Update(NamedTuple):
    """A belief N(mean, cov) given a measurement, and the measurement's log-density.

    mean: (n, *batch).
    cov: (n, n, *batch).
    log_density: (*batch); a measured component that the components before it determine adds
        nothing to it.
    regular: Whether S is not nearly singular: each of its pivots is at least 10⁻⁶ of its diagonal
        entry. A batch that `along_runs` has updated always counts as regular, although its pivots
        may be smaller if the measurement is mild or `update` was given a smaller limit, `least`.
    mild: Whether the measurement is known to shrink no variance more than a thousand times.
    left: The distance of each measured component that those before it determine from the value
        determined, and zero for all other components, (d, *batch); None if none is determined.
    """

    mean: Array
    cov: Array
    log_density: Array | float
    regular: bool
    mild: bool
    left: Array | None


def update(
    mean: Array,
    cov: Array,
    matrix: Array,
    residual: Array,
    noise: Array,
    out: tuple[Array, Array] | None = None,
    *,
    exact: bool = False,
    sharp: Array | None = None,
    least: float = NEARLY_SINGULAR,
) -> Update:
    """Condition N(mean, cov) on a measurement z = H x + v, v ~ N(0, noise), of residual z − H mean.

    The mean is m + G (z − H m), and the covariance (I − GH) P (I − GH)ᵀ + G noise Gᵀ, a sum of
    semidefinite terms, with the gain G = P Hᵀ S⁺ and S = H P Hᵀ + noise. `mean` is m (n, *batch),
    `cov` P (n, n, *batch), exactly symmetric, `residual` (d, *batch); of `matrix` H (d, n, *batch)
    and `noise` (d, d, *batch) the batch may be of length one.

    `out`, a mean and a covariance other than those given, may be overwritten with a batch's new
    moments. `exact` says that the noise may be singular: `moments` then computes the update, and
    tells zeros from rounding. `moments` also takes over where a pivot of S is at most 10⁻⁶ times
    its diagonal entry, or, for a batch, at most `least` times. `sharp` (runs or 1,) is the bound of
    det S below which a batch's measurements count as mild, shrinking no variance more than a
    thousand times; it is computed from the noise if None.
    """
    if not exact:
        if cov.ndim > 2:
            many = along_runs.update(
                mean, cov, matrix, residual, noise, out, sharp=sharp, least=least
            )
            if many is not None:
                return Update(many.mean, many.cov, many.log_density, True, many.mild, None)
        else:
            one = update_one(mean, cov, matrix, residual, noise)
            if one is not None:
                return Update(*one, True, False, None)
    parts = components_last(mean, 1), components_last(cov, 2), components_last(matrix, 2)
    found = moments.update(
        *parts, components_last(residual, 1), components_last(noise, 2), exact=exact
    )
    left = None if found.left is None else components_first(found.left, 1)
    after = components_first(found.mean, 1), components_first(found.cov, 2)
    regular = roots.smallest_pivot(found.lower) >= NEARLY_SINGULAR
    density = found.log_density if cov.ndim > 2 else float(found.log_density)
    return Update(*after, density, regular, False, left)


def update_one(
    mean: Array, cov: Array, matrix: Array, residual: Array, noise: Array
) -> tuple[Array, Array, float] | None:
    """Condition one Gaussian on a measurement: the new mean and covariance, and the log-density.

    They are (n,), (n, n) and a number. `mean` is m (n,), `cov` P (n, n), `matrix` H (d, n),
    `residual` z − H m (d,) and `noise` R (d, d). None if a pivot of S is at most 10⁻⁶ of its
    diagonal entry.
    """
    written = updating(len(mean), len(residual), NEARLY_SINGULAR)
    if written is not None:
        return written(mean, cov, matrix, residual, noise)
    cross = matrix.dot(cov)
    predictive = cross.dot(matrix.T)
    predictive += noise
    lower, gain, fault = _lapack().dposv(predictive, cross, 1)
    if fault:
        return None
    volume = 0.0
    for pivot, entry in zip(lower.diagonal().tolist(), predictive.diagonal().tolist(), strict=True):
        if not pivot * pivot > NEARLY_SINGULAR * entry:
            return None
        volume += log(pivot)
    white = _lapack().dtrtrs(lower, residual, 1)[0]
    gain = gain.T
    keep = np.eye(len(mean)) - gain.dot(matrix)
    posterior = keep.dot(cov).dot(keep.T)
    posterior += gain.dot(noise).dot(gain.T)
    log_density = -0.5 * (float(white.dot(white)) + len(residual) * LOG_2PI) - volume
    return mean + gain.dot(residual), symmetric(posterior), log_density
