"""Log-evidence and divergences from the Gaussian's draws and as many defensive ones.

Draws x of all hidden variables are from the Gaussian answer q, or from a *defensive* density d with
wider tails. With the mixture r = (q + d)/2, and with p = p(x, z), the density of the model with the
measurements z, a draw has the weights y = p/r, w = p/q and v = q/r. Each run has S draws from q,
then S from d, along the last axis: two *strata* of equal size.

The mean ȳ of y over all 2S draws estimates the evidence Z = p(z). The mean v̄ of v estimates 1, so
that v is a control variate. With the slope β of the regression of y on v within the strata, the
estimate of Z is

    Ẑ = ȳ − β (v̄ − 1).

The *peak* is the largest ln y of a run; weights y are kept as y / e^peak.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.errors import NumericalError
from pgm.inference.audit.draws import Draws
from pgm.kernels.arrays import Array
from pgm.kernels.pareto import EQUAL, pareto_shape

# The slope β at the most, as a multiple of the mean weight.
_STEEPEST = 2.0


def weigh(draws: Draws) -> tuple[Array, Array]:
    """The log-weights ln y of draws, −∞ where p is NaN, and their weights v, (runs, S) each."""
    log_mixture = np.logaddexp(draws.gaussian, draws.defensive) - np.log(2.0)
    log_weights = np.where(np.isnan(draws.target), -np.inf, draws.target - log_mixture)
    return log_weights, np.exp(draws.gaussian - log_mixture)


@dataclass(frozen=True, eq=False)
class Weighed:
    """Importance weights of S draws from q, then of S from d, (runs, 2S).

    Attributes
    ----------
    log_weights : ndarray
        ln y = ln p/r; −∞ where a function was not finite.
    control : ndarray
        v = q/r.
    log_ratio : ndarray
        ln w = ln p/q; −∞ or NaN where p is zero or a function was not finite.
    """

    log_weights: Array
    control: Array
    log_ratio: Array

    @cached_property
    def peak(self) -> Array:
        """The largest ln y, (runs,)."""
        return np.asarray(self.log_weights.max(axis=-1))

    @cached_property
    def weights(self) -> Array:
        """The weights y / e^peak, (runs, 2S)."""
        return np.exp(self.log_weights - self.peak[:, None])

    @property
    def plain(self) -> Array:
        """The log-weights ln w = ln p/q of q's own draws, (runs, S)."""
        return self.log_ratio[:, : self.log_ratio.shape[-1] // 2]


class Evidence(NamedTuple):
    r"""The estimate of the evidence Z of each run, with v as control variate.

    .. math:: \hat Z = \bar y - β (\bar v - 1)

    Attributes
    ----------
    slope : ndarray
        (runs,): β e^−peak, β being the slope of the regression of y on v.
    value : ndarray
        (runs,): Ẑ e^−peak.
    log : ndarray
        (runs,): ln Ẑ.
    standard_error : ndarray
        (runs,): the standard error of ln Ẑ, by the delta method.
    """

    slope: Array
    value: Array
    log: Array
    standard_error: Array


class Estimate(NamedTuple):
    """A divergence in nats with its standard error, (runs,) each."""

    value: Array
    error: Array


@dataclass(frozen=True, eq=False)
class Mixture:
    """Estimates by importance sampling from the mixture r = (q + d)/2, in strata of equal size.

    Where p is a multiple of q, the estimates have no variance. References are in `Audit`.

    weighed : Weighed
        The weights of the draws.
    evidence : Evidence
        The estimate of Z.
    divergence : Estimate
        KL(q ‖ p/Z) in nats, infinite where p is zero at a draw from q.
    inclusive : Estimate
        KL(p/Z ‖ q) in nats.
    undefined : ndarray
        (runs,): the part of defensive draws at which a function of the model is NaN or infinite.
    """

    weighed: Weighed
    evidence: Evidence
    divergence: Estimate
    inclusive: Estimate
    undefined: Array

    @classmethod
    def make(
        cls, log_weights: Array, control: Array, log_ratio: Array, undefined: Array
    ) -> Mixture:
        """Make the estimates from the weights of all draws, (runs, 2S), q's draws first.

        `log_weights` are ln y, `control` is v, and `log_ratio` is ln w; `undefined` is handed on. A
        NumericalError is raised if in some run all draws, or all from q, have density zero.
        """
        weighed = Weighed(log_weights, control, log_ratio)
        _require_draws(weighed)
        evidence = _evidence(weighed)
        relative = weighed.weights / evidence.value[:, None]  # y/Z, whose mean is one as v's is
        known = np.isfinite(log_ratio)
        logs = np.where(known, log_ratio - evidence.log[:, None], 0.0)  # ln w/Z
        surplus = _surplus(weighed, evidence)
        divergence = _divergence(-control * logs, relative - control, surplus, 1.0)
        divergence.value[~np.isfinite(weighed.plain).all(axis=-1)] = np.inf
        inclusive = _divergence(relative * logs, relative - control, surplus, -1.0)
        return cls(weighed, evidence, divergence, inclusive, undefined)

    @cached_property
    def effective_draws(self) -> Array:
        """The effective number of all draws, (Σ y)² / Σ y², (runs,)."""
        return _effective(self.weighed.weights)

    @cached_property
    def effective_sample_size(self) -> Array:
        """The effective number of q's own draws, (Σ w)² / Σ w² with w = p/q, (runs,)."""
        plain = self.weighed.plain
        return _effective(np.exp(plain - plain.max(axis=-1, keepdims=True)))

    @cached_property
    def pareto_k(self) -> Array:
        """The shape k of the generalised Pareto law that fits the tail of q's weights y, (runs,).

        It is −∞ in runs in which all weights w = p/q are equal.
        """
        plain = self.weighed.plain
        equal = np.ptp(plain, axis=-1) <= EQUAL * np.maximum(1.0, np.abs(plain).max(axis=-1))
        shape = pareto_shape(self.weighed.log_weights[:, : plain.shape[-1]])
        return np.where(equal, -np.inf, shape)


def _require_draws(weighed: Weighed) -> None:
    """Raise a NumericalError if in some run all draws, or all from q, have density zero."""
    finite = np.isfinite(weighed.peak) & np.isfinite(weighed.plain.max(axis=-1))
    if not finite.all():
        run = int(np.flatnonzero(~finite)[0])
        raise NumericalError(
            f"run {run}: no draw from the Gaussian answer has a density under the model that "
            "float64 can hold; are its units and noises of a size that fits the data?"
        )


def _evidence(weighed: Weighed) -> Evidence:
    """The estimate Ẑ of the evidence, with v as control variate.

    Where p is a multiple of q, β is Z. A regression through few weights, or on a control that
    hardly varies, may overshoot: β is within 2 ȳ. Where the estimate is not positive all the same,
    the plain mean of y is taken, with β = 0.
    """
    weights, control = weighed.weights, weighed.control
    mean = weights.mean(axis=-1)
    slope = np.clip(_slope(weights, control), -_STEEPEST * mean, _STEEPEST * mean)
    value = mean - slope * (control.mean(axis=-1) - 1.0)
    proper = value > 0.0
    slope, value = np.where(proper, slope, 0.0), np.where(proper, value, mean)
    found = Evidence(slope, value, weighed.peak + np.log(value), np.zeros_like(value))
    return found._replace(standard_error=_error(_surplus(weighed, found)))


def _surplus(weighed: Weighed, evidence: Evidence) -> Array:
    """The terms (y − βv)/Ẑ of all draws, (runs, 2S), which give the error of ln Ẑ.

    `evidence` has Ẑ and the slope β. The mean of the terms is 1 − β/Ẑ, and the standard error of
    this mean is that of ln Ẑ.
    """
    parts = (evidence.slope / evidence.value)[:, None] * weighed.control
    return np.asarray(weighed.weights / evidence.value[:, None] - parts)


def _divergence(values: Array, control: Array, surplus: Array, sign: float) -> Estimate:
    """A divergence in nats with its standard error, (runs,) each, by means of a control variate.

    values: The terms a of the draws, (runs, 2S). Those of KL(q ‖ p/Z) are a = −v ln(w/Ẑ), those of
        KL(p/Z ‖ q) are a = (y/Ẑ) ln(w/Ẑ).
    control: c = y/Ẑ − v, (runs, 2S), whose expected value is zero.
    surplus: The terms u = (y − βv)/Ẑ, (runs, 2S), of whose mean the standard error is that of ln Ẑ.
    sign: 1 for KL(q ‖ p/Z), −1 for KL(p/Z ‖ q).

    Let b be the slope of the regression of a on c. The estimate is ā − b c̄, with means ā and c̄
    over all draws, or zero if that is negative. It depends on ln Ẑ, too, with the derivative g:

        g = b + 1 for KL(q ‖ p/Z),   g = b − 1 − (the estimate) for KL(p/Z ‖ q).

    Its standard error is therefore that of the mean of a − b c + g u.
    """
    slope = _slope(values, control)
    mean = np.maximum(values.mean(axis=-1) - slope * control.mean(axis=-1), 0.0)
    by_evidence = slope + (1.0 if sign > 0.0 else -1.0 - mean)
    rest = values - slope[:, None] * control + by_evidence[:, None] * surplus
    return Estimate(mean, _error(rest))


def _slope(values: Array, control: Array) -> Array:
    """The slope of the regression of values on a control, (runs,); both are (runs, 2S).

    In each stratum both are taken less their means over it. The slope is zero where the control
    does not vary but for rounding.
    """
    halves = (len(values), 2, -1)
    y, v = values.reshape(halves), control.reshape(halves)
    about = v - v.mean(axis=-1, keepdims=True)
    spread = (about * about).sum(axis=(1, 2))
    some = spread > EQUAL**2 * (v * v).sum(axis=(1, 2))
    found = (about * y).sum(axis=(1, 2)) / np.where(some, spread, 1.0)
    return np.where(some, found, 0.0)


def _error(values: Array) -> Array:
    """The standard error of the mean of values (runs, 2S) of two strata of S draws, (runs,)."""
    halves = values.reshape(len(values), 2, -1)
    samples = halves.shape[-1]
    return np.asarray(np.sqrt(halves.var(axis=-1, ddof=1).sum(axis=-1) / (4.0 * samples)))


def _effective(weights: Array) -> Array:
    """The effective number (Σ w)² / Σ w² of draws with weights w (runs, draws), (runs,).

    It is the number of all draws at the most, and exactly that where all w are equal.
    """
    size = weights.sum(axis=-1) ** 2 / (weights**2).sum(axis=-1)
    return np.asarray(np.minimum(size, weights.shape[-1]))
