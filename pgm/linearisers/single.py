"""The library's linearisers at one belief, (n,) and (n, n), without the axes of many.

A filter of a single robot spends most of its time on what surrounds a few small products, so
everything that does not change from step to step is prepared once here. What is out of the
ordinary is left to the general way: it is raised as `Special`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from pgm.kernels import single
from pgm.kernels.angles import wrap
from pgm.kernels.arrays import Array
from pgm.linearisers.function import FunctionTemplate, Lineariser
from pgm.linearisers.regression import Points, StatisticalRegression
from pgm.linearisers.taylor import Taylor

Known = list[Array | None]
_FLOAT = np.dtype(np.float64)
_HALF_TURN = np.pi


class Special(Exception):
    """A case that the general linearisers are for."""


# What became of a function, y = F x + b + n, n ~ N(0, error): F (D, n), b (D,), error (D, D) with
# the covariances between sightings or None, and the value F μ + b; D = d times their number.
Line = tuple[Array, Array, Array | None, Array]
# Which of the rows of evidence: that of one sighting, or those of several.
Row = int | slice


def prepare(
    template: FunctionTemplate, lineariser: Lineariser, *, joint: bool = False
) -> SingleLineariser | None:
    """A lineariser for one belief at a time; None where there is none but the general one.

    `joint` says whether several sightings are one value, rather than one each.
    """
    if not template.size:
        return None
    if type(lineariser) is Taylor:
        return _Tangent(template)
    if (
        isinstance(lineariser, StatisticalRegression)
        and type(lineariser).affine is StatisticalRegression.affine
        and not (lineariser.fresh_per_run or lineariser.prior_moments)
    ):
        return _Regression(template, lineariser, joint)
    return None


class SingleLineariser(ABC):
    """A function and how it is linearised, prepared for one belief at a time."""

    def __init__(self, template: FunctionTemplate) -> None:
        everything = slice(0, template.size)
        self.template, self.function = template, template.function
        # None for a parent that is all there is, which need not be cut out.
        self.places = [
            None if place == everything else place for place in template.places if place is not None
        ]
        self.height = template.child.dimension
        self.angles = np.flatnonzero(template.angles).tolist()
        self.value_shape = (self.height,)
        self.slope_shape = (self.height, template.size)
        # Of a single hidden parent the derivative is all of the Jacobian.
        given = zip(template.places, template.jacobians, strict=True)
        derivatives = [derivative for place, derivative in given if place is not None]
        self.derivative = derivatives[0] if len(derivatives) == 1 else None

    @abstractmethod
    def __call__(
        self, known: Known, row: Row, count: int, step: int, mean: Array, cov: Array
    ) -> Line:
        """Linearise at a belief.

        Parameters
        ----------
        known : list of ndarray or None
            Values (M, d) of the parents with evidence; None for hidden ones.
        row : int or slice
            Which of them: a slice where there are several sightings.
        count : int
            Sightings, which are linearised as one.
        step : int
        mean, cov : ndarray
            (n,) and (n, n).
        """

    def here(self, mean: Array, known: Known, row: Row, count: int) -> list[Array]:
        """What the function is called with at the mean: (d,) or (count, d) each."""
        arguments = []
        places = iter(self.places)
        for values in known:
            if values is not None:
                arguments.append(values[row])
                continue
            place = next(places)
            value = mean if place is None else mean[place]
            arguments.append(value if count == 1 else np.broadcast_to(value, (count, len(value))))
        return arguments

    def around(self, x: Array, known: Known, row: Row, count: int) -> list[Array]:
        """What the function is called with at points (N, n): (N, d) or (N, count, d) each."""
        arguments = []
        places = iter(self.places)
        many = len(x)
        for values in known:
            if values is None:
                place = next(places)
                value = x if place is None else x[:, place]
                if count > 1:
                    value = np.broadcast_to(value[:, None], (many, count, value.shape[1]))
            else:
                value = values[row]
                if count > 1:
                    value = np.broadcast_to(value, (many, *value.shape))
                else:
                    # As broadcast_to makes it, at a fraction of the cost, and as read-only.
                    value = np.ndarray((many, len(value)), _FLOAT, value, 0, (0, value.itemsize))
            arguments.append(value)
        return arguments

    def values(self, x: Array, known: Known, row: Row, count: int) -> Array:
        """The function's values at points (N, n), (N, D)."""
        many = len(x)
        value = self.function(*self.around(x, known, row, count))
        if count == 1:
            return _checked(value, (many, self.height))
        return _checked(value, (many, count, self.height)).reshape(many, -1)

    def slope(
        self, arguments: list[Array], known: Known, row: Row, count: int, mean: Array, cov: Array
    ) -> Array:
        """The Jacobian at the mean, (D, n), where the arguments are."""
        template = self.template
        numerical = None
        if template.numerical:
            points, steps = single.difference_points(mean, cov)
            values = self.values(points, known, row, count)
            numerical = single.differences(values, steps, self.angles_of(count))
            if len(template.numerical) == template.size:
                return numerical
        lead = () if count == 1 else (count,)
        parts = []
        for parent, place, derivative in zip(
            template.given, template.places, template.jacobians, strict=True
        ):
            if place is None:
                continue
            if derivative is None:
                assert numerical is not None
                parts.append(numerical[:, place])
                continue
            width = parent.dimension
            part = _checked(derivative(*arguments), (*lead, self.height, width))
            parts.append(part.reshape(-1, width))
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def angles_of(self, count: int) -> list[int]:
        """Which components of a value are angles."""
        if count == 1 or not self.angles:
            return self.angles
        return [k * self.height + angle for k in range(count) for angle in self.angles]


class _Tangent(SingleLineariser):
    """`Taylor` at one belief."""

    def __call__(
        self, known: Known, row: Row, count: int, step: int, mean: Array, cov: Array
    ) -> Line:
        arguments = self.here(mean, known, row, count)
        if count > 1 or self.derivative is None:
            shape = self.value_shape if count == 1 else (count, self.height)
            value = _checked(self.function(*arguments), shape).reshape(-1)
            slope = self.slope(arguments, known, row, count, mean, cov)
        else:
            value = _checked(self.function(*arguments), self.value_shape)
            slope = _checked(self.derivative(*arguments), self.slope_shape)
        # A function may return an array that it keeps.
        return slope, value - slope.dot(mean), None, value.copy()


class _Regression(SingleLineariser):
    """A sigma-point rule at one belief."""

    def __init__(
        self, template: FunctionTemplate, rule: StatisticalRegression, joint: bool
    ) -> None:
        super().__init__(template)
        self.rule, self.joint = rule, joint
        self.name, self.size = template.child.name, template.size
        self.fit: _Fit | None = None

    def __call__(
        self, known: Known, row: Row, count: int, step: int, mean: Array, cov: Array
    ) -> Line:
        points = self.rule.points(self.size, self.name, step)
        fit = self.fit
        if fit is None or fit.points is not points:
            fit = self.fit = _Fit(points, bool(self.angles))
        lower = single.root(cov)
        if lower is None:
            raise Special
        x = fit.called.dot(lower.T)
        x += mean
        values = self.values(x, known, row, count)
        reference = values[0]
        raw = values[fit.first :] - reference
        if wide := self._wide(raw, count):
            arguments = self.here(mean, known, row, count)
            slope = self.slope(arguments, known, row, count, mean, cov)
            line = (x[fit.first :] - mean).dot(slope[wide].T)
            raw[:, wide] = wrap(raw[:, wide] - line) + line
        return fit.line(raw, reference, lower, mean)

    def _wide(self, raw: Array, count: int) -> list[int]:
        """The angles of sightings whose values turn far, which are wrapped about their line."""
        angles = self.angles
        if not angles or (raw.min() >= -_HALF_TURN and raw.max() <= _HALF_TURN):
            return []
        turned = np.abs(raw.reshape(-1, count, self.height)[..., angles]) > _HALF_TURN
        far = np.flatnonzero(turned.any(axis=(0, 2))).tolist()
        if far and self.joint and count > 1:
            raise Special
        return [k * self.height + angle for k in far for angle in angles]


class _Fit:
    """The regression on a rule's points, as far as it does not depend on the values."""

    def __init__(self, points: Points, angles: bool) -> None:
        s, mean_weights, cov_weights, centred = points
        if s.ndim != 2:
            raise Special
        self.points = points
        # Values are compared with the one at the centre, which not every rule has.
        extra = angles and not centred
        self.first = int(extra)
        self.called = np.concatenate([np.zeros((1, s.shape[1])), s]) if extra else s
        self.mean_weights, self.cov_weights = mean_weights, cov_weights
        self.centre = mean_weights.dot(s)
        self.deviation = s - self.centre
        weighted = (cov_weights[:, None] * self.deviation).T
        try:
            self.slopes = np.linalg.solve(weighted.dot(self.deviation), weighted)
        except np.linalg.LinAlgError:
            raise Special from None

    def line(self, raw: Array, reference: Array, lower: Array, mean: Array) -> Line:
        """The line through values, (N, D), less those at the reference, (D,)."""
        average = self.mean_weights.dot(raw)
        left = raw - average
        slope = self.slopes.dot(left)
        left -= self.deviation.dot(slope)
        error = (left.T * self.cov_weights).dot(left)
        matrix = single.divide(slope, lower)
        value = reference + average - self.centre.dot(slope)
        return matrix, value - matrix.dot(mean), error, value


def _checked(value: Any, due: tuple[int, ...]) -> Array:
    """What a user's function returned; what is not as it should be is left to the general way."""
    if type(value) is np.ndarray and value.dtype is _FLOAT and value.shape == due:
        return value
    array = np.asarray(value)
    if array.shape != due or array.dtype.kind not in "fiub":
        raise Special
    return array.astype(np.float64)
