"""Iterated updates whose steps are judged by their cost, by Levenberg and Marquardt.

The decisions are those of `schedules.iteration`: the solution of the linearised measurements is
tried first, then solutions that an *anchor*, a measurement of all components, holds near the point
of linearisation. The first that costs no more than this point is the next one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from pgm.kernels import step
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.variables import held
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.matrices.protocol import Belief
from pgm.kernels.machine.sweeps.cpd import REGULAR, linearised, on_branch, value_at
from pgm.kernels.machine.sweeps.outliers import cost_of, is_rejected, square_of
from pgm.kernels.machine.sweeps.told import Forward, Row, Sensor, kept_sensor
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import Matrix, least, most, sqrt, where
from pgm.kernels.step import AnyMatrix

# As of `schedules.iteration`: a rise of the cost that is rounding, and the largest weight.
_NO_WORSE, _HEAVIEST = 1e-13, 1e12
# The least share of a root by whose solutions costs are told apart.
_TOLD_APART = 1e-6


class Anchor(NamedTuple):
    """A measurement of all components: that they are `mean`, with the variances std² / `weight`.

    Components of zero `std` and runs of zero weight are not measured.
    """

    mean: Matrix
    std: list[Any]
    weight: Number

    def hold(self, mean: Matrix, cov: Matrix) -> step.Updated:
        """A belief given the anchor's measurement."""
        weighs = self.weight > 0.0
        held_ = [weighs & (std > 0.0) for std in self.std]
        weight, size = where(weighs, self.weight, 1.0), range(len(held_))
        variances = [where(h, s * s / weight, 1.0) for h, s in zip(held_, self.std, strict=True)]
        left = (self.mean - mean).rows
        return step.update(
            mean,
            cov,
            _diagonal([where(h, 1.0, 0.0) for h in held_]),
            Matrix.column(where(held_[i], left[i][0], 0.0) for i in size),
            _diagonal(variances),
        )


# Solves the measurements of a step, as linearised last, with an anchor; and whether that is sure.
Solve = Callable[[Anchor], tuple[Matrix, Number]]


def tried(chain: Forward) -> Forward:
    """A chain whose sensors are as they were linearised last."""
    sensors = tuple(kept_sensor(sensor, weighed=False) for sensor in chain.sensors)
    return replace(chain, sensors=sensors, iterated=False, controlled=False)


class Control:
    """The control of a step's linearisations, begun at the predicted belief N(mean, cov)."""

    def __init__(self, w: Writer, chain: Forward, at: Whole, mean: Matrix, cov: Matrix) -> None:
        self._w, self._chain, self._at = w, chain, at
        self._start, self._factor = w.settings.load(2), w.settings.load(3)
        self._tries = w.settings.load(4).whole()
        self._weight = held(w.code, self._start)
        self._prior = _Prior(mean, cov)
        self._shown = _vector(w.code, mean)

    @property
    def shown(self) -> Matrix:
        """The means that were accepted last."""
        return _get(self._shown)

    def step(
        self, point: Belief, found: Belief, active: Number, settled: Number, solve: Solve
    ) -> Number:
        """Accept means, in active runs, that cost no more than the point of linearisation.

        `found` is the solution of the measurements linearised at the point, which moves on in runs
        that have not settled. The answer is whether costs are right, so far as can be told.
        """
        code = self._w.code
        here, cov = point.mean, point.cov
        std = [sqrt(most(variance, 0.0)) for variance in found.cov.diagonal]
        candidate, mean = _vector(code, here), _vector(code, here)
        limit, done, sure = code.varying(0.0), code.variable(~active), code.varying(True)
        with code.loop(self._tries + 2) as k:
            with code.when(k == 1):
                _set(candidate, found.mean)
            with code.when(k > 1):
                weight = where(done.get(), 0.0, self._weight.get())
                solved, certain = solve(Anchor(here, std, weight))
                _set(candidate, solved)
                sure.set(sure.get() & certain)
            cost, certain = self._cost(_get(candidate), cov)
            sure.set(sure.get() & certain)
            with code.when(k == 0):
                # A point without a cost is worse than any other.
                limit.set(where(cost == cost, cost + _NO_WORSE * abs(cost), float("inf")))
            with code.when(k > 0):
                old = done.get()
                good = ~old & (cost <= limit.get())
                _set(mean, self._w.matrices.chosen(good, _get(candidate), _get(mean)))
                failed = where(k == 1, 1.0, self._factor)
                change = where(good, 1.0 / self._factor, failed)
                self._weight.set(where(old, self._weight.get(), self._weight.get() * change))
                done.set(old | good)
            code.leave_when(code.every(done.get()))
        weight, heaviest = self._weight.get(), most(self._start, code.constant(_HEAVIEST))
        self._weight.set(where(active, least(most(weight, self._start), heaviest), weight))
        _set(self._shown, self._w.matrices.chosen(active, _get(mean), self.shown))
        m = self._w.matrices
        point.set(m.chosen(settled, here, self.shown), m.chosen(settled, cov, found.cov))
        return sure.get()

    def _cost(self, x: Matrix, cov: Matrix) -> tuple[Any, Number]:
        """The cost of a mean: its own under the predicted belief, and those of all sightings."""
        code = self._w.code
        first, share = self._prior.square(x)
        total, sure = held(code, first), code.variable(self._w.true & (share > _TOLD_APART))
        for sensor in self._chain.sensors:
            with self._w.each_sighting(sensor, self._at) as row:
                square, certain = cost(self._w, sensor, row, x, cov)
                total.set(total.get() + square)
                sure.set(sure.get() & certain)
        return total.get(), sure.get()


class _Prior:
    """The cost of means under N(m, P); components without a variance do not count."""

    def __init__(self, mean: Matrix, cov: Matrix) -> None:
        self._mean, self._open = mean, [variance != 0.0 for variance in cov.diagonal]
        rows = [list(row) for row in cov.rows]
        for i, open_ in enumerate(self._open):
            rows[i][i] = where(open_, rows[i][i], 1.0)
        self._root = Matrix(rows).root()

    def square(self, x: Matrix) -> tuple[Any, Any]:
        """(x − m)ᵀ P⁻¹ (x − m), and the share of P."""
        left = (x - self._mean).rows
        counted = Matrix.column(where(open_, left[i][0], 0.0) for i, open_ in enumerate(self._open))
        white = self._root.solve(counted)
        return (white.T @ white)[0, 0], self._root.share


def cost(w: Writer, sensor: Sensor, at: Whole, x: AnyMatrix, cov: AnyMatrix) -> tuple[Any, Number]:
    """The cost of a sighting at the mean of a slice, and whether it is right, so far as is told.

    It is rᵀ R⁻¹ r of the residual r and the noise R as it was linearised, or twice a robust loss.
    """
    parents, m = sensor.parents, w.matrices
    spread = None if cov is None else cov.part(parents, parents)
    value, sure = expected(w, sensor, at, x.part(parents, (0,)), spread)
    values = on_branch(w, w.column(sensor.readings, at), value, sensor.angles)
    left, kept = values - value, kept_sensor(sensor, weighed=False)
    noise = w.symmetric(kept.noise, at)
    seen: tuple[AnyMatrix, ...] = ()
    if sensor.loss is not None and sensor.loss.expects:
        assert kept.matrix is not None
        seen = w.matrix(kept.matrix, at), spread
    known = [reading == reading for reading in m.beside(values)] if sensor.missing else None
    square, count = square_of(w, known, left, noise, *seen)
    if sensor.loss is not None:
        square = cost_of(w, sensor.loss, square, count)
    if sensor.gate is not None:
        square = where(is_rejected(w, sensor.gate, at), 0.0, square)
    return square, sure & (noise.root().share > REGULAR)


def expected(
    w: Writer, cpd: Row, at: Whole, x: AnyMatrix, cov: AnyMatrix
) -> tuple[AnyMatrix, Number]:
    """The mean of a CPD's child at a row, under a belief over its parents; and whether it is right.

    It is not a number where the function is not defined.
    """
    if cpd.function is not None and (cpd.points is None or not x.shape[0]):
        return value_at(w, cpd, at, x), w.true
    line = linearised(w, cpd, at, x, cov)
    return line.value, line.sure


def _vector(code: Any, numbers: Matrix) -> list[Any]:
    return [held(code, number) for (number,) in numbers.rows]


def _get(variables: list[Any]) -> Matrix:
    return Matrix.column(variable.get() for variable in variables)


def _set(variables: list[Any], numbers: Matrix) -> None:
    for variable, (number,) in zip(variables, numbers.rows, strict=True):
        variable.set(number)


def _diagonal(numbers: list[Any]) -> Matrix:
    size = range(len(numbers))
    return Matrix([numbers[i] if i == j else 0.0 for j in size] for i in size)
