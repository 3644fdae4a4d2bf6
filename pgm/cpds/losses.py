"""Robust noises that are given: Student's t, Cauchy, Huber and truncated squares."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import inf, log, pi
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import is_number
from pgm.cpds.robust import LEAST, RobustNoise
from pgm.cpds.student_scales import FEWEST, MOST, student_scales
from pgm.errors import ModelError
from pgm.kernels.arrays import LOG_2PI, Array, inner

# A weight that stands for none, of a square up to 1.
_NONE = 1e-12
# Parameters are within these bounds, so that their squares and the loss's ratios are numbers.
_SMALLEST, _LARGEST = 1e-50, 1e50
# The convex end of a graduated loss, its growth, and the end from which on it is as good as hard.
_GROWTH, _HARD = 1.4, 1e7


class _Positive(RobustNoise):
    """Base of noise whose parameters are all positive."""

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if not is_number(value) or not 0.0 < value < inf:
                raise ModelError(
                    f"{type(self).__name__}: {field.name} is a positive number, not {value!r}"
                )
            if not _SMALLEST <= value <= _LARGEST:
                raise ModelError(
                    f"{type(self).__name__}: {field.name} is between {_SMALLEST:g} and "
                    f"{_LARGEST:g}, not {value!r}; for a Gaussian leave noise= out"
                )


def _log_rise(a: float, b: float) -> float:
    """The value ln Γ(a + b) − ln Γ(a), of any a, however large."""
    from scipy.special import betaln, gammaln  # here, since it is slow to import

    return float(gammaln(b) - betaln(a, b))


@public
@dataclass(frozen=True)
class StudentT(_Positive):
    r"""Multivariate Student-t noise, whose scale matrix is the CPD's `cov`.

    .. math:: ρ(s) = \tfrac{ν + d}{2} \ln(1 + s / ν), \qquad w(s) = \frac{ν + d}{ν + s}

    It is a Gaussian of covariance R / λ with λ ~ Gamma(ν/2, ν/2). Its covariance is R ν / (ν − 2),
    infinite for ν ≤ 2; with ν = 1 it is the Cauchy distribution.

    Parameters
    ----------
    dof : float
        Degrees of freedom ν > 0; 3 to 5 where a few per cent are outliers.

    References
    ----------
    Lange, Little & Taylor, Robust statistical modeling using the t distribution, 1989.

    Examples
    --------
    >>> from pgm import LinearGaussianCPD, StudentT, Variable
    >>> x, z = Variable("x"), Variable("z")
    >>> cpd = LinearGaussianCPD(z, given={x: 1.0}, cov=1.0, noise=StudentT(3.0))
    >>> cpd.log_density([[0.0], [5.0]], {x: 0.0}).round(3)
    array([-1.001, -5.468])
    """

    dof: float
    distribution: ClassVar[bool] = True

    def loss(self, square: Array, count: npt.ArrayLike) -> Array:
        """The loss ρ(s)."""
        return 0.5 * (self.dof + np.asarray(count)) * np.log1p(square / self.dof)

    def slope(self, square: Array, count: npt.ArrayLike) -> Array:
        """The weight 2 ρ′(s)."""
        return (self.dof + np.asarray(count)) / (self.dof + square)

    def is_proper(self, size: int) -> bool:
        """Always."""
        return True

    def _log_scale(self, size: int) -> float:
        """The value ln c = ln Γ((ν + d)/2) − ln Γ(ν/2) − d/2 ln(π ν), d being the size."""
        return _log_rise(0.5 * self.dof, 0.5 * size) - 0.5 * size * log(pi * self.dof)

    def scales(self, size: int) -> tuple[Array, Array] | None:
        """The mixture over 1 / λ, whose density is within 10⁻⁵ of itself to 10⁶ deviations.

        There are 70 to 160 scales. None for fewer than ½ degrees of freedom, whose tails reach
        further than these, and for more than 30, whose outliers are too rare to be numbers.
        """
        return student_scales(self.dof, size) if FEWEST <= self.dof <= MOST else None

    def draw(self, white: Array, rng: np.random.Generator) -> Array:
        """Draws at unit scale: a Gaussian draw divided by √(χ²_ν / ν)."""
        gamma = rng.chisquare(self.dof, white.shape[:-1]) / self.dof
        return white / np.sqrt(gamma)[..., None]


@public
@dataclass(frozen=True)
class Cauchy(_Positive):
    r"""The Cauchy loss of robust statistics, a Gaussian's near zero: w = 1 there.

    .. math:: ρ(s) = \tfrac{k^2}{2} \ln(1 + s / k^2), \qquad w(s) = \frac{1}{1 + s / k^2}

    For k² > d it is Student-t noise of ν = k² − d degrees of freedom and scale matrix R k² / ν;
    else its density is improper: there are weights, but neither draws nor a log-density. The
    Cauchy distribution itself is ``StudentT(1)``.

    Parameters
    ----------
    scale : float
        k > 0, in deviations; 2.385 keeps 95 % of the efficiency for Gaussian scalars.

    References
    ----------
    Holland & Welsch, Robust regression using iteratively reweighted least-squares, 1977.

    Examples
    --------
    >>> from pgm import Cauchy, LinearGaussianCPD, Variable
    >>> x, z = Variable("x"), Variable("z")
    >>> LinearGaussianCPD(z, given={x: 1.0}, cov=1.0, noise=Cauchy(2.385)).noise
    Cauchy(scale=2.385)
    """

    scale: float

    def loss(self, square: Array, count: npt.ArrayLike) -> Array:
        """The loss ρ(s)."""
        return 0.5 * self.scale**2 * np.log1p(square / self.scale**2)

    def slope(self, square: Array, count: npt.ArrayLike) -> Array:
        """The weight 2 ρ′(s)."""
        return 1.0 / (1.0 + square / self.scale**2)

    def is_proper(self, size: int) -> bool:
        """Whether the tails fall fast enough, k² > d."""
        return self.scale**2 > size

    def _instead(self) -> str:
        return "give it a scale above the root of that number, or take pgm.StudentT(dof)"

    def _log_scale(self, size: int) -> float:
        """The value ln c = ln Γ(k²/2) − ln Γ((k² − d)/2) − d/2 ln(π k²), of scale k and size d."""
        half = 0.5 * (self.scale**2 - size)
        return _log_rise(half, 0.5 * size) - 0.5 * size * log(pi * self.scale**2)

    def scales(self, size: int) -> tuple[Array, Array] | None:
        """The mixture of Student-t noise; None for vectors, some of whose components have another.

        As the degrees of freedom k² − d are by the number d of components that were measured.
        """
        dof = self.scale**2 - 1.0
        found = StudentT(dof).scales(1) if size == 1 and dof > _SMALLEST else None
        return None if found is None else (found[0], found[1] * self.scale**2 / dof)

    def draw(self, white: Array, rng: np.random.Generator) -> Array:
        """Draws at unit scale: a Gaussian draw divided by the root of a χ² over the scale²."""
        gamma = rng.chisquare(self.scale**2 - white.shape[-1], white.shape[:-1])
        return white * (self.scale / np.sqrt(gamma))[..., None]


@public
@dataclass(frozen=True)
class Huber(_Positive):
    r"""Huber's noise: a Gaussian's within a threshold, of exponential tails beyond.

    .. math:: ρ(s) = \begin{cases} s/2 & \sqrt s ≤ k \\ k \sqrt s - k^2/2 & \text{else} \end{cases},
       \qquad w(s) = \min(1, k / \sqrt s)

    Its loss is convex in the residual: of a linear model the answer is unique, but an outlier
    pulls on it however far it lies.

    Parameters
    ----------
    threshold : float
        k > 0, in deviations; 1.345 keeps 95 % of the efficiency for Gaussian scalars.

    References
    ----------
    Huber, Robust estimation of a location parameter, 1964.

    Examples
    --------
    >>> from pgm import Huber, LinearGaussianCPD, Variable
    >>> x, z = Variable("x"), Variable("z")
    >>> cpd = LinearGaussianCPD(z, given={x: 1.0}, cov=1.0, noise=Huber(1.345))
    >>> cpd.log_density([[0.0], [5.0]], {x: 0.0}).round(3)
    array([-0.979, -6.799])
    """

    threshold: float

    def loss(self, square: Array, count: npt.ArrayLike) -> Array:
        """The loss ρ(s)."""
        k = self.threshold
        return np.where(square <= k * k, 0.5 * square, k * np.sqrt(square) - 0.5 * k * k)

    def slope(self, square: Array, count: npt.ArrayLike) -> Array:
        """The weight 2 ρ′(s)."""
        k = self.threshold
        return k / np.sqrt(np.maximum(square, k * k))

    def is_proper(self, size: int) -> bool:
        """Always."""
        return True

    def _log_masses(self, size: int) -> tuple[float, float]:
        """Logarithms of ∫ r^{d−1} e^{−ρ(r²)} dr within the threshold, and beyond."""
        from scipy.special import gammainc, gammaincc, gammaln  # here, since it is slow to import

        k, half = self.threshold, 0.5 * size
        with np.errstate(divide="ignore"):  # tails that weigh nothing
            near = (half - 1.0) * log(2.0) + gammaln(half) + np.log(gammainc(half, 0.5 * k * k))
            far = 0.5 * k * k - size * log(k) + gammaln(size) + np.log(gammaincc(size, k * k))
        return float(near), float(far)

    def _log_scale(self, size: int) -> float:
        """The value ln c = −ln (A ∫ r^{d−1} e^{−ρ(r²)} dr), d being the size.

        A = 2 π^{d/2} / Γ(d/2) is the surface of the unit sphere in d dimensions.
        """
        from scipy.special import gammaln  # here, since it is slow to import

        sphere = log(2.0) + 0.5 * size * log(pi) - gammaln(0.5 * size)
        return -float(sphere + np.logaddexp(*self._log_masses(size)))

    def draw(self, white: Array, rng: np.random.Generator) -> Array:
        """Draws of unit scale: a direction, and a length by the inverse of its distribution."""
        from scipy.special import gammainc, gammaincc, gammainccinv, gammaincinv  # slow to import

        size, k = white.shape[-1], self.threshold
        near, far = self._log_masses(size)
        uniform = rng.random(white.shape[:-1])
        within = rng.random(white.shape[:-1]) < np.exp(near - np.logaddexp(near, far))
        short = np.sqrt(2.0 * gammaincinv(0.5 * size, uniform * gammainc(0.5 * size, 0.5 * k * k)))
        long = gammainccinv(size, uniform * gammaincc(size, k * k)) / k
        length = np.where(within, short, long)
        found: Array = white * (length / np.sqrt(inner(white, white)))[..., None]
        return found


@public
@dataclass(frozen=True)
class TruncatedLeastSquares(_Positive):
    r"""Truncated least squares: a Gaussian within a threshold, nothing beyond it.

    .. math:: ρ(s) = \min(s, c^2) / 2, \qquad w(s) = 1 \text{ if } s ≤ c^2, \text{ else } 0

    It is approached through losses between a convex one and it, by graduated non-convexity: with
    μ from c²/(2 s_max − c²) on, 1.4 times as much in each iteration,

    .. math:: w_μ(s) = 1 \text{ for } s ≤ \tfrac{μ}{μ + 1} c^2, \quad 0 \text{ for } s ≥
       \tfrac{μ + 1}{μ} c^2, \quad \tfrac{c}{\sqrt s} \sqrt{μ (μ + 1)} - μ \text{ else.}

    A run has converged no earlier than all its weights are 0 or 1, as a smoother's are after
    some dozens of ``iterations``. A weight of 0 is 10⁻¹² / max(1, s) in numbers. The density is
    improper: there are weights, but neither draws nor a log-density.

    Parameters
    ----------
    threshold : float
        c > 0, in deviations: the root of the χ² quantile of an inlier's square.

    References
    ----------
    Yang, Antonante, Tzoumas & Carlone, Graduated non-convexity for robust spatial perception, 2020.
    Black & Rangarajan, On the unification of line processes, outlier rejection, and robust
    statistics, 1996.

    Examples
    --------
    >>> from pgm import LinearGaussianCPD, TruncatedLeastSquares, Variable
    >>> x, z = Variable("x"), Variable("z")
    >>> LinearGaussianCPD(z, given={x: 1.0}, cov=1.0, noise=TruncatedLeastSquares(3.0)).noise
    TruncatedLeastSquares(threshold=3.0)
    """

    threshold: float
    graduated: ClassVar[bool] = True

    def loss(self, square: Array, count: npt.ArrayLike) -> Array:
        """The loss ρ(s)."""
        return 0.5 * np.minimum(square, self.threshold**2)

    def slope(self, square: Array, count: npt.ArrayLike) -> Array:
        """The weight 2 ρ′(s)."""
        return np.where(square <= self.threshold**2, 1.0, 0.0)

    def weight(self, square: Array, count: npt.ArrayLike) -> Array:
        """The weights w(s) = 2 ρ′(s) at squares s; 1 where nothing was measured.

        For a weight of 0 they are 10⁻¹² / max(1, s).
        """
        return np.where(np.asarray(count) > 0, _some(self.slope(square, count), square), 1.0)

    def is_proper(self, size: int) -> bool:
        """False: a density with constant tails has no finite integral."""
        return False

    def _log_scale(self, size: int) -> float:
        """There is none: the integral is infinite."""
        raise NotImplementedError("an improper density has no scale")

    def draw(self, white: Array, rng: np.random.Generator) -> Array:
        """There are none."""
        raise NotImplementedError("an improper density has no draws")

    def first_stage(self, largest: Array) -> Array:
        """The μ to begin with, where the largest squares are so large; hard where all are small."""
        limit = self.threshold**2
        return np.where(largest > limit, limit / np.maximum(2.0 * largest - limit, limit), inf)

    def next_stage(self, stage: Array) -> Array:
        """The next μ."""
        return np.where(stage > _HARD, inf, _GROWTH * stage)

    def surplus(self, square: Array, count: npt.ArrayLike, weight: Array) -> Array:
        """The log-density less ln N(0, R/w); the tangent has the offset (1 − w) c²/2."""
        sizes = np.asarray(count)
        offset = 0.5 * (1.0 - weight) * self.threshold**2
        found = self.log_scale(sizes) - offset - 0.5 * sizes * (np.log(weight) - LOG_2PI)
        return np.where(sizes > 0, found, 0.0)

    def staged_loss(self, square: Array, stage: Array) -> Array:
        """The loss of a stage μ, whose weights are w_μ; a Gaussian's before the first (NaN)."""
        limit, soft = self.threshold**2, np.isfinite(stage)
        mu = np.where(soft, stage, 1.0)
        between = self.threshold * np.sqrt(square * mu * (mu + 1.0)) - 0.5 * mu * (limit + square)
        found = np.where(square <= mu / (mu + 1.0) * limit, 0.5 * square, between)
        found = np.where(square >= (mu + 1.0) / mu * limit, 0.5 * limit, found)
        found = np.where(soft, found, self.loss(square, 1))
        return np.where(np.isnan(stage), 0.5 * square, found)

    def staged(self, square: Array, stage: Array) -> Array:
        """The weights w_μ at a stage μ."""
        limit, hard = self.threshold**2, np.isinf(stage)
        mu = np.where(hard, 1.0, stage)
        between = self.threshold * np.sqrt(mu * (mu + 1.0) / np.maximum(square, 1e-300)) - mu
        soft = np.where(square <= mu / (mu + 1.0) * limit, 1.0, between)
        soft = np.where(square >= (mu + 1.0) / mu * limit, 0.0, soft)
        return _some(np.where(hard, self.slope(square, 1), soft), square)


# The losses that are given, whose equals are the same.
LOSSES = frozenset({StudentT, Cauchy, Huber, TruncatedLeastSquares})


def _some(weight: Array, square: Array) -> Array:
    """Weights above zero, so small that a residual of any size pulls on nothing."""
    found: Array = np.maximum(weight, np.maximum(_NONE / np.maximum(square, 1.0), LEAST))
    return found
