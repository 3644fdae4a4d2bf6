"""Sightings that are far off: the gates that reject them, and the losses of robust noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pgm.kernels import step
from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.traces import written
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps.told import Array, Gate, Loss, Sensor
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import where
from pgm.kernels.step import AnyMatrix


def gated(
    w: Writer, sensor: Sensor, at: Whole, square: Any, count: Any, first: Number | None
) -> Any:
    """Whether a sighting is rejected by its square at the predicted belief.

    It is decided at the `first` linearisation of a step, where there are several.
    """
    gate = sensor.gate
    assert gate is not None

    def decide() -> Any:
        rejected = square > limit_of(w, sensor, gate.limits, count)
        w.at(gate.squares, at).store(0, where(count > 0.0, square, w.code.constant(float("nan"))))
        w.at(gate.rejected, at).store(0, where(rejected, 1.0, 0.0))
        return rejected

    if first is None:
        return decide()
    with w.code.when(first):
        decide()
    return is_rejected(w, gate, at)


def limit_of(w: Writer, sensor: Sensor, limits: Array, count: Any) -> Any:
    """The largest square of a sighting of which so many components were measured."""
    by_count = w.at(limits)
    limit = w.code.constant(0.0) + by_count.load(sensor.height)
    if sensor.missing:
        for k in range(sensor.height):
            limit = where(count == float(k), by_count.load(k), limit)
    return limit


def is_rejected(w: Writer, gate: Gate, at: Whole) -> Any:
    """Whether a gate has rejected a sighting."""
    return w.at(gate.rejected, at).load(0) != 0.0


def surplus(w: Writer, loss: Loss, square: Any, count: Any, weight: Any) -> Any:
    """The robust log-density of a sighting, less that of N(0, R / w)."""
    return _by_count(w, loss.surplus, count, [square, weight])


def square_of(
    w: Writer,
    known: Sequence[Number] | None,
    left: AnyMatrix,
    own: AnyMatrix,
    matrix: AnyMatrix = None,
    cov: AnyMatrix = None,
    error: AnyMatrix = None,
) -> tuple[Any, Any]:
    """The square of a residual by its noise, and how many components it is of.

    Components that are not `known` do not count. The rest is as of `step.whitened`.
    """
    size = float(own.shape[0])
    if known is None:
        return step.whitened(left, own.root(), matrix, cov, error).square, size
    # Without a matrix any does, of which nothing is read.
    truths = w.matrices.truths(known, own.shape[0])
    seen = step.seen(truths, left, own if matrix is None else matrix, own)
    if error is not None:
        error = step.known_part(error, truths)
    slope = None if matrix is None else seen.matrix
    square = step.whitened(seen.residual, seen.noise.root(), slope, cov, error).square
    return square, size - w.sum([1.0 - truth.number() for truth in known])


def weight_of(w: Writer, loss: Loss, square: Any, count: Any) -> Any:
    """The weight of a sighting whose residual has this square."""
    return _by_count(w, loss.weight, count, [square])


def cost_of(w: Writer, loss: Loss, square: Any, count: Any) -> Any:
    """The cost of a sighting whose residual has this square: twice its loss."""
    return _by_count(w, loss.cost, count, [square])


def kept_surplus(w: Writer, loss: Loss, at: Whole, count: Any) -> Any:
    """The surplus of a sighting whose weight was found before."""
    weight, square = w.at(loss.weights, at).load(0), w.at(loss.squares, at).load(0)
    return surplus(w, loss, square, count, weight)


def _by_count(w: Writer, functions: Sequence[Function], count: Any, given: list[Any]) -> Any:
    """The value of a trace that depends on how many components were measured."""
    values = [
        written(w.code, function, function.value, lambda k, _: given[k])[0]
        for function in functions
    ]
    found = values[-1]
    for k, value in enumerate(values[:-1]):
        found = where(count == float(k), value, found)
    return found
