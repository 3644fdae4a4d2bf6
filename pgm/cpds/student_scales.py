"""Student-t noise as a mixture of Gaussians of several scales.

It is a Gaussian of covariance R / λ with λ ~ Gamma(ν/2, ν/2). The integral over λ is taken by the
rectangle rule over u = ln λ. Of a residual of any square the integrand is the density of the
logarithm of a Gamma variable, of shape a = (ν + d) / 2, whose characteristic function is
Γ(a + iω) / Γ(a): at ω = 2π / h it is half the relative error of steps h.
"""

from __future__ import annotations

from math import log, log1p, pi, sqrt

import numpy as np

from pgm.kernels.arrays import Array

# The degrees of freedom between which the noise is such a mixture.
FEWEST, MOST = 0.5, 30.0
# The deviations up to which the density holds, and the relative error of the rule.
_REACH, _ERROR = 1e6, 1e-6


def student_scales(dof: float, size: int) -> tuple[Array, Array]:
    """The weights and factors of the Gaussians, for degrees of freedom and d = `size` components.

    The density of their mixture is within 10⁻⁵ of that of the noise to 10⁶ deviations, where
    FEWEST ≤ ν ≤ MOST.
    """
    from scipy.special import loggamma  # here, since it is slow to import

    shape, half = 0.5 * (dof + size), 0.5 * dof
    turns = 0.1 * 1.05 ** np.arange(300)
    small = 2.0 * np.exp(loggamma(shape + 1j * turns).real - loggamma(shape).real) < _ERROR
    step = 2.0 * pi / turns[small.argmax()]
    # Beyond its ends the integrand of a residual within reach, of all components or of one, has a
    # tenth of the error, or less; and so has the probability of λ.
    rare = -log(0.1 * _ERROR)
    least = 0.5 * (dof + 1.0)
    low = log((dof + 1.0) / (dof + _REACH**2)) - rare / least - sqrt(2.0 * rare / least)
    low = min(low, -rare / half)
    high = log(1.0 + size / dof) + log1p(rare / half + sqrt(2.0 * rare / half))
    u = np.arange(low, high + step, step)
    weights = np.exp(half * (u - np.expm1(u)))
    some = weights > 0.0
    return weights[some] / weights.sum(), np.exp(-u[some])
