"""Estimates from the Gaussian's draws and as many defensive ones, weighed by their mixture."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import log, sqrt

import numpy as np

from pgm.errors import NumericalError
from pgm.factors import Gaussian
from pgm.inference.audit.draws import Draws
from pgm.kernels import roots, solving
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Index, Integers, Mask, frozen, symmetric, transpose
from pgm.variables import Variable

# Weights that differ by no more than this part are equal but for rounding, and have no tail.
EQUAL = 1e-9


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


# Draws below which a tail has too few points to be fitted.
FEWEST = 25
# The smallest share of the largest weight that the quartile of a tail to be fitted has.
STEEP = 1e-12
# The prior of the shape: this many draws' worth of ½.
PRIOR = 10


def pareto_shape(log_weights: Array) -> Array:
    """The shape k of a generalised Pareto tail of weights, (runs, S) to (runs,).

    The largest M = min(S/5, 3√S) weights less the next one are fitted with the density
    (1 + k x/σ)^(−1/k − 1)/σ, by the posterior mean over a grid of the ratio −k/σ, and k is
    regularised towards ½. Moments of order below 1/k exist. NaN for fewer than 25 draws, −∞ where
    all weights are equal, ∞ where very few are all there is.

    Source: Zhang & Stephens, A new and efficient estimation method for the generalized Pareto
    distribution, 2009; Vehtari et al., of an `Audit`.
    """
    runs, count = log_weights.shape
    if count < FEWEST:
        return np.full(runs, np.nan)
    size = int(min(count / 5, 3 * np.sqrt(count)))
    top = np.sort(np.partition(log_weights, count - size - 1, axis=-1)[:, count - size - 1 :])
    weights = np.exp(top - top[:, -1:])
    excess = weights[:, 1:] - weights[:, :1]
    place = int(size / 4 + 0.5) - 1
    equal = excess[:, -1] <= EQUAL
    steep = ~equal & (excess[:, place] <= STEEP * excess[:, -1])
    excess[equal | steep] = np.arange(1, size + 1) / size  # these are not fitted
    quartile, largest = excess[:, place], excess[:, -1]
    grid = 30 + int(np.sqrt(size))
    ratios = (1.0 - np.sqrt(grid / (np.arange(grid)[:, None] + 0.5))) / (3.0 * quartile)
    ratios = ratios + 1.0 / largest
    shapes = np.array([np.log1p(-ratio[:, None] * excess).mean(axis=-1) for ratio in ratios])
    likelihood = size * (np.log(-ratios / shapes) - shapes - 1.0)
    share = np.exp(likelihood - likelihood.max(axis=0))
    ratio = (ratios * share).sum(axis=0) / share.sum(axis=0)
    shape = np.log1p(-ratio[:, None] * excess).mean(axis=-1)
    shape = (size * shape + 0.5 * PRIOR) / (size + PRIOR)
    return np.where(equal, -np.inf, np.where(steep, np.inf, shape))


@dataclass(frozen=True, eq=False)
class Compared:
    """Exact moments of a belief, estimated, beside the Gaussian's, (steps, runs, ...).

    The divergence is KL(N(mean, cov) ‖ the Gaussian), infinite where draws left no covariance;
    `judged` (steps,) are beliefs that know all measurements, as q does.
    """

    scope: tuple[Variable, ...]
    steps: Integers | None
    mean: Array
    cov: Array
    divergence: Array
    judged: Mask

    def excess(self, draws: Array) -> Array:
        """The largest divergence judged, less what chance may leave, (runs,).

        Moments of n effective draws are χ²/2n nats off, with a degree of freedom for each of them;
        the largest of m is bounded as by Laurent & Massart (2000, lemma 1).
        """
        size = self.mean.shape[-1]
        freedom, spread = 0.5 * size * (size + 3), log(max(int(self.judged.sum()), 1))
        chance = (0.5 * freedom + sqrt(freedom * spread) + spread) / draws
        return np.asarray(self._known.max(axis=0, initial=0.0) - chance)

    @property
    def _known(self) -> Array:
        known = self.judged[:, None] & np.isfinite(self.divergence)
        return np.where(known, self.divergence, 0.0)

    def furthest(self, lead: tuple[int, ...]) -> tuple[float, str]:
        """The largest divergence judged, and where it is, in words."""
        found = self._known
        if not found.size:
            return 0.0, ""
        step, run = np.unravel_index(int(found.argmax()), found.shape)
        scope = self.scope
        if self.steps is not None:
            scope = tuple(each.at(int(self.steps[step])) for each in scope)
        where = ", ".join(str(k) for k in np.unravel_index(run, lead))
        of = f" of run {where}" if lead else ""
        return float(found[step, run]), f"{', '.join(map(repr, scope))}{of}"

    def gaussian(self, lead: tuple[int, ...]) -> Gaussian:
        """The exact moments, stacked over runs, and over steps where there are any."""
        mean, cov = self._stacked(self.mean, lead), self._stacked(self.cov, lead)
        return Gaussian._make(self.scope, mean, cov, self.steps)

    def divergences(self, lead: tuple[int, ...]) -> Array:
        """The divergence, (*lead, steps), or (*lead) in a network without time."""
        return frozen(self._stacked(self.divergence, lead))

    def _stacked(self, values: Array, lead: tuple[int, ...]) -> Array:
        tail = values.shape[2:]
        if self.steps is None:
            return np.asarray(values[0].reshape((*lead, *tail)))
        return np.asarray(values.swapaxes(0, 1).reshape((*lead, len(values), *tail)))


@dataclass(eq=False)
class Sums:
    """Sums over draws of variables at `places` of the vector, whose Gaussian moments are given."""

    scope: tuple[Variable, ...]
    places: Index
    first: int
    mean: Array
    cov: Array
    judged: Mask
    timed: bool
    _offsets: Array = field(init=False)
    _squares: Array = field(init=False)

    def __post_init__(self) -> None:
        self._offsets = np.zeros((2, *self.mean.shape))
        self._squares = np.zeros((2, *self.cov.shape))

    def add(self, values: list[Array], pair: Array, fading: Array) -> None:
        """Take in draws, (runs, S, n) a step, weighed by y and v, (2, runs, S).

        `fading` (runs,) is by how much the largest weight has grown; angles are wrapped.
        """
        self._offsets[0] *= fading[:, None]
        self._squares[0] *= fading[:, None, None]
        angles = np.concatenate([each.angle_mask for each in self.scope])
        for row, drawn in enumerate(values[self.first :]):
            off = difference(drawn[..., self.places], self.mean[row][:, None], angles)
            for kind, weights in enumerate(pair):
                weighted = transpose(off * weights[..., None])
                self._offsets[kind, row] += weighted.sum(axis=-1)
                self._squares[kind, row] += weighted @ off

    def compared(self, mixture: Mixture) -> Compared:
        """The exact moments beside the Gaussian's, which are the control, as for the evidence.

        Where that leaves no covariance, moments are weighted without it. Components in which the
        Gaussian has no variance are not compared.
        """
        lower, slope = roots.root(self.cov), mixture.slope
        total = mixture.weights.shape[-1] * mixture.evidence
        own = (slope / mixture.evidence)[:, None, None] * self.cov
        offset, cov = _moments(
            (self._offsets[0] - slope[:, None] * self._offsets[1]) / total[:, None],
            (self._squares[0] - slope[:, None, None] * self._squares[1]) / total[:, None, None]
            + own,
        )
        divergence = _from_gaussian(lower, offset, cov)
        lost = ~np.isfinite(divergence)
        if lost.any():
            total = mixture.weights.sum(axis=-1)
            plain = _moments(
                self._offsets[0] / total[:, None], self._squares[0] / total[:, None, None]
            )
            offset = np.where(lost[..., None], plain[0], offset)
            cov = np.where(lost[..., None, None], plain[1], cov)
            divergence = np.where(lost, _from_gaussian(lower, *plain), divergence)
        steps = np.arange(self.first, self.first + len(cov)) if self.timed else None
        mean = self.mean + offset
        return Compared(self.scope, steps, mean, cov, divergence, self.judged)


def _moments(offsets: Array, squares: Array) -> tuple[Array, Array]:
    return offsets, symmetric(squares - offsets[..., :, None] * offsets[..., None, :])


def _from_gaussian(lower: Array, offset: Array, cov: Array) -> Array:
    """KL of Gaussians by the second one's root; infinite where the first has no covariance."""
    fixed = roots.determined(lower)
    white = solving.whiten(lower, offset)
    inner = solving.solve_lower(lower, transpose(solving.solve_lower(lower, cov)))
    alone = fixed[..., :, None] | fixed[..., None, :]
    inner = np.where(alone, fixed[..., None] * np.eye(fixed.shape[-1]), symmetric(inner))
    values = np.linalg.eigvalsh(inner)
    proper = (values > 0.0).all(axis=-1)
    logs = np.log(np.where(values > 0.0, values, 1.0))
    total = (values - 1.0 - logs).sum(axis=-1) + (white * white).sum(axis=-1)
    return np.where(proper, 0.5 * total, np.inf)
