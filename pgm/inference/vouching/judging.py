r"""How far a mixture is from the exact posterior, as weighed draws tell.

p is the exact posterior of all hidden variables, q the mixture of modes, y = p/r the weights of
draws from the mixtures r of all rounds. With u = p/q, and ln Ẑ from all draws,

.. math:: KL(p ‖ q) = E_q[u \ln u - u + 1]

bounds the divergence of every marginal. It is estimated by the last round alone, whose draws have
not made q what it is; every term is positive, and near zero where p is near q. Its bound is ∞ if
the tail of weights is heavy, also if these are small: a hundredth of the mass may be a tenth of a
nat.

The error of moments is estimated by the block jackknife of the plain weighed moments m, without
control variates: J = (B − 1)/B Σ_b KL(m ‖ m₋ᵇ), with all but the b-th of B blocks in m₋ᵇ. That of
controlled moments is smaller, and its own jackknife is not to be trusted where few draws weigh.
There a control variate may be far off: where m is further from the controlled moments than from the
exact ones, by its bound, the answer has m.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.beliefs.modes.adapted import corrected, uncorrected
from pgm.beliefs.modes.laws import Laws, Scoped
from pgm.beliefs.modes.pool import BLOCKS, Pool, Weighed
from pgm.kernels import roots
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Mask, block, symmetric, transpose
from pgm.kernels.divergence import from_gaussian
from pgm.kernels.mahalanobis import square_within
from pgm.kernels.pareto import pareto_shape
from pgm.posteriors.verdict import HEAVY

# What is estimated of moments' error is taken so many times; any error has so much added, nats that
# neither matter nor can be told by draws.
CAUTION, FLOOR = 1.5, 0.001
# The probability with which a bound holds, and the standard errors of it.
SURE, ERRORS = 0.95, 2.0
# The probability within which noises are larger than a model says.
NEVER = 1.0 - 1e-6


class Marginal(NamedTuple):
    """The moments of a variable at its steps, (steps, runs, d) and (steps, runs, d, d)."""

    mean: Array
    cov: Array


class Judged(NamedTuple):
    """The judgement of a mixture by its draws, by run.

    laws: The mixture with the moments that the draws estimate.
    density: A bound on KL(p ‖ q) of all variables [nats], (runs,).
    moments: A bound on the divergence of the worst marginal's moments [nats], (runs,).
    effective: The effective number of draws.
    pareto_k: The shape of the tail of their weights.
    log_evidence: ln Ẑ.
    marginals: The moments of each variable under `laws`.
    unlikely: Whether noises are larger, by the draws, than they are once in a million.
    """

    laws: Laws
    density: Array
    moments: Array
    effective: Array
    pareto_k: Array
    log_evidence: Array
    marginals: list[Marginal]
    unlikely: Mask


def judge(pool: Pool, laws: Laws, before: list[Marginal] | None) -> Judged:
    """Judge the mixture of laws from which the last round of draws is.

    `before` are the marginals that fewer draws gave, by the same variables; None if none did.
    """
    weighed = Weighed(pool, laws)
    better = corrected(pool, laws, weighed)
    scopes, angles = pool.target.scopes, pool.target.angles
    marginals = [marginal(better, scope, angles) for scope in scopes]
    off = np.zeros(weighed.effective.shape)
    wrong = np.full(off.shape, False)
    for scope, own in zip(scopes, marginals, strict=True):
        size = own.mean.shape[-1]
        free = np.array(size * (size + 3) // 2)
        error, apart = _jackknife(pool, weighed, scope, own)
        likely = error * square_within(SURE, free) / free
        wrong |= ~(apart <= CAUTION * likely + FLOOR)
        off = np.maximum(off, likely)
    if wrong.any():
        runs = np.flatnonzero(wrong)
        better = better.put(runs, uncorrected(pool, laws, weighed).of(runs))
        marginals = [marginal(better, scope, angles) for scope in scopes]
    if before is not None:
        for scope, own, old in zip(scopes, marginals, before, strict=True):
            off = np.maximum(off, worst(own, old, angles[scope.places]))
    return Judged(
        better,
        _density(pool, weighed),
        CAUTION * off + FLOOR,
        weighed.effective,
        pareto_shape(weighed.log_weights),
        weighed.log_evidence,
        marginals,
        _unlikely(pool, weighed),
    )


def _unlikely(pool: Pool, weighed: Weighed) -> Mask:
    """Whether all noises together are larger than they are once in a million, (runs,)."""
    peak = pool.target.peak
    if peak is None:
        return np.full(weighed.effective.shape, False)
    some = weighed.weights > 0.0
    total = np.where(some, weighed.weights * np.where(some, pool.log_target, 0.0), 0.0).sum(axis=1)
    square = 2.0 * (peak.log_density - total / weighed.weights.sum(axis=1))
    return np.asarray(square > square_within(NEVER, peak.size))


def _density(pool: Pool, weighed: Weighed) -> Array:
    """A bound on KL(p ‖ q), (runs,): its estimate, two standard errors, and the floor."""
    last = slice(pool.count - pool.rounds[-1].count, None)
    log_proposal = pool.log_proposal(last=True)[:, last]
    log_mixture = weighed.log_mixture[:, last]
    log_exact = pool.log_target[:, last] - weighed.log_evidence[:, None]
    exact, own = np.exp(log_exact - log_proposal), np.exp(log_mixture - log_proposal)
    logs = np.where(exact > 0.0, log_exact - log_mixture, 0.0)
    terms = exact * logs - exact + own
    error: Array = terms.std(axis=1) / np.sqrt(terms.shape[1])
    heavy = pareto_shape(weighed.log_weights, of_sums=False) > HEAVY
    return np.where(heavy, np.inf, terms.mean(axis=1) + ERRORS * error + FLOOR)


def marginal(laws: Laws, scope: Scoped, angles: Mask) -> Marginal:
    """The moments of a variable under a mixture of laws."""
    parts = []
    if not scope.first:
        parts.append((laws.first[..., scope.start], block(laws.spread, scope.start, scope.start)))
    if laws.mean.shape[1]:
        places = scope.places
        parts.append((laws.mean[..., places], block(laws.cov, places, places)))
    mean, cov = (np.concatenate(each, axis=1) for each in zip(*parts, strict=True))
    centre = mean[laws.weights.argmax(axis=0), :, np.arange(mean.shape[2])].swapaxes(0, 1)
    off = difference(mean, centre, angles[scope.places])
    weights = laws.weights[:, None, :, None]
    shift = (weights * off).sum(axis=0)
    off = off - shift
    spread = cov + off[..., :, None] * off[..., None, :]
    return Marginal(centre + shift, (weights[..., None] * spread).sum(axis=0))


def worst(own: Marginal, other: Marginal, angles: Mask) -> Array:
    """The largest divergence of a marginal's moments from others at any step, (runs,)."""
    off = difference(own.mean, other.mean, angles)
    return np.asarray(from_gaussian(roots.root(other.cov), off, own.cov).max(axis=0))


def _jackknife(pool: Pool, weighed: Weighed, scope: Scoped, about: Marginal) -> tuple[Array, Array]:
    """The largest block jackknife of a variable's plain moments at any step, (runs,).

    And the largest divergence of these from the moments `about`.
    """
    angles = pool.target.angles[scope.places]
    values = pool.values[1:][..., scope.places]
    if not scope.first:
        start = pool.values[:1][..., pool.target.before :][..., pool.target.states]
        values = np.concatenate([start[..., scope.start], values])
    off = difference(values, about.mean[:, :, None], angles)
    steps, runs, count, size = off.shape
    off = off.reshape(steps, runs, count // BLOCKS, BLOCKS, size).swapaxes(2, 3)
    weights = weighed.weights.reshape(runs, count // BLOCKS, BLOCKS).swapaxes(1, 2)
    mass = weights.sum(axis=-1)
    weighted = off * weights[..., None]
    shift, square = weighted.sum(axis=3), transpose(weighted) @ off

    def moments(total: Array, first: Array, second: Array) -> tuple[Array, Array]:
        mean = first / total[..., None]
        cov = second / total[..., None, None] - mean[..., :, None] * mean[..., None, :]
        return mean, symmetric(cov)

    whole = moments(mass.sum(axis=1), shift.sum(axis=2), square.sum(axis=2))
    rest = moments(
        mass.sum(axis=1, keepdims=True) - mass,
        shift.sum(axis=2, keepdims=True) - shift,
        square.sum(axis=2, keepdims=True) - square,
    )
    divergence = from_gaussian(
        roots.root(rest[1]), whole[0][:, :, None] - rest[0], whole[1][:, :, None]
    )
    found: Array = (BLOCKS - 1) / BLOCKS * divergence.sum(axis=-1)
    apart = from_gaussian(roots.root(about.cov), *whole)
    error, off = (np.where(np.isfinite(each), each, np.inf) for each in (found, apart))
    return np.asarray(error.max(axis=0)), np.asarray(off.max(axis=0))
