r"""A bound of the rounding in smoothed covariances, for the test whether float64 has digits enough.

Bayes' rule reverses a transition y = A x + c + n, n ~ N(0, Q), from a slice x (the vector of all
hidden variables of a step) to the next slice y, with the gain G = P Aᵀ P_y⁻¹, and the backward pass
finds

    P′ = (1 − G A) P (1 − G A)ᵀ + G (Q + P_y′) Gᵀ

from the smoothed P_y′; P is the covariance of the filtered x, P_y that of the predicted y. The
formula subtracts nothing, and its value is the least that any gain gives as long as the later
measurements say nothing (P_y′ = P_y). An error δG of the gain still changes it by δG P_y′ Gᵀ and
the transpose. With the standard deviations σ under P, σ_Q under Q and σ_y′ under P_y′, rounding by
ε = 2.2·10⁻¹⁶ changes P Aᵀ by ε σ aᵀ and P_y = A P Aᵀ + Q by ε a aᵀ, a = |A| σ + σ_Q, hence G by up
to ε g aᵀ |P_y⁻¹|, g = σ + |G| a: much, where components of y hardly vary given all others, as with
a motion whose noise has few directions. The other ratios of that test (`certificate`) compare a
variance with that given the components *before* it alone, and do not show this.

The error of P′ is bounded by E in the order of semidefinite matrices. Errors go back as covariances
do: with the bound E_y for P_y′,

    E = G E_y Gᵀ + ε diag(τ g² + w²/τ + (|G| σ_y′)² + σ²),    wᵀ = aᵀ |P_y⁻¹ P_y′ Gᵀ|,

for any τ > 0, since 2 |u v| ≤ τ u² + v²/τ. With correlations C of P_y the term that a step adds is
at most some ε (tr C⁻¹)² of P in that order, and as G P_y Gᵀ ≤ P, it never grows in units of P: the
sum over the later steps is a bound that costs little, and where it is enough the sweep need not be
made. The steps are 0..T.
"""

from __future__ import annotations

import numpy as np

from pgm.inference.chain.backward import between_slices
from pgm.inference.chain.plan import ChainPlan
from pgm.kernels import along_runs
from pgm.kernels.arrays import (
    Array,
    Integers,
    Mask,
    apply,
    deviation,
    multiply,
    sandwich,
    transpose,
    variances,
)
from pgm.kernels.moments import Conditional

_EPS = float(np.finfo(np.float64).eps)
# The part of a smoothed variance that rounding may be.
TOLD = 1e-7
# Numbers of covariances that are looked at together.
_CHUNK = 1 << 16


def keeps_digits(plan: ChainPlan, predicted: Array, known: Array, smoothed: Array) -> bool:
    """Whether the bound of rounding is at most 10⁻⁷ of every smoothed variance.

    Parameters
    ----------
    plan : ChainPlan
        As it was linearised for the pass.
    predicted, known, smoothed : ndarray
        Covariances of the slices (T+1, runs, n, n): before the measurements of their steps, after
        them, and given all.
    """
    if len(predicted) < 2 or predicted.shape[-1] < 2:
        return True
    left, before = variances(smoothed[:-1]), variances(known[:-1])
    fallen = np.where(left > 0.0, before / np.where(left > 0.0, left, 1.0), 1.0).max(axis=-1)
    added = accumulated(predicted)
    doubtful = ~(added * fallen <= TOLD)
    if not doubtful.any():
        return True
    try:
        return _swept(between_slices(plan), predicted, known, smoothed, added, doubtful) <= TOLD
    except np.linalg.LinAlgError:  # of a covariance that is singular in float64
        return False


def accumulated(predicted: Array) -> Array:
    """A bound of the rounding at a step and all later ones, as a share of P, (T, runs).

    Row t sums ε (tr C⁻¹)² over the predicted covariances of the steps after t, C being their
    correlations. `predicted` is (T+1, runs, n, n).
    """
    steps, runs, size = len(predicted) - 1, *predicted.shape[1:3]
    added = np.empty((steps, runs))
    length = max(_CHUNK // (runs * size * size), 1)
    for first in range(0, steps, length):
        rows = slice(first, min(first + length, steps))
        last = np.array(np.moveaxis(predicted[1:][rows], (-2, -1), (0, 1)), order="C")
        added[rows] = along_runs.inflation(last.reshape(size, size, -1)).reshape(-1, runs)
    added *= added
    return _EPS * np.cumsum(added[::-1], axis=0)[::-1]


def _swept(
    moves: Conditional,
    predicted: Array,
    known: Array,
    smoothed: Array,
    added: Array,
    doubtful: Mask,
) -> float:
    """The largest ratio of the bound E to a smoothed variance, by a sweep back over the steps.

    It is infinite as soon as one exceeds 10⁻⁷. `added` (T, runs) is the bound that costs little:
    the rounding of a step and all later ones, as a share of P. `doubtful` (T, runs) marks where it
    comes to more than 10⁻⁷ of a smoothed variance. Only runs with such a step are swept, from the
    last of these steps back; after that step E is the cheap bound. `moves` are the transitions
    between slices, (T, runs, ...). `predicted`, `known` and `smoothed` (T+1, runs, n, n) are the
    slices' covariances before the measurements of their steps, after them, and given all.
    """
    runs, size = np.flatnonzero(doubtful.any(axis=0)), predicted.shape[-1]
    end = int(np.flatnonzero(doubtful.any(axis=1))[-1]) + 1
    error, worst = np.zeros((runs.size, size, size)), 0.0
    if end < len(added):
        error = added[end, runs, None, None] * known[end, runs]
    length = max(_CHUNK // (runs.size * size * size), 1)
    for last in range(end, 0, -length):
        rows, after = (slice(max(last - length, 0) + k, last + k) for k in (0, 1))
        gain, more = injected(
            _some(moves.matrix, rows, runs),
            _some(moves.cov, rows, runs),
            predicted[after][:, runs],
            known[rows][:, runs],
            smoothed[after][:, runs],
        )
        left = variances(smoothed[rows][:, runs])
        left = np.where(left > 0.0, left, np.inf)
        for row in reversed(range(len(left))):
            error = sandwich(gain[row], error)
            np.einsum("...ii->...i", error)[...] += more[row]
            worst = max(worst, float((variances(error) / left[row]).max(initial=0.0)))
            if not worst <= TOLD:
                return np.inf
    return worst


def _some(part: Array, rows: slice, runs: Integers) -> Array:
    """The steps `rows` and the runs `runs` of an array (steps or 1, runs or 1, ...).

    An axis of length one stands for all steps or runs, and stays as it is.
    """
    part = part[rows] if len(part) > 1 else part
    return part[:, runs] if part.shape[1] > 1 else part


def injected(
    matrix: Array, noise: Array, predicted: Array, known: Array, later: Array
) -> tuple[Array, Array]:
    """The gains G (..., n, n) of slices given the ones after, and what they add to E, (..., n).

    The second result is the diagonal of ε diag(...) in E, with the τ at which its first two terms
    count equally. `matrix` and `noise` are A and Q, `known` is P of the slice, and `predicted` and
    `later` are P_y and P_y′ of the one after, all (..., n, n).
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
    # The τ at which both count as much, in whatever units.
    unit = np.where(own > 0.0, own, 1.0)
    balance = np.linalg.norm(pulled / unit, axis=-1) / np.linalg.norm(moved / unit, axis=-1)
    balance = np.where((balance > 0.0) & np.isfinite(balance), balance, 1.0)[..., None]
    lost = balance * moved**2 + pulled**2 / balance + apply(size, after) ** 2 + own**2
    return gain, _EPS * lost
