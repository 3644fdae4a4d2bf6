"""First-order Taylor expansion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.factors import AffineGaussian, Gaussian
from pgm.kernels.arrays import apply
from pgm.linearisers.function import BoundFunction


@dataclass(frozen=True)
class Taylor:
    """First-order Taylor expansion at the mean: F = f'(μ), b = f(μ) − F μ.

    Uses the Jacobians given with the CPD, fourth-order central differences for the others. With
    filtering it is the extended Kalman filter, with smoothing the extended RTS smoother, and
    iterated smoothing is Gauss–Newton on the posterior.
    """

    def __call__(self, function: BoundFunction, at: Gaussian, /) -> AffineGaussian:
        """Linearise a function at a belief."""
        value = function(at.mean)
        slope = function.jacobian(at.mean, None if function.analytic else at.std)
        size = value.shape[-1]
        return AffineGaussian(slope, value - apply(slope, at.mean), np.zeros((size, size)))


# The default of everything that takes a lineariser.
TAYLOR = Taylor()
