"""Drawing particles anew in proportion to their weights.

Each resampling function takes weights (n,), which need not sum to one, the number `count` of draws
and a generator, and returns how often each particle is drawn, (n,): whole numbers that sum to
`count`, zero where the weight is zero. All are unbiased, E[counts_i] = count · w_i / Σ w; the
variance of systematic draws is least in most uses, that of multinomial draws largest (Douc, Cappé &
Moulines, 2005).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from pgm.kernels.arrays import Array, Integers

# Above one by more than rounding takes from a weight, and by less than anyone would miss.
_SHORT = 1.0 + 2.0**-40

Resampler = Callable[[Array, int, np.random.Generator], Integers]


def systematic(weights: Array, count: int, rng: np.random.Generator) -> Integers:
    """Systematic resampling: `count` evenly spaced levels with one random offset.

    A particle of weight w is drawn count · w / Σ w times, rounded down or up. Source: Madow, On
    the theory of systematic sampling, 1949; the low variance sampler of Thrun, Burgard & Fox,
    Probabilistic Robotics, 2005, table 4.4.
    """
    edges = _edges(weights, count)
    edges -= rng.random()
    return _between(np.ceil(edges))


def stratified(weights: Array, count: int, rng: np.random.Generator) -> Integers:
    """Stratified resampling: one random number in each of `count` equal strata (Kitagawa 1996)."""
    edges = _edges(weights, count)
    # Edge e leaves below it the strata that end before it, and its own where its number is lower.
    stratum = np.minimum(edges.astype(np.intp), count - 1)
    level = rng.random(count)
    return _between(stratum + (level[stratum] < edges - stratum))


def residual(weights: Array, count: int, rng: np.random.Generator) -> Integers:
    """Residual resampling: ⌊count · w / Σ w⌋ copies of each particle, and independent draws.

    The draws that are still missing are made in proportion to the fractional parts of
    count · w / Σ w (Liu & Chen 1998).
    """
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
    """Multinomial resampling: `count` independent draws, each with probabilities w / Σ w."""
    edges = _edges(weights, count)
    levels = np.sort(rng.random(count)) * count
    below = np.nextafter(float(count), 0.0)  # a product may round up to the last edge
    return _between(np.searchsorted(np.minimum(levels, below), edges))


def indices(counts: Integers) -> Integers:
    """The index of each draw's particle, ascending, from counts (n,): (2, 0, 1) gives 0, 0, 2."""
    return np.repeat(np.arange(len(counts)), counts)


SYSTEMATIC = "systematic"
RESAMPLERS: Mapping[str, Resampler] = MappingProxyType(
    {
        SYSTEMATIC: systematic,
        "stratified": stratified,
        "residual": residual,
        "multinomial": multinomial,
    }
)


def _edges(weights: Array, count: int) -> Array:
    """The cumulative weights (n,), scaled so that the last is exactly `count`."""
    edges = np.cumsum(weights, dtype=np.float64)
    edges /= edges[-1]
    edges *= count
    return edges


def _between(below: Array | Integers) -> Integers:
    """How many draws each of n particles gets, (n,).

    `below` (n,) has, for each particle, how many draws fall to it and to all particles before it:
    those below its upper edge, the cumulative weight up to and with this particle.
    """
    ends, counts = below.astype(np.intp), np.empty(len(below), dtype=np.intp)
    counts[:1] = ends[:1]
    np.subtract(ends[1:], ends[:-1], out=counts[1:])
    return counts
