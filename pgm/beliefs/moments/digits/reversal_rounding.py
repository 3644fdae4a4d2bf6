r"""A bound of the rounding in smoothed covariances, for the test whether float64 has digits enough.

Let x be the slice of a step, the vector of all its hidden variables, and y the next slice; the
steps are 0..T. The transition is y = A x + c + noise. The symbols are:

- Q, the covariance of the transition's noise;
- P, the covariance of x given the measurements up to its step, and P′ that given all measurements;
- P_y, the covariance of y given the measurements before its step, and P_y′ that given all;
- G = P Aᵀ P_y⁻¹, the gain, by which Bayes' rule reverses the transition;
- σ, σ_Q and σ_y′, the vectors of standard deviations under P, Q and P_y′;
- ε = 2.2·10⁻¹⁶, the relative rounding of float64.

Absolute values |·| and squares of vectors are taken entry by entry. The backward pass finds

    P′ = (1 − G A) P (1 − G A)ᵀ + G (Q + P_y′) Gᵀ.

This subtracts no covariances, but an error δG of the gain changes P′ by δG P_y′ Gᵀ and its
transpose. How large is δG? With a = |A| σ + σ_Q, rounding changes P Aᵀ by up to ε σ aᵀ, and
P_y = A P Aᵀ + Q by up to ε a aᵀ. Hence it changes G by up to ε g aᵀ |P_y⁻¹|, with g = σ + |G| a.
That is much where components of y hardly vary given all others, as with a motion whose noise has
few directions. The other tests of digits (`certificate`) compare a variance with that given the
components *before* it alone, and do not show this.

The error of P′ is bounded by E, and that of P_y′ by E_y, in the order of semidefinite matrices. An
error of P_y′ goes back as P_y′ itself does, and the rounding at x is added to it:

    E = G E_y Gᵀ + ε diag(τ g² + w²/τ + (|G| σ_y′)² + σ²),    wᵀ = aᵀ |P_y⁻¹ P_y′ Gᵀ|.

The first two terms of the diagonal are for δG, and hold for any number τ > 0, since
2 |u v| ≤ τ u² + v²/τ for all numbers u and v. The other two are for the rounding of the summands of
P′ themselves.

A bound that costs less is tried first. With the correlation matrix C of P_y, a step adds to E at
most about ε (tr C⁻¹)² P, in the order of semidefinite matrices. As a share of P that does not grow
when it is carried back, as G P_y Gᵀ ≤ P. So the sum of these shares over all later steps bounds E,
and where it is small enough the sweep back that finds E itself need not be made.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.moments.passes.backward import between_slices
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels import shares
from pgm.kernels.arrays import (
    Array,
    Integers,
    Mask,
    apply,
    components_first,
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

    False also where correlations of a predicted slice are singular in float64, which leaves no
    bound.

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
        together = np.ascontiguousarray(components_first(predicted[1:][rows], 2))
        added[rows] = shares.inflation(together)
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

    The result is infinite as soon as one ratio exceeds 10⁻⁷. `added` (T, runs) is the cheap bound:
    the rounding of a step and all later ones, as a share of P. `doubtful` (T, runs) marks where
    this bound is more than 10⁻⁷ of a smoothed variance. Only runs with a marked step are swept,
    from the last marked step of any run back; after that step E is the cheap bound.

    `moves` are the transitions between slices, (T, runs, ...). `predicted`, `known` and `smoothed`
    (T+1, runs, n, n) are the slices' covariances before the measurements of their steps, after
    them, and given all.
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
    """The gains G (..., n, n) of slices x, and the diagonals (..., n) that rounding adds to E.

    Such a diagonal is ε (τ g² + w²/τ + (|G| σ_y′)² + σ²), with the τ at which the first two terms
    are of equal size. The arguments are (..., n, n): `matrix` is A and `noise` Q; `known` is P of
    the slice x; `predicted` and `later` are P_y and P_y′ of the slice y after it.
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
