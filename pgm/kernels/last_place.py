"""The last place of a mean in float64, counted in standard deviations.

A float64 m is a multiple of its last place u(m), the distance to the next number: ε |m| at most,
and more than half of that. However a mean was found, it is off by up to half a last place.
"""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array

_EPS = float(np.finfo(np.float64).eps)


def in_deviations(mean: Array, std: Array) -> Array:
    """The largest u(m) / σ of the components of means and deviations (..., n), as (...).

    A component that is certain, or of which nothing is known, has no deviation to count in.
    """
    open_ = (std > 0.0) & (std < np.inf) & np.isfinite(mean)
    place = np.spacing(np.abs(np.where(open_, mean, 0.0)))
    found: Array = np.where(open_, place / np.where(open_, std, 1.0), 0.0)
    return np.asarray(found.max(axis=-1, initial=0.0))


def may_count(mean: Array, variance: Array, share: float) -> bool:
    """Whether u(m) of some mean (..., n) may be over the part `share` of its deviation.

    It is a bound that takes little time: the farthest mean of each component is compared with its
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
