r"""The M step of robust noise: the weights of its rows, and degrees of freedom of Student-t noise.

A residual r of robust noise with the covariance parameter R counts with R / w, w = w(s) being its
weight at the square s = rᵀ R⁻¹ r. At weights that stay, the expected log-density is a Gaussian's,

    −½ Σ (ln |R| + w E[rᵀ R⁻¹ r]),

a lower bound of that of the robust density, which touches it at these weights: its maximum in R is
Σ w E[r rᵀ] / N, and steps between weights and parameters never lower the bound of the evidence. So
R is learnt of a *distribution*, as Student-t noise is one.

Of a *loss*, whose R is the covariance of the usual readings, this will not do. An outlier of
Huber's loss pulls at R by w s = k √s, and so without bound; of truncated least squares the sum
falls with R; and of Gaussian readings R comes out too small, by .69 in the deviation of
`Cauchy(2)`. Each row counts with a power of its weight instead, the least whole one p at which the
moment w^p s of an outlier vanishes as it goes away: 3 for Huber's loss, 2 for Cauchy's, 1 for
truncated least squares. R is the covariance at which Gaussian residuals have these moments,

    R = Σ w^p E[r rᵀ] / Σ κ(h) w^p,   κ(h) = E[w(s)^p s] / (d E[w(s)^p]),

with the squares s = (1 − h) χ²_d + h d that are expected of them, h = tr R⁻¹ H P Hᵀ / d being the
share of R that the belief does not know (Windham, Robustifying model fitting, 1995).
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
# Squares of outliers, at which weights tell how they fall off; the least exponent of a fall; and of
# what an exponent may be off by.
_FAR, _HARDLY, _ROUNDING = np.array([1e8, 1e10]), 0.05, 1e-3
# The step of differences by the logarithm of the degrees of freedom.
_STEP = 1e-4
# Of the search for the logarithm.
_SETTLED = 1e-10


def of_noise(noise: RobustNoise, robust: RobustWeights, share: Array) -> tuple[Array, Array]:
    """The share of each row of a loss in its covariance, κ(h) w^p, and its factor there, w^p.

    `share` is h (rows, runs), and so are the results.
    """
    count, factor = np.zeros((2, *share.shape))
    for size in np.unique(robust.components).tolist():
        if size:
            own = robust.components == size
            raised = robust.weight ** _power(noise, size)
            kept = np.interp(share, _SHARES, _consistency(noise, size))
            count, factor = np.where(own, (kept * raised, raised), (count, factor))
    return count, factor


@kept
def _power(noise: RobustNoise, size: int) -> int:
    """The least whole power p of the weight at which w^p s vanishes for large squares s.

    Of a weight that falls as s^{−a} it is the least above 1/a; 1 where the weight hardly falls, so
    that nothing is spared, or is zero.
    """
    near, far = noise.slope(_FAR, np.full(_FAR.shape, size))
    if not far > 0.0:
        return 1
    falls = math.log(near / far) / math.log(_FAR[1] / _FAR[0])
    return 1 if falls < _HARDLY else math.floor(1.0 / falls + _ROUNDING) + 1


@kept
def _consistency(noise: RobustNoise, size: int) -> Array:
    """The factors κ(h) at shares h of the belief's uncertainty, on a grid of these."""
    drawn = np.exp(2.0 * _RADII)
    exponent = size * _RADII - 0.5 * drawn
    density = np.exp(exponent - exponent.max())
    found = np.empty(len(_SHARES))
    for k, share in enumerate(_SHARES):
        square = (1.0 - share) * drawn + share * size
        weight = noise.weight(square, np.full(square.shape, size))
        factor = density * weight ** _power(noise, size)
        found[k] = factor @ square / (size * factor.sum())
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
