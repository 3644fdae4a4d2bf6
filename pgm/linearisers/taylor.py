"""First-order Taylor expansion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.kernels.arrays import Array, components_first, components_last
from pgm.kernels.gaussian import deviations
from pgm.linearisers.function import BoundFunction, FunctionTemplate
from pgm.linearisers.lineariser import Builtin, Line, Prepared


@dataclass(frozen=True)
class Taylor(Builtin):
    """First-order Taylor expansion at the mean: F = f'(μ), b = f(μ) − F μ.

    Uses the Jacobians given with the CPD, fourth-order central differences for the others. With
    filtering it is the extended Kalman filter, with smoothing the extended RTS smoother, and
    iterated smoothing is Gauss–Newton on the posterior.
    """

    def prepare(self, template: FunctionTemplate) -> Prepared:
        """The formula, which needs no preparation."""
        return _tangent

    @staticmethod
    def needs_cov(template: FunctionTemplate) -> bool:
        """Whether derivatives are taken by differences, whose steps depend on the deviations."""
        return bool(template.numerical)


def _tangent(function: BoundFunction, mean: Array, cov: Array) -> Line:
    x, std = components_last(mean, 1), None
    if not function.analytic:
        std = components_last(deviations(cov), 1)
    if isinstance(function, BoundFunction):
        value, slope = function.tangent(x, std)
    else:  # a user's own, in its place
        value, slope = function(x), function.jacobian(x, std)
    if mean.ndim == 1:
        return Line(slope, value, None)
    slope, value = components_first(slope, 2), components_first(value, 1)
    return Line(np.ascontiguousarray(slope), np.ascontiguousarray(value), None)


# The default of everything that takes a lineariser.
TAYLOR = Taylor()
