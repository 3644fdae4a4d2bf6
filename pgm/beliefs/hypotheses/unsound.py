"""Moments of hypotheses that are no numbers, which only the impossible ones may have.

A case's function may have no value where another case's regime is; then the hypothesis that pairs
them, which is impossible, has NaN for its moments or its density, and is given any finite ones.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.hypotheses.cases import Given
from pgm.beliefs.moments.steps.readings import Moments
from pgm.errors import NumericalError
from pgm.kernels.arrays import Array, Mask, is_finite


def unsound(after: Moments, density: Array | None = None) -> Mask | None:
    """Which moments (n, *batch), or log-densities (*batch), are not numbers; None if all are.

    A log-density of −∞ is one: that of a contradiction.
    """
    mean, cov = after
    if is_finite(mean) and is_finite(cov) and (density is None or is_finite(density)):
        return None
    bad = ~(np.isfinite(after.mean).all(axis=0) & np.isfinite(after.cov).all(axis=(0, 1)))
    if density is not None:
        bad = bad | np.isnan(density) | (density == np.inf)
    return np.asarray(bad)


def replaced(after: Moments, bad: Mask) -> Moments:
    """Moments with N(0, I) where they are bad, (*batch)."""
    size = len(after.mean)
    eye = np.eye(size).reshape(size, size, *(1,) * bad.ndim)
    return Moments(np.where(bad, 0.0, after.mean), np.where(bad, eye, after.cov))


def infinite(given: Given, what: str, step: int, bad: Mask) -> NumericalError:
    """The error for beliefs, (..., runs), that are not finite under possible hypotheses."""
    axes = tuple(range(bad.ndim - 1))
    run = given.bound.first_run + int(bad.any(axis=axes).argmax())
    step += given.first
    return NumericalError(
        f"the {what} at step {step}, run {run}, is not finite under some state of the discrete "
        "variables; are the belief before it, the measurements and the noises of a size that "
        "float64 can hold?",
        step=step,
        run=run,
    )
