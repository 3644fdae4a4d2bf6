"""Sigma-point rules."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pgm.errors import LinearisationError
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.linearisers.regression import Points, StatisticalRegression


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

    References
    ----------
    Wan & van der Merwe, The unscented Kalman filter for nonlinear estimation, 2000.
    """

    alpha: float | None = None
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        if self.alpha is None and self.kappa != 0.0:
            raise LinearisationError(
                f"Unscented(alpha=None, kappa={self.kappa}): without alpha λ is n − 1, and kappa "
                "has no part in it; give both"
            )

    def points(self, dimension: int, name: str, step: int | Integers | None) -> Points:
        """The 2n + 1 points."""
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
    """

    def points(self, dimension: int, name: str, step: int | Integers | None) -> Points:
        """The 2n points."""
        return _cubature(dimension)


@lru_cache(maxsize=128)
def _cubature(n: int) -> Points:
    weights = frozen(np.full(2 * n, 0.5 / n))
    return Points(frozen(_cross(n, float(n))), weights, weights, False)


def _cross(n: int, square: float) -> Array:
    arm = np.sqrt(square) * np.eye(n)
    return np.vstack([arm, -arm])


@dataclass(frozen=True)
class MonteCarlo(StatisticalRegression):
    """Random points, weights 1/N, regressed with the sample's own mean and covariance.

    Points are drawn once per seed, CPD and step and shared by all runs: a batch equals its single
    runs, and one call for many steps equals many calls.

    Parameters
    ----------
    samples : int
        N, at least 2n + 2: with n + 1 the line passes through every point, and nothing is left
        to tell how wrong it is.
    seed : int
        A whole number, not negative.
    """

    samples: int
    seed: int = 0

    def __post_init__(self) -> None:
        for what, value, least in (("samples", self.samples, 1), ("seed", self.seed, 0)):
            if not isinstance(value, int | np.integer) or not least <= value < 2**63:
                raise LinearisationError(
                    f"MonteCarlo({what}={value!r}): {what} must be a whole number from {least} to "
                    "2⁶³ − 1"
                )

    def points(self, dimension: int, name: str, step: int | Integers | None) -> Points:
        """The sample, one for each step asked for."""
        if self.samples < 2 * dimension + 2:
            raise LinearisationError(
                f"MonteCarlo(samples={self.samples}) is too few for the {dimension} hidden "
                f"components of the CPD of {name}: ask for {2 * dimension + 2} or more"
            )
        weights = np.full(self.samples, 1.0 / self.samples)
        shape = (self.samples, dimension)
        if step is None or isinstance(step, int):
            points = _draw(self.seed, name, step or 0, 1, shape)[0]
        else:
            steps, inverse = np.unique(step, return_inverse=True)
            drawn = _draw(self.seed, name, int(steps[0]), int(steps[-1] - steps[0]) + 1, shape)
            points = drawn[(steps - steps[0])[inverse.reshape(np.shape(step))]]
        return Points(points, weights, weights, False)


def _draw(seed: int, name: str, first: int, steps: int, shape: tuple[int, int]) -> Array:
    """Standard normal points of consecutive steps, (steps, N, n).

    The generator counts, so that each step has its own stretch of one stream, wherever a call
    starts.
    """
    from scipy.special import ndtri  # here, since it is half of the time that importing pgm takes

    size = shape[0] * shape[1]
    stretch = -(-size // 4)  # Philox makes four numbers a count
    bits = np.random.Philox(key=[seed, zlib.crc32(name.encode())], counter=first * stretch)
    uniform = np.random.Generator(bits).random((steps, 4 * stretch))[:, :size]
    normal: Array = ndtri(uniform + 2.0**-54)  # never exactly zero
    return normal.reshape(steps, *shape)
