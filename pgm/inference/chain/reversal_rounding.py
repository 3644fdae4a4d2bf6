r"""A bound of the rounding in smoothed covariances, for the certificate.

Bayes' rule reverses a transition y = A x + c + n, n ~ N(0, Q), with the gain G = P Aᵀ P_y⁻¹, and
the backward pass finds

    P′ = (1 − G A) P (1 − G A)ᵀ + G (Q + P_y′) Gᵀ

from the smoothed P_y′. It subtracts nothing, and is the least that any gain gives as long as the
later measurements say nothing (P_y′ = P_y). An error of the gain still changes it by
δG P_y′ Gᵀ and the transpose. With deviations σ, rounding changes P Aᵀ by ε σ aᵀ and
P_y = A P Aᵀ + Q by ε a aᵀ, a = |A| σ + σ_Q, hence G by up to ε g aᵀ |P_y⁻¹|, g = σ + |G| a: much, where
components of y hardly vary given all others, as with a motion whose noise has few directions. The
certificate's shares are of the components *before* each one, and do not tell.

Errors go back as covariances do, in the order of semidefinite matrices:

    E = G E_y Gᵀ + ε diag(τ g² + w²/τ + (|G| σ_y′)² + σ²),    wᵀ = aᵀ |P_y⁻¹ P_y′ Gᵀ|,

for any τ > 0, since 2 |u v| ≤ τ u² + v²/τ. As G P_y Gᵀ ≤ P, errors in units of P never grow: with a
correlation matrix C of P_y the variance of a component given all others is at least det C of its
own, and Σ 1/det C over the later steps, times P/P′, is a bound that costs next to nothing.
"""

from __future__ import annotations

import numpy as np

from pgm.inference.chain.backward import between_slices
from pgm.inference.chain.plan import ChainPlan
from pgm.kernels import along_runs
from pgm.kernels.arrays import Array, apply, deviation, multiply, sandwich, transpose, variances
from pgm.kernels.elements import gather
from pgm.kernels.moments import Conditional

_EPS = float(np.finfo(np.float64).eps)
# The part of a smoothed variance that rounding may be. The sweep's bound is some 40 times what
# is lost where much is lost, so that six digits are right by far; the quick one may be a little
# short of it.
_TOLD, _QUICK = 1e-6, 1e-8
# Numbers of covariances that are bounded at a time.
_CHUNK = 1 << 16


def keeps_digits(
    plan: ChainPlan, predicted: Array, known: Array, smoothed: Array, closest: float
) -> bool:
    """Whether rounding is a small part of smoothed variances.

    Parameters
    ----------
    plan : ChainPlan
        As it was linearised for the pass.
    predicted, known, smoothed : ndarray
        Covariances of the slices (T+1, runs, n, n), before and after the measurements of their
        steps, and given later ones.
    closest : float
        The smallest share of a predicted variance that the components before it leave open, or 0
        where nothing has watched.
    """
    steps, _, size = predicted.shape[:3]
    if steps < 2 or size < 2:
        return True
    left, before = variances(smoothed[:-1]), variances(known[:-1])
    fallen = np.where(left > 0.0, before / np.where(left > 0.0, left, 1.0), 1.0)
    if closest > 0.0:
        worst = steps * closest ** (1 - size) * float(fallen.max(initial=1.0))
        if _EPS * worst <= _QUICK:
            return True
    if _quick(predicted, fallen.max(axis=-1)) <= _QUICK:
        return True
    try:
        return _swept(between_slices(plan), predicted, known, smoothed) <= _TOLD
    except np.linalg.LinAlgError:  # of a covariance that is singular in float64
        return False


def _quick(predicted: Array, fallen: Array) -> float:
    """The largest ε (Σ 1/det C over the steps after each) P/P′, of all steps and runs."""
    last = np.array(np.moveaxis(predicted[1:], (-2, -1), (0, 1)))
    shares = along_runs.open_shares(last.reshape(*last.shape[:2], -1))
    with np.errstate(divide="ignore"):
        lost = 1.0 / np.maximum(shares.prod(axis=0), 0.0).reshape(fallen.shape)
    total = np.cumsum(lost[::-1], axis=0)[::-1]
    return _EPS * float((total * fallen).max(initial=0.0))


def _swept(moves: Conditional, predicted: Array, known: Array, smoothed: Array) -> float:
    """The largest share of a smoothed variance that the bound E comes to, going back."""
    steps, runs, size = len(predicted) - 1, predicted.shape[1], predicted.shape[-1]
    error, worst = np.zeros(known.shape[1:]), 0.0
    length = max(_CHUNK // (runs * size * size), 1)
    for last in range(steps, 0, -length):
        rows = slice(max(last - length, 0), last)
        here = np.arange(steps + 1)[rows]
        parts = (
            gather(moves.matrix, here) if len(moves.matrix) == steps else moves.matrix,
            gather(moves.cov, here) if len(moves.cov) == steps else moves.cov,
        )
        gain, added = injected(*parts, predicted[here + 1], known[here], smoothed[here + 1])
        left = variances(smoothed[here])
        for row in reversed(range(len(here))):
            error = sandwich(gain[row], error)
            np.einsum("...ii->...i", error)[...] += added[row]
            part = variances(error) / np.where(left[row] > 0.0, left[row], np.inf)
            worst = max(worst, float(part.max(initial=0.0)))
            if not worst <= _TOLD:
                return np.inf
    return worst


def injected(
    matrix: Array, noise: Array, predicted: Array, known: Array, later: Array
) -> tuple[Array, Array]:
    """The gain G (..., n, n) on the slice after, and the diagonal of ε diag(...), (..., n).

    Of transitions A (..., n, n) with their noise Q, the slices' P and P_y, and P_y′ given later
    measurements.
    """
    spread, own, after = deviation(predicted), deviation(known), deviation(later)
    unit = np.where(spread > 0.0, spread, 1.0)
    scale = unit[..., :, None] * unit[..., None, :]
    correlation = predicted / scale
    np.einsum("...ii->...i", correlation)[...] = 1.0
    inverse = np.linalg.inv(correlation) / scale
    gain = multiply(multiply(known, transpose(matrix)), inverse)
    size = np.abs(gain)
    summed = apply(np.abs(matrix), own) + deviation(noise)
    moved = own + apply(size, summed)
    weight = np.abs(multiply(multiply(inverse, later), transpose(gain)))
    pulled = apply(transpose(weight), summed)
    # The τ at which both count as much.
    balance = np.linalg.norm(pulled, axis=-1) / np.linalg.norm(moved, axis=-1)
    balance = np.where((balance > 0.0) & np.isfinite(balance), balance, 1.0)[..., None]
    lost = balance * moved**2 + pulled**2 / balance + apply(size, after) ** 2 + own**2
    return gain, _EPS * lost
