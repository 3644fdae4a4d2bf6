"""Statistical linear regression: sigma points of any rule, one regression."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.errors import LinearisationError, NumericalError
from pgm.kernels import roots
from pgm.kernels.arrays import (
    Array,
    Integers,
    apply,
    by_runs,
    deviation,
    times_transposed,
    transpose,
)
from pgm.kernels.regression import Line, line, range_inverse, regress, regress_along_runs
from pgm.linearisers.function import Affine, ArrayLineariser, BoundFunction
from pgm.sizes import require_memory

# An error of a larger share of a value's square is none of rounding.
_PLAIN = 1e-16
# The regression on more points than this takes longer to prepare than it saves.
FEW = 64


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
    """

    @cached_property
    def line(self) -> Line:
        """The regression on the points, where all beliefs share them."""
        return line(self.points, self.mean_weights, self.cov_weights)

    @cached_property
    def rounding(self) -> float:
        """How far rounding may put a value off its line, as a part of the value's summands.

        The deviation, with the rule's weights, of values that are each off by four units in the
        last place, from a line that these move as well.
        """
        s, size = np.abs(self.points), np.abs(self.cov_weights)
        moved = 1.0 + np.abs(self.mean_weights).sum()
        if len(s):
            reach = s.max(axis=-2)
            moved += (reach * (size[:, None] * s).sum(axis=-2)).sum(axis=-1).max(initial=0.0)
        return float(4 * 2.0**-52 * moved * np.sqrt(size.sum()))


@dataclass(frozen=True)
class StatisticalRegression(ArrayLineariser):
    """Linear regression of a function on sigma points: a rule is only points and weights.

    With points X = μ + L s for a root P = L Lᵀ, values Y, and weights: the mean of y is
    Σ w Y, F solves F L = J with J the regression of Y on s, b makes the line pass through both
    means, and the covariance is that of what the line leaves, Σ w r rᵀ. In directions in which P
    is zero F takes the limit P → 0, the Jacobian at μ. Angles of y are averaged as the value at
    the centre plus the mean of offsets, wrapped about the tangent where they exceed half a turn.
    In components in which what the line leaves may be rounding of the values it is zero.

    A subclass gives `points`, and may say that they are fresh for each run, or that moments of x
    are the belief's own.

    References
    ----------
    García-Fernández, Svensson, Morelande & Särkkä, Posterior linearization filter, 2015.
    """

    @abstractmethod
    def points(self, dimension: int, name: str, step: int | Integers | None) -> Points:
        """The rule's points for N(0, I).

        Parameters
        ----------
        dimension : int
            Number of components, n.
        name : str
            Of the CPD's child: with the step, what a random rule keys its draws by.
        step : int, ndarray of int or None
            The step, or an array over the belief's leading axes.
        """

    @property
    def fresh_per_run(self) -> bool:
        """Whether each run has points of its own; steps are then always given as an array."""
        return False

    @property
    def prior_moments(self) -> bool:
        """Whether the mean and covariance of x are the belief's, rather than the points' own."""
        return False

    def affine(self, function: BoundFunction, mean: Array, cov: Array) -> Affine:
        """Linearise a function at beliefs (..., n) and (..., n, n)."""
        lower = roots.root(cov)
        if not roots.is_proper(lower):
            when = f" at step {function.step}" if isinstance(function.step, int) else ""
            fault = "an indefinite covariance; use a rule with positive weights or more samples"
            if not np.isfinite(cov).all():
                fault = "a covariance beyond the range of float64; give the model other units"
            raise NumericalError(
                f"the belief at which the CPD of {function.name} is linearised{when} has {fault}"
            )
        step = function.step
        if self.fresh_per_run:
            step = np.broadcast_to(0 if step is None else step, mean.shape[:-1])
        points = self.points(mean.shape[-1], function.name, step)
        s, mean_weights, cov_weights, centred = points
        if s.shape[-2] > FEW:
            require_memory(
                mean.size * s.shape[-2],
                f"{s.shape[-2]} points of {self!r} for the CPD of {function.name} at each of "
                f"{mean.size // mean.shape[-1]} beliefs",
                "use a rule with fewer points, or give fewer runs to a call",
                error=LinearisationError,
            )
        offset, value = self._values(function, mean, cov, times_transposed(s, lower), centred)
        if self._along_runs(s, offset, lower):
            slope, centre, noise = regress_along_runs(points.line, offset)
        else:
            slope, centre, noise = regress(
                s, offset, mean_weights, cov_weights, lower, known=self.prior_moments
            )
        matrix = _divide(slope, lower, function, mean, cov)
        if not self.prior_moments:
            # Of values that lie on their line the slope and one of them tell the size.
            variance = np.einsum("...ii->...i", noise)
            square = value * value + np.einsum("...ij,...ij->...i", slope, slope)
            if not (variance > _PLAIN * square).all():
                size = np.abs(value) + np.abs(offset).max(axis=-2, initial=0.0)
                noise = _without_rounding(noise, size, matrix, mean, points.rounding)
        return Affine(matrix, value + centre - apply(matrix, mean), noise)

    def is_semidefinite(self, dimension: int) -> bool:
        """Whether what a line leaves is weighted by no negative number."""
        weights = self.points(dimension, "", 0).cov_weights
        return not self.prior_moments and bool((weights >= 0.0).all())

    def _along_runs(self, s: Array, values: Array, lower: Array) -> bool:
        """Whether few points, shared by many runs, are used in every component."""
        return (
            s.ndim == 2
            and len(s) <= FEW
            and values.ndim == 3
            and by_runs(values)
            and not self.prior_moments
            and not roots.determined(lower).any()
        )

    @staticmethod
    def _values(
        function: BoundFunction, mean: Array, cov: Array, offsets: Array, centred: bool
    ) -> tuple[Array, Array]:
        """Offsets of the values from a reference, (..., N, d), angles wrapped; the reference."""
        points = mean[..., None, :] + offsets
        angles = function.angles
        extra = angles.any() and not centred
        if extra:
            points = np.concatenate([mean[..., None, :], points], axis=-2)
        values = function(points)
        reference = values[..., :1, :]
        if extra:
            values = values[..., 1:, :]
        raw = values - reference
        turning = np.flatnonzero(angles)
        if any(np.abs(raw[..., k]).max() > np.pi for k in turning):
            wide = np.asarray((np.abs(raw[..., turning]) > np.pi).any(axis=(-2, -1)))
            # An angle that turns far with the state, as a heading does, is wrapped about its line.
            line = offsets @ transpose(function.jacobian(mean, deviation(cov)))
            line = np.where(wide[..., None, None], line, 0.0)
            raw = function.residual(raw, line) + line
        return raw, reference[..., 0, :]


def _without_rounding(noise: Array, size: Array, matrix: Array, mean: Array, share: float) -> Array:
    """The error of a line, zero in components in which it may be rounding of the values.

    A value of a size has summands of |F| |μ| besides, of which it may be the difference.
    """
    variance = np.abs(np.diagonal(noise, axis1=-2, axis2=-1))  # weights may be negative
    summands = size + apply(np.abs(matrix), np.abs(mean))
    real = variance > (share * summands) ** 2
    if real.all():
        return noise
    return np.where(real[..., :, None] & real[..., None, :], noise, 0.0)


def _divide(slope: Array, lower: Array, function: BoundFunction, mean: Array, cov: Array) -> Array:
    """F with F L = J; in the null directions of L, measured in its own units, the Jacobian."""
    fixed = roots.determined(lower)
    if not fixed.any():
        return transpose(roots.solve_upper(lower, transpose(slope)))
    std = deviation(cov)
    inverse, null = range_inverse(lower, std)
    return slope @ inverse + function.jacobian(mean, std) @ null
