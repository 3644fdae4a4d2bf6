"""The tail of importance weights: the shape of the generalised Pareto law that fits it."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array

# Weights that differ by no more than this part are equal but for rounding, and have no tail.
EQUAL = 1e-9
# Draws below which a tail has too few points to be fitted.
FEWEST = 25
# The smallest share of the largest weight that the quartile of a tail to be fitted has.
STEEP = 1e-12
# The part of the sum of weights below which the largest one is no tail's.
_SMALL = 0.01
# The prior of the shape: this many draws' worth of ½.
PRIOR = 10


def pareto_shape(log_weights: Array) -> Array:
    """The shape k of the generalised Pareto tail of weights, (runs,), from log-weights (runs, S).

    The excesses x are the M = min(S/5, 3√S) largest weights, each less the (M + 1)-th largest. The
    density (1 + k x/σ)^(−1/k − 1)/σ is fitted to them, by the posterior mean over a grid of the
    ratio −k/σ; k is then regularised towards ½. Moments of order below 1/k exist.

    Draws of discrete variables have equal weights: where a quarter of the M weights are equal to
    the (M + 1)-th but for rounding, excesses are counted from the next smaller weight, or from 0.

    The largest of S weights whose tail has the shape k is some S^(k − 1) of their sum: where it is
    less than a hundredth, k is ½ at the most, whatever the fit says of small excesses.

    k is NaN for fewer than 25 draws, −∞ where the largest weights are all equal, and ∞ where a few
    weights dwarf the rest: the lower quartile of the excesses is below 10⁻¹² of the largest.

    Source: Zhang & Stephens, A new and efficient estimation method for the generalized Pareto
    distribution, 2009; Vehtari, Simpson, Gelman, Yao & Gabry, Pareto smoothed importance sampling,
    2024.
    """
    runs, count = log_weights.shape
    if count < FEWEST:
        return np.full(runs, np.nan)
    size = int(min(count / 5, 3 * np.sqrt(count)))
    top = np.sort(np.partition(log_weights, count - size - 1, axis=-1)[:, count - size - 1 :])
    weights = np.exp(top - top[:, -1:])
    place = int(size / 4 + 0.5) - 1
    tied = top[:, 1 + place] - top[:, 0] <= EQUAL
    below = np.where(log_weights < top[:, :1] - EQUAL, log_weights, -np.inf).max(axis=-1)
    least = np.where(
        tied & (top[:, -1] > top[:, 0] + EQUAL), np.exp(below - top[:, -1]), weights[:, 0]
    )
    excess = weights[:, 1:] - least[:, None]
    equal = excess[:, -1] <= EQUAL
    steep = ~equal & (excess[:, place] <= STEEP * excess[:, -1])
    excess[equal | steep] = np.arange(1, size + 1) / size  # these are not fitted
    quartile, largest = excess[:, place], excess[:, -1]
    grid = 30 + int(np.sqrt(size))
    ratios = (1.0 - np.sqrt(grid / (np.arange(grid)[:, None] + 0.5))) / (3.0 * quartile)
    ratios = ratios + 1.0 / largest
    shapes = np.array([np.log1p(-ratio[:, None] * excess).mean(axis=-1) for ratio in ratios])
    likelihood = size * (np.log(-ratios / shapes) - shapes - 1.0)
    share = np.exp(likelihood - likelihood.max(axis=0))
    ratio = (ratios * share).sum(axis=0) / share.sum(axis=0)
    shape = np.log1p(-ratio[:, None] * excess).mean(axis=-1)
    shape = (size * shape + 0.5 * PRIOR) / (size + PRIOR)
    shape = np.where(equal, -np.inf, np.where(steep, np.inf, shape))
    largest = 1.0 / np.exp(log_weights - top[:, -1:]).sum(axis=-1)
    return np.where(largest < _SMALL, np.minimum(shape, 0.5), shape)
