"""The last place of a mean in float64, counted in standard deviations.

A float64 m is a multiple of its last place u(m), the distance to the next number, which is at most
ε |m| and more than half of that, with ε = 2⁻⁵². However a mean was found, it is off by up to half a
last place.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array

_EPS = float(np.finfo(np.float64).eps)
# Deviations below this part of the largest one that a component had are not told apart.
_FLOOR = 1e-9


def rounding(mean: Array, std: Array, largest: Array) -> Array:
    """The largest error by rounding of means m (..., n), in standard deviations σ, (...).

    It is the largest ratio ½ u(m) / σ over the n components. `std` (..., n) are the deviations σ,
    and `largest` (..., n) the largest standard deviations that the components had at any stage of
    the inference, such as before all evidence: a σ below 10⁻⁹ of the largest is replaced by 10⁻⁹ of
    it. The ratio of a component whose deviation is zero or infinite, or whose mean is not finite,
    counts as zero.
    """
    open_ = (std > 0.0) & (std < np.inf) & np.isfinite(mean)
    half = 0.5 * np.spacing(np.abs(np.where(open_, mean, 0.0)))
    unit = np.where(open_, np.maximum(std, _FLOOR * largest), 1.0)
    found: Array = np.where(open_, half / unit, 0.0)
    return np.asarray(found.max(axis=-1, initial=0.0))


def may_count(mean: Array, variance: Array, share: float) -> bool:
    """Whether u(m) of some mean (..., n) may be more than `share` standard deviations.

    `variance` (..., n) are the variances that belong to the means. A quick bound decides: for each
    of the n components, the mean farthest from zero, over all leading axes, is compared with the
    least variance that is not zero.
    """
    axes = tuple(range(mean.ndim - 1))
    farthest = np.maximum(mean.max(axis=axes, initial=0.0), -mean.min(axis=axes, initial=0.0))
    least = variance.min(axis=axes, initial=np.inf)
    if not (least > 0.0).all():
        if (_EPS * farthest <= share * np.sqrt(np.maximum(least, 0.0))).all():
            return False
        least = np.where(variance > 0.0, variance, np.inf).min(axis=axes, initial=np.inf)
    return not bool((_EPS * farthest <= share * np.sqrt(least)).all())
