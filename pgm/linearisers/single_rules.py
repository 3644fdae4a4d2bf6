"""Taylor's expansion and sigma-point rules at one belief."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgm.kernels import single
from pgm.kernels.angles import wrap
from pgm.kernels.arrays import Array
from pgm.linearisers.function import FunctionTemplate, Lineariser
from pgm.linearisers.regression import Points, StatisticalRegression
from pgm.linearisers.single import Line, Rows, SingleLineariser, Special, checked
from pgm.linearisers.taylor import Taylor

_HALF_TURN = np.pi


def prepare(
    template: FunctionTemplate,
    lineariser: Lineariser,
    given: Sequence[int | None],
    *,
    joint: bool = False,
) -> SingleLineariser | None:
    """A lineariser for one belief at a time; None where there is none but the general one.

    `given` says which rows are the values of each argument, and `joint` whether several sightings
    are one value, rather than one each.
    """
    if not template.size:
        return None
    if type(lineariser) is Taylor:
        return _Tangent(template, given)
    if (
        isinstance(lineariser, StatisticalRegression)
        and type(lineariser).affine is StatisticalRegression.affine
        and not (lineariser.fresh_per_run or lineariser.prior_moments)
    ):
        return _Regression(template, given, lineariser, joint)
    return None


class _Tangent(SingleLineariser):
    """`Taylor` at one belief."""

    def linearise(self, rows: Rows, count: int, step: int, mean: Array, cov: Array) -> Line:
        arguments = self.here(mean, rows, count)
        if count > 1 or self.derivative is None:
            shape = self.value_shape if count == 1 else (count, self.height)
            value = checked(self.function(*arguments), shape).reshape(-1)
            slope = self.slope(arguments, rows, count, mean, cov)
        else:
            value = checked(self.function(*arguments), self.value_shape)
            slope = checked(self.derivative(*arguments), self.slope_shape)
        return slope, value, None


class _Regression(SingleLineariser):
    """A sigma-point rule at one belief."""

    def __init__(
        self,
        template: FunctionTemplate,
        given: Sequence[int | None],
        rule: StatisticalRegression,
        joint: bool,
    ) -> None:
        super().__init__(template, given)
        self.rule, self.joint = rule, joint
        self.name, self.size = template.child.name, template.size
        self.fit: _Fit | None = None

    def linearise(self, rows: Rows, count: int, step: int, mean: Array, cov: Array) -> Line:
        points = self.rule.points(self.size, self.name, step)
        fit = self.fit
        if fit is None or fit.points is not points:
            fit = self.fit = _Fit(points, bool(self.angles))
        lower = single.root(cov)
        if lower is None:
            raise Special
        x = fit.called.dot(lower.T)
        x += mean
        values = self.values(x, rows, count)
        reference = values[0]
        raw = values[fit.first :] - reference
        if wide := self._wide(raw, count):
            arguments = self.here(mean, rows, count)
            slope = self.slope(arguments, rows, count, mean, cov)
            line = (x[fit.first :] - mean).dot(slope[wide].T)
            raw[:, wide] = wrap(raw[:, wide] - line) + line
        return fit.line(raw, reference, lower)

    def _wide(self, raw: Array, count: int) -> list[int]:
        """The angles of sightings whose values turn far, which are wrapped about their line."""
        angles = self.angles
        if count == 1:
            # Few numbers are compared more quickly one by one.
            columns = [raw[:, angle].tolist() for angle in angles]
            turns = any(abs(value) > _HALF_TURN for column in columns for value in column)
            return angles if turns else []
        turned = np.abs(raw.reshape(-1, count, self.height)[..., angles]) > _HALF_TURN
        far = np.flatnonzero(turned.any(axis=(0, 2))).tolist()
        if far and self.joint:
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

    def line(self, raw: Array, reference: Array, lower: Array) -> Line:
        """The line through values, (N, D), less those at the reference, (D,)."""
        average = self.mean_weights.dot(raw)
        left = raw - average
        slope = self.slopes.dot(left)
        left -= self.deviation.dot(slope)
        error = (left.T * self.cov_weights).dot(left)
        value = reference + average - self.centre.dot(slope)
        return single.divide(slope, lower), value, error
