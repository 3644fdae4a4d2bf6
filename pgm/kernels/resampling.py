r"""Drawing particles anew in proportion to their weights, and how many draws suffice.

All of these are unbiased, E[counts_i] = count · w_i; the variance of systematic draws is least in
most uses, that of multinomial ones largest (Douc, Cappé & Moulines, 2005).

Of n draws from k bins the statistic S = 2 n KL(empirical ‖ true) is χ² of k − 1 degrees of freedom
for many draws a bin (Wilks 1938): with n = χ²_{k−1, 1−δ} / (2 ε) the divergence is at most ε with
probability 1 − δ (Fox, 2003). Where bins have a few draws each, S is larger: a Poisson count X
about λ adds 2 (X ln(X / λ) − X + λ), of mean and variance at most 1.1605 and 2.406. The quantile
taken here is that of a gamma distribution with (k − 1) times these, so that the probability holds
for any distribution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from pgm.kernels.arrays import TURN, Array, Integers, Mask

# Above one by more than rounding takes from a weight, and by less than anyone would miss.
_SHORT = 1.0 + 2.0**-40

Resampler = Callable[[Array, int, np.random.Generator], Integers]


def systematic(weights: Array, count: int, rng: np.random.Generator) -> Integers:
    """One random number for a comb of equal distances; counts are ⌊·⌋ or ⌈·⌉ of count · w.

    Zero where the weight is; weights need not sum to one. Madow, On the theory of systematic
    sampling, 1949; the low variance sampler of Thrun, Burgard & Fox, Probabilistic Robotics, 2005,
    table 4.4.
    """
    edges = _edges(weights, count)
    edges -= rng.random()
    return _between(np.ceil(edges))


def stratified(weights: Array, count: int, rng: np.random.Generator) -> Integers:
    """One random number in each of equal strata (Kitagawa 1996); as of `systematic`."""
    edges = _edges(weights, count)
    # Edge e leaves below it the strata that end before it, and its own where its number is lower.
    stratum = np.minimum(edges.astype(np.intp), count - 1)
    level = rng.random(count)
    return _between(stratum + (level[stratum] < edges - stratum))


def residual(weights: Array, count: int, rng: np.random.Generator) -> Integers:
    """⌊count · w⌋ of each, the rest drawn from what is left, independently (Liu & Chen 1998)."""
    expected = count * (weights / weights.sum(dtype=np.float64))
    # Whole numbers that rounding left a little short are whole: else equal weights, which are to be
    # drawn once each, would all be left to chance.
    whole = np.floor(expected * _SHORT).astype(np.intp)
    missing = count - int(whole.sum())
    if missing > 0:
        left = np.maximum(expected - whole, 0.0)
        if not left.any():  # rounding alone has kept the sum below the count
            left = expected
        whole += multinomial(left, missing, rng)
    elif missing < 0:  # rounding alone has taken it above
        whole -= systematic(whole.astype(np.float64), -missing, rng)
    found: Integers = whole
    return found


def multinomial(weights: Array, count: int, rng: np.random.Generator) -> Integers:
    """Independent draws; as of `systematic`."""
    edges = _edges(weights, count)
    levels = np.sort(rng.random(count)) * count
    below = np.nextafter(float(count), 0.0)  # a product may round up to the last edge
    return _between(np.searchsorted(np.minimum(levels, below), edges))


def indices(counts: Integers) -> Integers:
    """The place of each draw, ascending: each as often as its count."""
    return np.repeat(np.arange(len(counts)), counts)


RESAMPLERS: Mapping[str, Resampler] = MappingProxyType(
    {
        "systematic": systematic,
        "stratified": stratified,
        "residual": residual,
        "multinomial": multinomial,
    }
)


def _edges(weights: Array, count: int) -> Array:
    edges = np.cumsum(weights, dtype=np.float64)
    edges /= edges[-1]
    edges *= count
    return edges


def _between(below: Array | Integers) -> Integers:
    ends, counts = below.astype(np.intp), np.empty(len(below), dtype=np.intp)
    counts[:1] = ends[:1]
    np.subtract(ends[1:], ends[:-1], out=counts[1:])
    return counts


# Bins further from zero than this would not be told apart by float64.
_FARTHEST = 2.0**52
# Largest mean and variance of a bin's part of the statistic, over all expected counts.
_MEAN, _VARIANCE = 1.1605, 2.406


def draws_needed(bins: int, epsilon: float, delta: float) -> int:
    """The number of draws that a distribution over so many occupied bins needs; 1 of a single bin.

    Its divergence is then at most `epsilon` nats but for a probability `delta`.
    """
    if bins <= 1:
        return 1
    # Here, since it is half of the time that importing pgm takes.
    from scipy.special import gammainccinv

    scale = _VARIANCE / _MEAN
    quantile = scale * float(gammainccinv((bins - 1) * _MEAN / scale, delta))
    return math.ceil(quantile / (2.0 * epsilon))


def keys(points: Array, widths: Array, angles: Mask) -> Integers | None:
    """The bin of each point (d, n) along each axis, (d, n); None where one is too far from zero."""
    scaled = np.asarray(points, dtype=np.float64) / widths[:, None]
    for k in np.flatnonzero(angles):
        round_ = max(round(TURN / widths[k]), 1)
        scaled[k] = (points[k] % TURN) * (round_ / TURN)
        scaled[k] -= round_ * (scaled[k] >= round_)
    if not (np.abs(scaled) < _FARTHEST).all():
        return None
    return np.floor(scaled).astype(np.int64)


def occupied(bins: Integers) -> int:
    """How many different bins (d, n) there are."""
    low = bins.min(axis=1, keepdims=True)
    spans = [int(span) for span in (bins.max(axis=1) - low[:, 0] + 1)]
    if math.prod(spans) < 2**62:
        number = np.zeros(bins.shape[1], dtype=np.int64)
        for row, span in zip(bins - low, spans, strict=True):
            number = number * span + row
        return len(np.unique(number))
    return int(np.unique(bins, axis=1).shape[1])
