r"""The M step of robust noise: counts of its rows, and degrees of freedom of Student-t noise.

A residual r of robust noise with the covariance parameter R counts with R / w, w = w(s) being its
weight at the square s = rᵀ R⁻¹ r. At weights that stay, the expected log-density is a Gaussian's,

    −½ Σ (ln |R| + w E[rᵀ R⁻¹ r]),

a lower bound of that of the robust density, which touches it at these weights: its maximum in R is
Σ w E[r rᵀ] / N, and steps between weights and parameters never lower the bound of the evidence.

Truncated least squares have no density. Their R is the one that Gaussian residuals of covariance R
would have, of which as many are cut off: with the squares s = (1 − h) χ²_d + h d that are expected
of these, h = tr R⁻¹ H P Hᵀ / d being the share of R that the belief does not know,

    R = Σ w E[r rᵀ] / Σ κ(h) w,   κ(h) = E[w(s) s] / (d E[w(s)]).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pgm.cpds import ConditionalGaussian, RobustNoise, StudentT
from pgm.cpds.radius import kept
from pgm.errors import ModelError
from pgm.kernels.arrays import Array, Integers
from pgm.learning.values import DegreesOfFreedom
from pgm.posteriors.expectations import FamilyBelief, RobustWeights

# Logarithms of radii, over which χ² of up to thousands of components is summed.
_RADII = np.linspace(-12.0, 5.0, 2**14)
# Shares of a belief's uncertainty, between which factors are interpolated.
_SHARES = np.linspace(0.0, 1.0, 65)
# The step of differences by the logarithm of the degrees of freedom.
_STEP = 1e-4
# Of the search for the logarithm.
_SETTLED = 1e-10


def is_proper(noise: RobustNoise, count: Integers) -> bool:
    """Whether residuals of so many components, zero for none, have a density."""
    return all(noise.is_proper(int(size)) for size in np.unique(count) if size)


def counts(noise: RobustNoise, robust: RobustWeights, share: Array) -> Array:
    """The count of each row of truncated noise in the mean of moments, κ(h) w.

    `share` is h (rows, runs), and so is the result.
    """
    found = np.zeros(share.shape)
    for size in np.unique(robust.components).tolist():
        if size:
            kept = np.interp(share, _SHARES, _consistency(noise, size))
            found = np.where(robust.components == size, kept * robust.weight, found)
    return found


@kept
def _consistency(noise: RobustNoise, size: int) -> Array:
    """The factors κ(h) at shares h of the belief's uncertainty, on a grid of these."""
    drawn = np.exp(2.0 * _RADII)
    exponent = size * _RADII - 0.5 * drawn
    density = np.exp(exponent - exponent.max())
    found = np.empty(len(_SHARES))
    for k, share in enumerate(_SHARES):
        square = (1.0 - share) * drawn + share * size
        weight = density * noise.slope(square, np.full(square.shape, size))
        found[k] = weight @ square / (size * weight.sum())
    return found


class DegreesOfFreedomStep:
    """The M step of Student-t noise's degrees of freedom ν, by a one-dimensional search (ECME).

    With the squares s that the smoother found, ν maximises the bound Σ ln c(ν) − ρ(s; ν) of the
    expected log-density; weights are then those of the new ν. The coordinate is ln ν.
    """

    def __init__(self, cpd: ConditionalGaussian, declared: DegreesOfFreedom) -> None:
        if not isinstance(cpd.noise, StudentT):
            has = "Gaussian noise" if cpd.noise is None else repr(cpd.noise)
            raise ModelError(
                f"{cpd!r} has {has}; degrees of freedom are learnt of noise=pgm.StudentT(dof)",
                cpd=cpd,
            )
        if not declared.lower <= cpd.noise.dof <= declared.upper:
            raise ModelError(
                f"{cpd!r}: {cpd.noise!r} is not within {declared.lower:g} to {declared.upper:g}, "
                "the bounds of its degrees of freedom; give it some to begin with that are",
                cpd=cpd,
            )
        self.bounds = math.log(declared.lower), math.log(declared.upper)

    def vector(self, cpd: Any) -> Array:
        """The coordinate of a CPD."""
        return np.array([math.log(cpd.noise.dof)])

    def at(self, vector: Array) -> StudentT:
        """The noise at a coordinate, moved within the bounds."""
        return StudentT(math.exp(float(np.clip(vector[0], *self.bounds))))

    def gradient(self, cpd: Any, beliefs: list[FamilyBelief]) -> Array:
        """The derivative of the bound by the coordinate, by central differences."""
        here = math.log(cpd.noise.dof)
        ahead, behind = (_bound(here + sign * _STEP, beliefs) for sign in (1.0, -1.0))
        return np.array([(ahead - behind) / (2.0 * _STEP)])

    def likeliest(self, cpd: Any, beliefs: list[FamilyBelief]) -> StudentT:
        """The noise whose degrees of freedom maximise the bound at these squares."""
        from scipy.optimize import minimize_scalar  # here, since it is slow to import

        here = math.log(cpd.noise.dof)
        found = minimize_scalar(
            lambda t: -_bound(t, beliefs),
            bounds=self.bounds,
            method="bounded",
            options={"xatol": _SETTLED},
        )
        noise: StudentT = cpd.noise
        return self.at(np.array([found.x])) if -found.fun > _bound(here, beliefs) else noise


def _bound(log_dof: float, beliefs: list[FamilyBelief]) -> float:
    """The bound Σ ln c(ν) − ρ(s; ν) over all measurements, times the weights of their rows."""
    noise, total = StudentT(math.exp(log_dof)), 0.0
    for belief in beliefs:
        assert belief.robust is not None
        square = belief.robust.square
        count: Integers = np.broadcast_to(belief.robust.components, square.shape)
        each = noise.log_scale(count) - noise.loss(square, count)
        each = each if belief.weights is None else belief.weights * each
        total += float(each[count > 0].sum())
    return total


def reweighed(beliefs: list[FamilyBelief], noise: RobustNoise) -> list[FamilyBelief]:
    """The beliefs of a family with the weights of another noise at the same squares."""
    found = []
    for belief in beliefs:
        assert belief.robust is not None
        robust = belief.robust
        weight = noise.weight(robust.square, robust.components)
        found.append(belief._replace(robust=robust._replace(weight=weight)))
    return found


def with_noise(cpd: ConditionalGaussian, noise: RobustNoise | None) -> ConditionalGaussian:
    """A CPD with another robust noise."""
    if noise is cpd.noise:
        return cpd
    found = cpd._with_cov(cpd.cov)
    found._set(noise=noise)
    return found
