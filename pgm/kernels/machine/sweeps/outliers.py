"""Sightings that are far off: rejected by gates, or weighed by a robust noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pgm.kernels import step
from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.traces import written
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps.lines import held
from pgm.kernels.machine.sweeps.matrices import Belief
from pgm.kernels.machine.sweeps.told import Array, Gate, Loss, Sensor
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import most, where
from pgm.kernels.step import AnyMatrix

# As of `weights` and `iterated_update`: weights that move by no more have settled; how often
# sightings are weighed at most; and by how much weights may still move at a fixed point.
SETTLED, REWEIGHINGS, TOLERANCE = 1e-10, 200, 1e-6


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


class Weighing:
    """Robust sightings of a step, weighed and taken in again until their weights settle.

    A `trial` leaves the weights that are kept as they are.
    """

    def __init__(self, w: Writer, mean: AnyMatrix, cov: AnyMatrix, *, trial: bool = False) -> None:
        self._w, self._trial = w, trial
        # The belief that was found last, by whose residuals sightings are weighed.
        self.belief = w.matrices.carried(mean, cov)
        self._active, self._moved = w.code.varying(True), w.code.varying(0.0)
        self._left = w.code.varying(float("inf"))
        self.again = self._last = w.code.constant(False).lane(0)

    def begin(self) -> None:
        """Begin with a new linearisation."""
        self._active.set(True)
        self._left.set(float("inf"))

    def turn(self, count: Whole) -> None:
        """Begin a turn: all sightings are taken in, and weighed before from the second one on."""
        self.again, self._last = count > 0, count == REWEIGHINGS
        self._moved.set(0.0)

    def turned(self, found: Belief) -> Number:
        """End a turn that has found a belief; whether another is due."""
        code = self._w.code
        with code.when(self.again):
            self._left.set(where(self._active.get(), self._moved.get(), self._left.get()))
            self._active.set(self._left.get() > SETTLED)
        self.belief.set(found.mean, found.cov)
        return code.some(self._active.get())

    @property
    def may_end(self) -> Number:
        """Whether a turn may be the last: no weight moves, of those that it has found so far."""
        moved = self._w.code.some(self._moved.get() > SETTLED)
        return self._last | (self.again & ~moved)

    @property
    def settled(self) -> Any:
        """Whether no weight moves any more."""
        return self._left.get() <= TOLERANCE

    def weigh(
        self, sensor: Sensor, at: Whole, square: Any, count: Any, begins: Number
    ) -> tuple[Any, Any]:
        """A sighting's weight, and the square that it is of, given its square at the last belief.

        The weight is one when all `begins`, and stays so where a gate rejects the sighting.
        """
        loss = sensor.loss
        assert loss is not None
        w, code = self._w, self._w.code
        known = [w.at(array, at) for array in (loss.weights, loss.squares)]
        kept = [w.at(array, at) for array in loss.trial] if self._trial else known
        weight, of = held(code, 1.0), held(code, 0.0)
        with code.when(~begins):
            weight.set(known[0].load(0))
            of.set(known[1].load(0))
        if self._trial:
            with code.when(self.again):
                weight.set(kept[0].load(0))
                of.set(kept[1].load(0))
        with code.when(self.again):
            new = weight_of(w, loss, square, count)
            active, old = self._active.get(), weight.get()
            if sensor.gate is not None:
                active = active & ~is_rejected(w, sensor.gate, at)
            change = where(active, abs(new - old), 0.0)
            self._moved.set(most(change, self._moved.get()))
            weight.set(where(active, new, old))
            of.set(where(active, square, of.get()))
        kept[0].store(0, weight.get())
        kept[1].store(0, of.get())
        return weight.get(), of.get()


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

    Components that are not `known` do not count. The rest is as of `step.weighed_square`.
    """
    size = float(own.shape[0])
    if known is None:
        return step.weighed_square(left, own.root(), matrix, cov, error), size
    # Without a matrix any does, of which nothing is read.
    truths = w.matrices.truths(known, own.shape[0])
    seen = step.seen(truths, left, own if matrix is None else matrix, own)
    if error is not None:
        error = step.known_part(error, truths)
    slope = None if matrix is None else seen.matrix
    square = step.weighed_square(seen.residual, seen.noise.root(), slope, cov, error)
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
