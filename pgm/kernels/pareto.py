r"""The tail of importance weights: the generalised Pareto law that fits it, and smooths it.

The weights of S draws often have a few that decide all. Those above a threshold u follow

.. math:: p(w) = \frac{1}{σ} \Big(1 + k \frac{w - u}{σ}\Big)^{-1/k - 1}

with the shape k: moments of order below 1/k exist, no variance from k = 0.5 on and no mean from
k = 1 on.

Zhang & Stephens, A new and efficient estimation method for the generalized Pareto distribution,
2009; Vehtari, Simpson, Gelman, Yao & Gabry, Pareto smoothed importance sampling, 2024.
"""

from __future__ import annotations

import math

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


def pareto_shape(log_weights: Array, *, of_sums: bool = True) -> Array:
    """The shape k of the generalised Pareto tail of weights, (runs,), from log-weights (runs, S).

    The excesses x are the M = min(S/5, 3√S) largest weights, each less the (M + 1)-th largest, to
    which the law is fitted; k is then regularised towards ½.

    Draws of discrete variables have equal weights: where a quarter of the M weights are equal to
    the (M + 1)-th but for rounding, excesses are counted from the next smaller weight, or from 0.

    The largest of S weights whose tail has the shape k is some S^(k − 1) of their sum: where it is
    less than a hundredth, k is ½ at the most, whatever the fit says of small excesses; not so if
    it is not for sums of weights (`of_sums`), such as their entropy, to which small ones add more.

    k is NaN for fewer than 25 draws, −∞ where the largest weights are all equal, and ∞ where a few
    weights dwarf the rest: the lower quartile of the excesses is below 10⁻¹² of the largest.
    """
    runs, count = log_weights.shape
    if count < FEWEST:
        return np.full(runs, np.nan)
    size = int(min(count / 5, 3 * np.sqrt(count)))
    top = np.sort(np.partition(log_weights, count - size - 1, axis=-1)[:, count - size - 1 :])
    weights = np.exp(top - top[:, -1:])
    tied = top[:, 1 + _quartile(size)] - top[:, 0] <= EQUAL
    below = np.where(log_weights < top[:, :1] - EQUAL, log_weights, -np.inf).max(axis=-1)
    least = np.where(
        tied & (top[:, -1] > top[:, 0] + EQUAL), np.exp(below - top[:, -1]), weights[:, 0]
    )
    shape, _ = _fitted(weights[:, 1:] - least[:, None])
    if not of_sums:
        return shape
    largest = 1.0 / np.exp(log_weights - top[:, -1:]).sum(axis=-1)
    return np.where(largest < _SMALL, np.minimum(shape, 0.5), shape)


def smoothed(log_weights: Array) -> tuple[Array, float]:
    """Log-weights (S,) whose tail is smoothed, not normalised, and the tail's shape k.

    The M = min(S/5, 3√S) largest are replaced by the quantiles of the law that fits them, none of
    them larger than the largest was. k is ∞ where there are too few to fit it, and −∞ where the
    largest are all equal.
    """
    found = log_weights - log_weights.max()
    count = found.size
    size = int(min(count / 5, 3 * np.sqrt(count)))
    if count < FEWEST:
        return found, math.inf if np.ptp(found) > EQUAL else -math.inf
    order = np.argsort(found, kind="stable")
    largest = order[-size:]
    threshold = max(float(found[order[-size - 1]]), math.log(np.finfo(float).tiny))
    shapes, scales = _fitted(np.exp(found[largest])[None] - math.exp(threshold))
    shape, scale = float(shapes[0]), float(scales[0])
    if math.isfinite(shape):
        levels = (np.arange(size) + 0.5) / size
        above = scale * np.expm1(-shape * np.log1p(-levels)) / shape
        found[largest] = np.minimum(np.log(above + math.exp(threshold)), 0.0)
    return found, shape


def _fitted(excess: Array) -> tuple[Array, Array]:
    """The shape k and the scale σ, (runs,) each, of the law of rising excesses x (runs, M).

    The density (1 + k x/σ)^(−1/k − 1)/σ is fitted by the posterior mean over a grid of the ratio
    −k/σ; the shape has a weak prior at ½, which counts as ten values. It is −∞ where all excesses
    are zero, and ∞ where the lower quartile is below 10⁻¹² of the largest.
    """
    size = excess.shape[1]
    equal = excess[:, -1] <= EQUAL
    steep = ~equal & (excess[:, _quartile(size)] <= STEEP * excess[:, -1])
    ordinary = np.arange(1, size + 1) / size
    excess = np.where((equal | steep)[:, None], ordinary, excess)  # these are not fitted
    quartile, largest = excess[:, _quartile(size)], excess[:, -1]
    grid = 30 + int(np.sqrt(size))
    ratios = (1.0 - np.sqrt(grid / (np.arange(grid)[:, None] + 0.5))) / (3.0 * quartile)
    ratios = ratios + 1.0 / largest
    shapes = np.array([np.log1p(-ratio[:, None] * excess).mean(axis=-1) for ratio in ratios])
    likelihood = size * (np.log(-ratios / shapes) - shapes - 1.0)
    share = np.exp(likelihood - likelihood.max(axis=0))
    ratio = (ratios * share).sum(axis=0) / share.sum(axis=0)
    shape = np.log1p(-ratio[:, None] * excess).mean(axis=-1)
    scale = -shape / ratio
    shape = (size * shape + 0.5 * PRIOR) / (size + PRIOR)
    return np.where(equal, -np.inf, np.where(steep, np.inf, shape)), scale


def _quartile(size: int) -> int:
    """The place of the lower quartile of so many values."""
    return int(size / 4 + 0.5) - 1
