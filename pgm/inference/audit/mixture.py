"""Log-evidence and divergences from the Gaussian's draws and as many defensive ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.errors import NumericalError
from pgm.inference.audit.draws import Draws
from pgm.inference.audit.pareto import EQUAL, pareto_shape
from pgm.kernels.arrays import Array


def weigh(draws: Draws) -> tuple[Array, Array]:
    """The log-weights ln p/r, −∞ where p is NaN, and the control q/r, r = (q + d)/2, (runs, S)."""
    log_mixture = np.logaddexp(draws.gaussian, draws.defensive) - np.log(2.0)
    log_weights = np.where(np.isnan(draws.target), -np.inf, draws.target - log_mixture)
    return log_weights, np.exp(draws.gaussian - log_mixture)


@dataclass(frozen=True, eq=False)
class Mixture:
    r"""Evidence by stratified importance sampling with a control variate, (runs,) each.

    Of 2S draws, S from q and S from d, y = p/r and v = q/r for r = (q + d)/2. Since the mean of v
    is one,

    .. math:: \hat Z = \bar y - β (\bar v - 1)

    for the slope β of a regression of y on v within the two strata. Where p is a multiple of q no
    variance is left. `weights` and `control` are y and v, (runs, 2S), of the Gaussian's draws
    first; `peak` is the largest log-weight, and y, β and Ẑ are divided by its exponential. All
    else is as of an `Audit`.

    Sources are those of an `Audit`.
    """

    peak: Array
    weights: Array
    control: Array
    slope: Array
    evidence: Array
    standard_error: Array
    effective_draws: Array
    gaussian_sample_size: Array
    divergence: Array
    divergence_error: Array
    inclusive_divergence: Array
    inclusive_error: Array
    pareto_k: Array
    undefined: Array
    gaussian_log_weights: Array

    @classmethod
    def make(
        cls, log_weights: Array, control: Array, log_ratio: Array, undefined: Array
    ) -> Mixture:
        """Estimate, from ln y, v and ln p/q, (runs, 2S)."""
        samples = log_weights.shape[-1] // 2
        plain = log_ratio[:, :samples]
        peak = log_weights.max(axis=-1)
        if not np.isfinite(peak).all() or not np.isfinite(plain.max(axis=-1)).all():
            finite = np.isfinite(peak) & np.isfinite(plain.max(axis=-1))
            run = int(np.flatnonzero(~finite)[0])
            raise NumericalError(
                f"run {run}: no draw from the Gaussian answer has a density under the model that "
                "float64 can hold; are its units and noises of a size that fits the data?"
            )
        weights = np.exp(log_weights - peak[:, None])
        slope, evidence = _evidence(weights, control)
        relative = weights / evidence[:, None]  # y/Z, whose mean is one as v's is
        surplus = relative - (slope / evidence)[:, None] * control  # what moves ln Z
        log_evidence = peak + np.log(evidence)
        known = np.isfinite(log_ratio)
        logs = np.where(known, log_ratio - log_evidence[:, None], 0.0)  # ln w/Z
        divergence, its_error = _divergence(-control * logs, relative - control, surplus, 1.0)
        divergence[~known[:, :samples].all(axis=-1)] = np.inf
        inclusive, other_error = _divergence(relative * logs, relative - control, surplus, -1.0)
        equal = np.ptp(plain, axis=-1) <= EQUAL * np.maximum(1.0, np.abs(plain).max(axis=-1))
        return cls(
            peak,
            weights,
            control,
            slope,
            evidence,
            _error(surplus),
            _effective(weights),
            _effective(np.exp(plain - plain.max(axis=-1, keepdims=True))),
            divergence,
            its_error,
            inclusive,
            other_error,
            np.where(equal, -np.inf, pareto_shape(log_weights[:, :samples])),
            undefined,
            plain,
        )

    @property
    def log_evidence(self) -> Array:
        """The value ln Ẑ."""
        return self.peak + np.log(self.evidence)


def _evidence(weights: Array, control: Array) -> tuple[Array, Array]:
    """The slope β of the control variate, and the mean weight with it, (runs,)."""
    slope, mean = _slope(weights, control), weights.mean(axis=-1)
    evidence = mean - slope * (control.mean(axis=-1) - 1.0)
    # A regression through few weights may overshoot; their plain mean is positive.
    proper = evidence > 0.0
    return np.where(proper, slope, 0.0), np.where(proper, evidence, mean)


def _divergence(values: Array, control: Array, surplus: Array, sign: float) -> tuple[Array, Array]:
    """The mean of values, v ln Z/w or (y/Z) ln w/Z, with a control variate, and its error.

    The sign says how they change with ln Z.
    """
    slope = _slope(values, control)
    mean = np.maximum(values.mean(axis=-1) - slope * control.mean(axis=-1), 0.0)
    by_evidence = slope + (1.0 if sign > 0.0 else -1.0 - mean)
    rest = values - slope[:, None] * control + by_evidence[:, None] * surplus
    return mean, _error(rest)


def _slope(values: Array, control: Array) -> Array:
    """The slope of a regression within the two halves of the draws, (runs,)."""
    halves = (len(values), 2, -1)
    y, v = values.reshape(halves), control.reshape(halves)
    about = v - v.mean(axis=-1, keepdims=True)
    spread = (about * about).sum(axis=(1, 2))
    found: Array = (about * y).sum(axis=(1, 2)) / np.where(spread > 0.0, spread, 1.0)
    return found


def _error(values: Array) -> Array:
    """The standard error of a mean over both halves of the draws, (runs,)."""
    halves = values.reshape(len(values), 2, -1)
    samples = halves.shape[-1]
    return np.asarray(np.sqrt(halves.var(axis=-1, ddof=1).sum(axis=-1) / (4.0 * samples)))


def _effective(weights: Array) -> Array:
    # Equal weights give exactly the number of draws.
    size = weights.sum(axis=-1) ** 2 / (weights**2).sum(axis=-1)
    return np.asarray(np.minimum(size, weights.shape[-1]))
