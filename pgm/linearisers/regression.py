"""Statistical linear regression: sigma points of any rule, one regression."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from math import hypot, pi
from operator import mul
from typing import NoReturn

import numpy as np

from pgm.errors import LinearisationError, NumericalError
from pgm.kernels import gaussian, regression, roots, step
from pgm.kernels.angles import wrap
from pgm.kernels.arrays import (
    Array,
    Integers,
    components_first,
    components_last,
    deviation,
    times_transposed,
)
from pgm.kernels.dense import Dense, DenseRoot, Runs, RunsRoot, StackRoot
from pgm.linearisers.function import BoundFunction
from pgm.linearisers.lineariser import ArrayLineariser, Line, Prepared, apart
from pgm.linearisers.points import Points
from pgm.linearisers.template import FunctionTemplate
from pgm.resources import require_memory

# An error of a larger share of a value's square is none of rounding; nor is one of this part of the
# square of what rounding may be at most, where points are close together.
_PLAIN, _SURELY = 1e-16, 1.0 / 64.0
# The regression on more points than this takes longer to prepare than it saves.
FEW = 64


class StatisticalRegression(ArrayLineariser):
    """Linear regression of a function on sigma points: a rule is only points and weights.

    With points X = μ + L s for a root P = L Lᵀ, values Y, and weights: the mean of y is
    Σ w Y, F solves F L = J with J the regression of Y on s, b makes the line pass through both
    means, and the covariance is that of what the line leaves, Σ w r rᵀ. In directions in which P
    is zero F takes the limit P → 0, the Jacobian at μ. Angles of y are averaged as the value at
    the centre plus the mean of offsets, wrapped about the tangent where they exceed half a turn.
    The covariance is zero in components in which what the line leaves may be rounding, unless their
    own noise is far above it.

    A subclass gives `points`, of mean 0 by their weights of the mean and covariance I by those of
    the covariance. It may say that points are `drawn`, so that this holds but for sampling, that
    they are fresh for each run, or that moments of x are the belief's own.

    References
    ----------
    García-Fernández, Svensson, Morelande & Särkkä, Posterior linearization filter, 2015.

    Examples
    --------
    >>> from pgm.examples import square, y
    >>> class Ends(pgm.StatisticalRegression):
    ...     def points(self, dimension, name, step):
    ...         arm = np.sqrt(dimension) * np.eye(dimension)
    ...         weights = np.full(2 * dimension, 0.5 / dimension)
    ...         return pgm.linearisers.Points(np.vstack([arm, -arm]), weights, weights, False)
    ...
    >>> pgm.infer(pgm.compile(square), {}, lineariser=Ends())[y].mean.round(2)
    array([10.])
    """

    @abstractmethod
    def points(self, dimension: int, name: str, step: int | Integers | None) -> Points:
        """The rule's points for N(0, I).

        Parameters
        ----------
        dimension : int
            Number of components, n.
        name : str
            The name of the CPD's child; with the step, it keys a random rule's draws.
        step : int, ndarray of int or None
            The step, or an array over the belief's leading axes.

        Returns
        -------
        Points

        Raises
        ------
        LinearisationError
            In a call, if those of step 0 have other moments than N(0, I), and are not `drawn`.
        """

    @property
    def fresh_per_run(self) -> bool:
        """Whether each run has points of its own; steps are then always given as an array."""
        return False

    @property
    def drawn(self) -> bool:
        """Whether points are draws, whose moments are nearly those of N(0, I).

        The moments of others, mean and covariance, are checked.
        """
        return False

    @property
    def prior_moments(self) -> bool:
        """Whether the mean and covariance of x are the belief's, rather than the points' own."""
        return False

    def prepare(self, template: FunctionTemplate) -> Prepared:
        """The rule for functions of a template.

        Parameters
        ----------
        template : FunctionTemplate

        Returns
        -------
        Prepared
        """
        return _Regression(self, template)

    def is_semidefinite(self, dimension: int) -> bool:
        """Whether no weight of the covariance is negative, so that it cannot be indefinite.

        Parameters
        ----------
        dimension : int
            Number of components, n.

        Returns
        -------
        bool
            False, too, with `prior_moments`.
        """
        weights = self.points(dimension, "", 0).cov_weights
        return not self.prior_moments and bool((weights >= 0.0).all())

    def cancellation(self, dimension: int) -> float:
        """Rounding of the fitted line relative to the rounding of one value.

        Parameters
        ----------
        dimension : int
            Number of components, n.

        Returns
        -------
        float
            See `Points`; 1/α² of ``Unscented(alpha)``, where α is small.
        """
        return self.points(dimension, "", 0).cancellation


class _Regression:
    def __init__(self, rule: StatisticalRegression, template: FunctionTemplate) -> None:
        self.rule, self.size, self.name = rule, template.size, template.child.name
        self.fresh, self.prior_moments = rule.fresh_per_run, rule.prior_moments
        if not (rule.drawn or self.fresh or self.prior_moments):
            fault = rule.points(self.size, self.name, 0).fault
            if fault:
                raise LinearisationError(
                    f"{rule!r}: its points for {self.size} components are not those of N(0, I): "
                    f"{fault}; of a rule that draws its points, `drawn` is True"
                )

    def __call__(self, function: BoundFunction, mean: Array, cov: Array) -> Line:
        """Linearise at beliefs (n, *batch) and (n, n, *batch)."""
        rule, steps = self.rule, function.step
        if self.fresh:
            if function.group is not None and not function.joint:
                return apart(self, function, mean, cov)
            steps = np.broadcast_to(0 if steps is None else steps, mean.shape[1:])
        points = rule.points(self.size, self.name, steps)
        s = points.points
        shared = s.ndim == 2 and len(s) <= FEW and not self.prior_moments
        root = gaussian.root(cov) if shared else None
        if root is None:
            line = self._generally(function, mean, cov, points)
        else:
            turning = function.turning
            if turning and not points.centred:
                s = points.with_centre  # about which values of angles are
            if isinstance(root, RunsRoot):
                x = _spread(s, mean, root.matrix.array)
                values = function(_runs_first(x))
                line = _fitted(function, turning, x, values, mean, cov, points, root)
            else:
                x = _spread_one(s, mean, root.matrix.array)
                line = _fitted_one(function, turning, x, function(x), mean, cov, points, root)
        if function.group is None or function.joint:
            return line
        return line._replace(error=_within(line.error, function.group))

    def _generally(self, function: BoundFunction, mean: Array, cov: Array, points: Points) -> Line:
        rule, s = self.rule, points.points
        at, spread = components_last(mean, 1), components_last(cov, 2)
        lower = roots.root(spread)
        if not roots.is_proper(lower):
            _refuse(function, cov)
        if s.shape[-2] > FEW:
            require_memory(
                at.size * s.shape[-2],
                f"{s.shape[-2]} points of {rule!r} for the CPD of {function.name} at each of "
                f"{at.size // at.shape[-1]} beliefs",
                "use a rule with fewer points, or give fewer runs to a call",
                error=LinearisationError,
            )
        offsets = times_transposed(s, lower)
        x = at[..., None, :] + offsets
        extra = bool(function.turning) and not points.centred
        values = function(np.concatenate([at[..., None, :], x], axis=-2) if extra else x)
        reference = values[..., 0, :]
        raw = values[..., int(extra) :, :] - reference[..., None, :]
        if any(np.abs(raw[..., k]).max() > np.pi for k in function.turning):
            slopes = function.jacobian(at, deviation(spread))
            for k in function.turning:
                line = (offsets @ slopes[..., k, :, None])[..., 0]
                raw[..., k] = _about(raw[..., k], line, axis=-1)
        root = StackRoot(lower)
        if root.fixed.any():
            root = regression.RangeRoot(lower, deviation(spread))
        weights = points.mean_weights, points.cov_weights
        found = regression.regress(root, s, raw, *weights, known=rule.prior_moments)
        matrix = found.matrix.array
        if isinstance(root, regression.RangeRoot):  # there is more in directions without variance
            matrix = matrix + function.jacobian(at, root.std) @ root.null
        whole = Line(
            components_first(matrix, 2),
            components_first(reference + found.value.vector, 1),
            components_first(found.error.array, 2),
        )
        if rule.prior_moments:
            return whole
        noise = np.array(whole.error)
        known = components_first(found.moment.T.array, 2), components_first(reference, 1)
        values = components_first(raw, 2).swapaxes(0, 1)
        _clear_rounding(function, noise, *known, values, whole.matrix, mean, points.rounding)
        return whole._replace(error=noise)


def _spread_one(s: Array, mean: Array, lower: Array) -> Array:
    """The points x_i (N, n) of `_fitted` at one belief: mean (n,), lower (n, n)."""
    x: Array = s.dot(lower.T)
    x += mean
    return x


def _fitted_one(
    function: BoundFunction,
    turning: Sequence[int],
    x: Array,
    values: Array,
    mean: Array,
    cov: Array,
    points: Points,
    root: DenseRoot,
) -> Line:
    """The regression line of `_fitted` at one belief: x (N, n), mean (n,), cov (n, n)."""
    extra = len(x) - len(points.points)
    reference = values[0]
    raw = (values[1:] if extra else values) - reference
    # Few numbers are compared more quickly one by one.
    if any(max(map(abs, raw[:, k].tolist())) > pi for k in turning):
        slopes, offsets = function.jacobian(mean, gaussian.deviations(cov)), x[extra:] - mean
        for k in turning:
            raw[:, k] = _about(raw[:, k], offsets.dot(slopes[k]), axis=0)
    found = step.regress(root, points.fit, Dense(raw))
    matrix, noise, slope = found.matrix.array, found.error.array, found.moment.T.array
    _clear_rounding(function, noise, slope, reference, raw.T, matrix, mean, points.fitted_rounding)
    return Line(matrix, reference + found.value.array[:, 0], noise)


def _spread(s: Array, mean: Array, lower: Array) -> Array:
    """The points x_i of `_fitted`, (n, N, *batch): mean (n, *batch), lower (n, n, *batch)."""
    batch = mean.shape[1:]
    if len(batch) > 1:
        lower = lower.reshape(*lower.shape[:2], -1)
    x: Array = np.matmul(s, lower).reshape(len(mean), len(s), *batch)
    x += mean[:, None]
    return x


def _runs_first(x: Array) -> Array:
    """Points (n, N, *batch) as functions take them, (*batch, N, n)."""
    return x.transpose(*range(2, x.ndim), 1, 0)


def _fitted(
    function: BoundFunction,
    turning: Sequence[int],
    x: Array,
    values: Array,
    mean: Array,
    cov: Array,
    points: Points,
    root: RunsRoot,
) -> Line:
    """The regression line of a function at beliefs N(μ, P) by a rule whose points all share.

    With P = L Lᵀ and the rule's points s_i (n,) the function is called at x_i = μ + L s_i; x_0 is
    the first of these, or μ where components of f are angles. `step.regress` gives, of the values
    f(x_i) − f(x_0), the slope F, the intercept a and the covariance of the error n. The line is

        y = f(x_0) + a + F (x − μ) + n.

    Components of f that are angles are first moved by whole turns to within π of the function's
    tangent at μ, where values differ by more than π.

    The points `x` are (n, N, *batch), `values` those of the function, (*batch, N, d), whose
    `turning` components are angles. `mean` is (n, *batch), `cov` (n, n, *batch), `root` its root,
    and the line's parts are likewise.
    """
    batch = mean.shape[1:]
    values = values.transpose(-2, -1, *range(len(batch)))
    extra = x.shape[1] - len(points.points)
    reference = values[0]
    # Functions interleave components: along rows of runs all that follows goes faster.
    raw = np.subtract(values[extra:], reference, order="C")
    if any(np.abs(raw[:, k]).max(initial=0.0) > np.pi for k in turning):
        at = components_last(mean, 1)
        slopes = function.jacobian(at, components_last(gaussian.deviations(cov), 1))
        slopes = components_first(slopes, 2)
        offsets = x[:, extra:] - mean[:, None]
        for k in turning:
            line = np.einsum("i...,iN...->N...", slopes[k], offsets)
            raw[:, k] = _about(raw[:, k], line, axis=0)
    found = step.regress(root, points.fit_of_runs, Runs(raw))
    matrix, noise, slope = found.matrix.array, found.error.array, found.moment.T.array
    off, rounding = raw.swapaxes(0, 1), points.fitted_rounding
    _clear_rounding(function, noise, slope, reference, off, matrix, mean, rounding)
    return Line(matrix, reference + found.value.array[:, 0], noise)


def _about(raw: Array, line: Array, axis: int) -> Array:
    """Offsets of an angle of which some exceed half a turn, wrapped about their line."""
    wide = (np.abs(raw) > np.pi).any(axis=axis, keepdims=True)
    return np.where(wide, wrap(raw - line) + line, raw)


def _within(error: Array | None, count: int) -> Array | None:
    """The block-diagonal covariance of the independent errors of several sightings."""
    if error is None:
        return None
    height = len(error) // count
    mask = np.kron(np.eye(count), np.ones((height, height)))
    return error * mask.reshape(*mask.shape, *(1 for _ in error.shape[2:]))


def _refuse(function: BoundFunction, cov: Array) -> NoReturn:
    when = f" at step {function.step}" if isinstance(function.step, int) else ""
    fault = "an indefinite covariance; use a rule with positive weights or more samples"
    if not np.isfinite(cov).all():
        fault = "a covariance beyond the range of float64; give the model other units"
    raise NumericalError(
        f"the belief at which the CPD of {function.name} is linearised{when} has {fault}"
    )


def _clear_rounding(
    function: BoundFunction,
    noise: Array,
    slope: Array,
    reference: Array,
    raw: Array,
    matrix: Array,
    mean: Array,
    share: float,
) -> None:
    """Make the error of a line zero in components in which it may be rounding of the values.

    Of values that lie on their line the slope J and one of them, the reference, tell the size;
    `raw` (d, N, *batch) are the others less that one. A value has summands of |F| |μ| besides, of
    which it may be the difference. Rounding that is far below a component's own noise may stay.
    """
    own = function.template.variances * (function.group or 1)
    plain = max(_PLAIN, _SURELY * share * share)
    if noise.ndim == 2:
        # Few numbers are compared more quickly one by one.
        sizes = map(hypot, reference.tolist(), *slope.T.tolist())
        variances = noise.diagonal().tolist()
        for k, (variance, least, size) in enumerate(zip(variances, own, sizes, strict=True)):
            if variance + least > plain * size * size:
                continue
            summands, variance = abs(reference.item(k)), abs(variance)  # weights may be negative
            if variance > (share * summands) ** 2:
                summands += sum(map(abs, map(mul, matrix[k].tolist(), mean.tolist())))
                summands += max(map(abs, raw[k].tolist()), default=0.0)
                if variance > (share * summands) ** 2:
                    continue
            noise[k], noise[:, k] = 0.0, 0.0
        return
    runs = tuple(range(1, reference.ndim))
    variances = np.einsum("kk...->k...", noise).min(axis=runs, initial=np.inf).tolist()
    values = np.abs(reference).max(axis=runs, initial=0.0).tolist()
    slopes = np.abs(slope).max(axis=tuple(range(1, slope.ndim)), initial=0.0).tolist()
    every = zip(variances, own, values, slopes, strict=True)
    for k, (variance, least, value, most) in enumerate(every):
        if variance + least > plain * (value * value + len(mean) * most * most):
            continue
        summands = np.abs(reference[k]) + np.maximum(raw[k].max(axis=0), -raw[k].min(axis=0))
        real = np.abs(noise[k, k]) > (share * summands) ** 2
        if real.any():
            summands += np.einsum("j...,j...->...", np.abs(matrix[k]), np.abs(mean))
            real = np.abs(noise[k, k]) > (share * summands) ** 2
        if not real.any():
            noise[k], noise[:, k] = 0.0, 0.0
        elif not real.all():
            noise[k], noise[:, k] = np.where(real, noise[k], 0.0), np.where(real, noise[:, k], 0.0)
