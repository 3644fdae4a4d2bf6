"""Deterministic sigma-point rules."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.hermite_e import hermegauss

from pgm.arguments import public
from pgm.boundary import is_number, is_whole
from pgm.errors import LinearisationError
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.linearisers.points import Points
from pgm.linearisers.regression import StatisticalRegression


@public
@dataclass(frozen=True)
class Unscented(StatisticalRegression):
    """The scaled unscented rule: the centre and 2n points at ±√(n + λ) along the root's columns.

    λ = α²(n + κ) − n; weights λ/(n + λ) at the centre, plus 1 − α² + β for covariances, and
    1/(2(n + λ)) elsewhere.

    Parameters
    ----------
    alpha : float, optional
        Spread. None means λ = n − 1 with κ = 0, so that all weights are positive.
    beta : float
        Weight of the centre in covariances; 2 suits Gaussians.
    kappa : float
        Secondary spread.

    Raises
    ------
    LinearisationError
        If one is no finite number, or `kappa` is given without `alpha`: when made; if α²(n + κ) is
        not positive: when used.

    References
    ----------
    Wan & van der Merwe, The unscented Kalman filter for nonlinear estimation, 2000.

    Examples
    --------
    >>> from pgm.examples import square, y
    >>> graph = pgm.compile(square)
    >>> pgm.infer(graph, {}, lineariser=pgm.Unscented())[y].mean.round(2)
    array([10.])
    """

    alpha: float | None = None
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("alpha", self.alpha), ("beta", self.beta), ("kappa", self.kappa)):
            if name == "alpha" and value is None:
                continue
            if not is_number(value) or not math.isfinite(value):
                raise LinearisationError(
                    f"Unscented({name}={value!r}): {name} must be a finite number"
                )
        if self.alpha is not None and self.alpha < 0.0:
            raise LinearisationError(f"Unscented(alpha={self.alpha!r}): alpha must be positive")
        if self.alpha is None and self.kappa != 0.0:
            raise LinearisationError(
                f"Unscented(alpha=None, kappa={self.kappa}): without alpha λ is n − 1, and kappa "
                "has no part in it; give both"
            )

    def points(self, dimension: int, name: str, step: int | Integers | None) -> Points:
        """The 2n + 1 points, (2n + 1, n), the centre first; as of `StatisticalRegression`."""
        return _unscented(dimension, self.alpha, self.beta, self.kappa)


@lru_cache(maxsize=128)
def _unscented(n: int, alpha: float | None, beta: float, kappa: float) -> Points:
    total = 2.0 * n - 1.0 if alpha is None else alpha**2 * (n + kappa)
    if total <= 0.0 or n + kappa <= 0.0:
        raise LinearisationError(
            f"Unscented(alpha={alpha}, kappa={kappa}): for {n} components α²(n + κ) is "
            f"{total:.3g}; alpha and n + κ must be positive"
        )
    square = total / (n + kappa)
    mean_weights = np.full(2 * n + 1, 0.5 / total)
    mean_weights[0] = (total - n) / total
    cov_weights = mean_weights.copy()
    cov_weights[0] += 1.0 - square + beta
    points = np.vstack([np.zeros((1, n)), _cross(n, total)])
    return Points(frozen(points), frozen(mean_weights), frozen(cov_weights), True)


@dataclass(frozen=True)
class Cubature(StatisticalRegression):
    """The third-degree spherical cubature rule: 2n equal points at ±√n.

    References
    ----------
    Arasaratnam & Haykin, Cubature Kalman filters, 2009.

    Examples
    --------
    >>> from pgm.examples import square, y
    >>> graph = pgm.compile(square)
    >>> pgm.infer(graph, {}, lineariser=pgm.Cubature())[y].mean.round(2)
    array([10.])
    """

    def points(self, dimension: int, name: str, step: int | Integers | None) -> Points:
        """The 2n points, (2n, n); as of `StatisticalRegression`."""
        return _cubature(dimension)


@lru_cache(maxsize=128)
def _cubature(n: int) -> Points:
    weights = frozen(np.full(2 * n, 0.5 / n))
    return Points(frozen(_cross(n, float(n))), weights, weights, False)


def _cross(n: int, square: float) -> Array:
    arm = np.sqrt(square) * np.eye(n)
    return np.vstack([arm, -arm])


# More points than this are refused: a product rule outgrows every memory within a few dimensions.
MOST_POINTS = 10**6


@public
@dataclass(frozen=True)
class GaussHermite(StatisticalRegression):
    """The Gauss–Hermite product rule: orderⁿ points, exact to degree 2·order − 1 in each component.

    The points are all combinations of the zeros of the Hermite polynomial of the given order, the
    weights the products of the zeros' weights: E[x₁ᵃ x₂ᵇ …] is exact where no exponent exceeds
    2·order − 1.

    Parameters
    ----------
    order : int
        Points for each component, 2 to 100.

    Raises
    ------
    LinearisationError
        If it is no such number: when made; if there are more than 10⁶ points: when used.

    References
    ----------
    Ito & Xiong, Gaussian filters for nonlinear filtering problems, 2000.

    Examples
    --------
    >>> from pgm.examples import square, y
    >>> graph = pgm.compile(square)
    >>> pgm.infer(graph, {}, lineariser=pgm.GaussHermite(order=3))[y].mean.round(2)
    array([10.])
    """

    order: int = 3

    def __post_init__(self) -> None:
        if not is_whole(self.order) or not 2 <= self.order <= 100:
            raise LinearisationError(
                f"GaussHermite(order={self.order!r}): order, the number of points for each "
                "component, must be a whole number from 2 to 100"
            )

    def points(self, dimension: int, name: str, step: int | Integers | None) -> Points:
        """The orderⁿ points, (orderⁿ, n); as of `StatisticalRegression`."""
        if int(self.order) ** dimension > MOST_POINTS:
            raise LinearisationError(
                f"GaussHermite(order={self.order}) has {self.order}^{dimension} points for the "
                f"{dimension} hidden components of the CPD of {name}, more than {MOST_POINTS}; "
                "lower the order, or use Cubature() or QuasiMonteCarlo(...)"
            )
        return _gauss_hermite(dimension, int(self.order))


@lru_cache(maxsize=16)
def _gauss_hermite(n: int, order: int) -> Points:
    nodes, weights = hermegauss(order)
    nearest = np.argsort(np.abs(nodes))  # the origin, where it is a point, comes first
    nodes, weights = nodes[nearest], weights[nearest] / weights.sum()
    index = np.indices((order,) * n).reshape(n, -1)
    product = frozen(np.prod(weights[index], axis=0))
    return Points(frozen(np.ascontiguousarray(nodes[index].T)), product, product, order % 2 == 1)
