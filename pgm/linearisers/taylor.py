"""First-order Taylor expansion."""

from __future__ import annotations

from dataclasses import dataclass

from pgm.kernels.arrays import Array, apply, deviation
from pgm.linearisers.function import Affine, ArrayLineariser, BoundFunction


@dataclass(frozen=True)
class Taylor(ArrayLineariser):
    """First-order Taylor expansion at the mean: F = f'(μ), b = f(μ) − F μ.

    Uses the Jacobians given with the CPD, fourth-order central differences for the others. With
    filtering it is the extended Kalman filter, with smoothing the extended RTS smoother, and
    iterated smoothing is Gauss–Newton on the posterior.
    """

    def affine(self, function: BoundFunction, mean: Array, cov: Array) -> Affine:
        """Linearise a function at beliefs (..., n) and (..., n, n)."""
        value = function(mean)
        slope = function.jacobian(mean, None if function.analytic else deviation(cov))
        return Affine(slope, value - apply(slope, mean), None)


# The default of everything that takes a lineariser.
TAYLOR = Taylor()
