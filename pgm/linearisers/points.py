"""The points of a rule, with their weights."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.errors import ModelError
from pgm.kernels import regression, step
from pgm.kernels.arrays import Array

# Four units in the last place.
_LAST_PLACES = 4 * 2.0**-52
# Weights of a mean add up to one but for so much of their sizes; and moments of points are those of
# N(0, I) but for so much of theirs.
_SUM, _MOMENTS = 1e-9, 1e-6


class _Points(NamedTuple):
    points: Array
    mean_weights: Array
    cov_weights: Array
    centred: bool


class Points(_Points):
    """A rule's points for N(0, I), with weights.

    Attributes
    ----------
    points : ndarray
        (..., N, n); a step axis may lead, where a rule draws other points at each step.
    mean_weights, cov_weights : ndarray
        (N,), the former adding up to one.
    centred : bool
        Whether the first point is the origin.

    Raises
    ------
    ModelError
        If there are not as many weights as points, those of the mean do not add up to one, or the
        first of centred points is not the origin.

    Examples
    --------
    >>> from pgm.linearisers import Points
    >>> weights = np.array([0.5, 0.5])
    >>> rule = Points(np.array([[1.0], [-1.0]]), weights, weights, centred=False)
    >>> rule.mean_weights @ rule.points**2  # the variance of N(0, 1)
    array([1.])
    """

    def __new__(
        cls, points: Array, mean_weights: Array, cov_weights: Array, centred: bool
    ) -> Points:
        """The points, once they fit their weights."""
        count = points.shape[-2] if points.ndim > 1 else -1
        for name, weights in (("mean_weights", mean_weights), ("cov_weights", cov_weights)):
            if weights.shape != (count,):
                raise ModelError(
                    f"a rule's points have shape {points.shape} and its {name} {weights.shape}; "
                    "(..., N, n) and (N,) were due"
                )
        total = float(mean_weights.sum())
        if not abs(total - 1.0) <= _SUM * max(float(np.abs(mean_weights).sum()), 1.0):
            raise ModelError(f"a rule's mean_weights add up to {total:g}; one was due")
        if centred and points[..., 0, :].any():
            raise ModelError(
                "a rule's points are centred, and the first of them is not the origin; leave "
                "centred at False"
            )
        return super().__new__(cls, points, mean_weights, cov_weights, centred)

    @cached_property
    def fault(self) -> str | None:
        """The moment in which the points are not N(0, I), in words; or None.

        The mean is zero by the weights of the mean, and the covariance I by those of the
        covariance: so straight lines are found exactly. A mean that is the value at the centre
        alone is no fault.
        """
        s, mean, cov = self.points, self.mean_weights[:, None], self.cov_weights[:, None]
        off = np.abs((mean * s).sum(axis=-2))
        if not _is_rounding(off, np.abs(mean * s)):
            return f"with their mean_weights w, Σ w s is off zero by {off.max():.3g}"
        off = np.abs((cov * s).swapaxes(-1, -2) @ s - np.eye(s.shape[-1]))
        if not _is_rounding(off, np.abs(cov) * s**2):
            return f"with their cov_weights w, Σ w s sᵀ is off I by {off.max():.3g}"
        return None

    @cached_property
    def fit(self) -> step.Rule:
        """The regression on the points, where all beliefs share them."""
        return regression.fit(self.points, self.mean_weights, self.cov_weights)

    @cached_property
    def fit_of_runs(self) -> step.Rule:
        """The `fit` for the values of many runs."""
        return regression.of_runs(self.fit)

    @cached_property
    def with_centre(self) -> Array:
        """The points after the centre; angles are compared with the function's value there."""
        return np.concatenate([np.zeros((1, self.points.shape[1])), self.points])

    @cached_property
    def cancellation(self) -> float:
        """Rounding of the fitted line relative to the rounding of one value.

        √(Σ w² + Σ_j Σ (c s_j / Σ c s_j²)²), of the mean and of the slope over a deviation, for
        independent errors: about one for weights that are all positive, 1/α² for points at α.
        """
        s = self.points
        slopes = self.cov_weights[:, None] * s
        slopes = slopes / (slopes * s).sum(axis=-2, keepdims=True)
        return float(np.sqrt((self.mean_weights**2).sum() + (slopes**2).sum((-2, -1)).max()))

    @cached_property
    def rounding(self) -> float:
        """The rounding by which a value may be off its line, as a part of the value's summands.

        The deviation, with the rule's weights, of values that are each off by four units in the
        last place, from a line that these move as well.
        """
        s, size = np.abs(self.points), np.abs(self.cov_weights)
        moved = 1.0 + np.abs(self.mean_weights).sum()
        if len(s):
            reach = s.max(axis=-2)
            moved += (reach * (size[:, None] * s).sum(axis=-2)).sum(axis=-1).max(initial=0.0)
        return float(_LAST_PLACES * moved * np.sqrt(size.sum()))

    @cached_property
    def fitted_rounding(self) -> float:
        """The same of the `fit`, whose rest R has less to cancel than weights of both signs.

        Eightfold, since a function has summands of its own.
        """
        left = np.abs(self.fit.rest.array).sum(axis=-1)
        moved = 1.0 + 2.0 * np.sqrt((left**2).sum())
        return min(self.rounding, float(8.0 * _LAST_PLACES * moved))


def _is_rounding(off: Array, summands: Array) -> bool:
    """Whether errors of sums are rounding of their summands, along the last axis but one."""
    return bool((off <= _MOMENTS * np.max(summands.sum(axis=-2), initial=1.0)).all())
