"""Student's t of five degrees of freedom in place of Gaussian noise: tails for defensive draws."""

from __future__ import annotations

from math import lgamma, log, pi

import numpy as np

from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask

# Degrees of freedom: four moments, and still eight times the mass of a Gaussian beyond three
# standard deviations in a plane.
FREEDOM = 5.0


def stretch(white: Array, where: Mask, rng: np.random.Generator) -> None:
    """Turn Gaussian noise s (..., n) into noise of Student's t, s √(ν/χ²_ν) with ν = 5, in place.

    Only the vectors that the mask `where` (...) marks are changed.
    """
    white[where] *= np.sqrt(FREEDOM / rng.chisquare(FREEDOM, (int(where.sum()), 1)))


def log_ratio(size: Integers, squared: Array) -> Array:
    r"""The logarithm of Student's t density over the Gaussian, at noise s of n = `size` components.

    .. math:: c_n - \tfrac{ν + n}{2} \ln(1 + |s|^2/ν) + \tfrac12 |s|^2

    with ν = 5 degrees of freedom and the logarithm c_n of the ratio of both densities at zero.
    `squared` is |s|²; `size` is an array whose shape broadcasts against it.
    """
    constant = np.array([_log_constant(k) for k in range(int(size.max(initial=0)) + 1)])[size]
    power = 0.5 * (FREEDOM + size)
    value: Array = constant - power * np.log1p(squared / FREEDOM) + 0.5 * squared
    return value


def _log_constant(size: int) -> float:
    """The logarithm c_n of Student's t density over the Gaussian at zero, of n = `size` components.

    With ν = 5 it is ln [Γ((ν + n)/2) / Γ(ν/2)] + (n/2) ln [2π / (νπ)].
    """
    gammas = lgamma(0.5 * (FREEDOM + size)) - lgamma(0.5 * FREEDOM)
    return gammas + 0.5 * size * (LOG_2PI - log(FREEDOM * pi))
