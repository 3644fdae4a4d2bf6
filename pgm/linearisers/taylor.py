"""First-order Taylor expansion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from pgm.errors import ModelError
from pgm.kernels.arrays import Array, components_first, components_last
from pgm.kernels.gaussian import lengths
from pgm.linearisers.function import BoundFunction
from pgm.linearisers.lineariser import ArrayLineariser, Line, Prepared
from pgm.linearisers.template import FunctionTemplate


@dataclass(frozen=True)
class Taylor(ArrayLineariser):
    """First-order Taylor expansion at the mean: F = f'(μ), b = f(μ) − F μ.

    Uses the Jacobians given with the CPD; the others are exact derivatives of the function's trace
    or, where it has none, fourth-order central differences. With filtering it is the extended
    Kalman filter, with smoothing the extended RTS smoother, and iterated smoothing is Gauss–Newton
    on the posterior.

    Parameters
    ----------
    expected : bool
        Whether robust noise weighs a measurement by the square of its residual that the belief
        expects, rᵀR⁻¹r + tr R⁻¹HPHᵀ, as the other rules do; else by that of the mean, rᵀR⁻¹r. With
        the first, weights raise the lower bound of the evidence, by which `fit` learns; with the
        second they find the most probable states.

    Examples
    --------
    >>> from pgm.examples import square, y
    >>> graph = pgm.compile(square)
    >>> pgm.infer(graph, {}, lineariser=pgm.Taylor())[y].mean.round(2)
    array([9.])
    """

    expected: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.expected, bool):
            raise ModelError(f"Taylor: expected= is True or False, not {self.expected!r}")

    def __repr__(self) -> str:
        return "Taylor(expected=True)" if self.expected else "Taylor()"

    def prepare(self, template: FunctionTemplate) -> Prepared:
        """The formula, with the deviations that set the steps of differences where it takes any.

        Parameters
        ----------
        template : FunctionTemplate

        Returns
        -------
        Prepared
        """
        return partial(_expanded, bool(template.missing))

    @staticmethod
    def needs_cov(template: FunctionTemplate) -> bool:
        """Whether derivatives are taken by differences, whose steps depend on the deviations.

        Parameters
        ----------
        template : FunctionTemplate

        Returns
        -------
        bool
        """
        return bool(template.numerical)


def _expanded(numerical: bool, function: BoundFunction, mean: Array, cov: Array) -> Line:
    """The tangent at beliefs (n, *batch) and (n, n, *batch).

    `numerical` says whether any derivative was not given: the deviations are then used.
    """
    if mean.ndim == 1 and isinstance(function, BoundFunction):
        value, slope = function.tangent(mean, cov if numerical else None)
        return Line(slope, value, None)
    x = components_last(mean, 1)
    if isinstance(function, BoundFunction):
        value, slope = function.tangent(x, components_last(cov, 2) if numerical else None)
    else:  # one of the user's own, which stands in for it
        std = components_last(lengths(cov), 1) if numerical else None
        value, slope = function(x), function.jacobian(x, std)
    if mean.ndim > 1:
        value = np.ascontiguousarray(components_first(value, 1))
        slope = np.ascontiguousarray(components_first(slope, 2))
    return Line(slope, value, None)


# The default of everything that takes a lineariser.
TAYLOR = Taylor()
