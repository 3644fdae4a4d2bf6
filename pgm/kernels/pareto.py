r"""Weights of importance sampling whose largest are smoothed by a generalised Pareto distribution.

The ratios r of S draws from one distribution to another often have a few values that decide all.
Those above a threshold u follow

.. math:: p(r) = \frac{1}{\sigma} \Big(1 + k \frac{r - u}{\sigma}\Big)^{-1/k - 1}

with the shape k: the ratios have 1/k moments, no variance from k = 0.5 on and no mean from k = 1
on. The M largest are replaced by the quantiles of the fitted distribution.

Zhang & Stephens, A new and efficient estimation method for the generalized Pareto distribution,
2009; Vehtari, Simpson, Gelman, Yao & Gabry, Pareto smoothed importance sampling, 2024.
"""

from __future__ import annotations

import math

import numpy as np

from pgm.kernels.arrays import Array

# Ratios to which a distribution is fitted at the least.
_FEWEST = 5
# Ratios are all one where the logarithms of the largest differ by less.
_EQUAL = 1e-12


def smoothed(log_ratios: Array) -> tuple[Array, float]:
    """Log-ratios (S,) with a smoothed tail, not normalised, and the tail's shape k.

    The shape is infinite where there are too few ratios to fit it, and minus infinity where the
    largest are all equal.
    """
    found = log_ratios - log_ratios.max()
    count = found.size
    tail = math.ceil(min(0.2 * count, 3.0 * math.sqrt(count)))
    if tail < _FEWEST or tail >= count:
        return found, math.inf if np.ptp(found) > _EQUAL else -math.inf
    order = np.argsort(found, kind="stable")
    largest = order[-tail:]
    if found[largest[-1]] - found[largest[0]] <= _EQUAL:
        return found, -math.inf
    threshold = max(float(found[order[-tail - 1]]), math.log(np.finfo(float).tiny))
    shape, scale = fitted(np.exp(found[largest]) - math.exp(threshold))
    if math.isfinite(shape):
        levels = (np.arange(tail) + 0.5) / tail
        above = scale * np.expm1(-shape * np.log1p(-levels)) / shape
        # No ratio is made larger than the largest that was drawn, which is one.
        found[largest] = np.minimum(np.log(above + math.exp(threshold)), 0.0)
    return found, shape


def fitted(excess: Array) -> tuple[float, float]:
    """The shape k and the scale σ of a generalised Pareto distribution of rising values (M,).

    The shape has a weak prior at one half, which counts as ten values.
    """
    count = excess.size
    quarter = excess[int(count / 4 + 0.5) - 1]
    if not quarter > 0.0:
        return math.inf, math.nan
    points = 30 + int(math.sqrt(count))
    grid = 1.0 - np.sqrt(points / (np.arange(1, points + 1) - 0.5))
    grid = grid / (3.0 * quarter) + 1.0 / excess[-1]
    shapes = np.log1p(-grid[:, None] * excess).mean(axis=1)
    levels = count * (np.log(-grid / shapes) - shapes - 1.0)
    weights = np.exp(levels - levels.max())
    at = float(grid @ weights / weights.sum())
    shape = float(np.log1p(-at * excess).mean())
    scale = -shape / at
    return (shape * count + 0.5 * 10.0) / (count + 10.0), scale
