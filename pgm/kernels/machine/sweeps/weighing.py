"""Robust noise of sightings: weights that agree with the belief that they lead to.

They are weighed at a belief, and taken in anew by their weights, until no weight moves.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from pgm.kernels import step
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.variables import held
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.matrices.protocol import Belief
from pgm.kernels.machine.sweeps.outliers import is_rejected, weight_of
from pgm.kernels.machine.sweeps.sighting import Point, Sighting
from pgm.kernels.machine.sweeps.told import Sensor
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import most, where
from pgm.kernels.settling import REWEIGHINGS, SETTLED, TOLERANCE
from pgm.kernels.step import AnyMatrix


class Weighed(NamedTuple):
    """A sighting's weight, and the square that it is of."""

    weight: Any
    square: Any


def weighed_alone(
    w: Writer, sensor: Sensor, at: Whole, sighting: Sighting, point: Point
) -> tuple[Weighed, Number]:
    """The weight of a step's only sighting, see `Forward.alone`, and whether it moves no more.

    Its square depends on the belief by what that predicts of the reading alone. So turns go on with
    this, which is of as many components as the reading, and take in nothing.
    """
    loss, code = sensor.loss, w.code
    assert loss is not None
    residual = sighting.left
    if point.first is not None:
        residual = residual - sighting.matrix @ (point.mean - point.at)
    before = step.whitened(
        residual, sighting.own.root(), sighting.matrix, point.cov, sighting.error
    )
    weight, square = held(code, 1.0), held(code, 0.0)
    kept = [w.at(array, at) for array in (loss.weights, loss.squares)]
    if point.first is not None:
        with code.when(~point.first):
            weight.set(kept[0].load(0))
            square.set(kept[1].load(0))
    active, left = code.varying(True), code.varying(float("inf"))
    with code.loop(code.whole(REWEIGHINGS)), w.matrices.scratch():
        old, goes_on = weight.get(), active.get()
        found = step.reweighed(before, old, expects=loss.expects).square
        new = weight_of(w, loss, found, sighting.count)
        left.set(where(goes_on, abs(new - old), left.get()))
        weight.set(where(goes_on, new, old))
        square.set(where(goes_on, found, square.get()))
        active.set(left.get() > SETTLED)
        code.leave_unless(code.some(active.get()))
    kept[0].store(0, weight.get())
    kept[1].store(0, square.get())
    return Weighed(weight.get(), square.get()), left.get() <= TOLERANCE


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

    def begins(self, point: Point) -> Number:
        """Whether this is the first turn of a step at its first linearisation."""
        return ~self.again if point.first is None else point.first & ~self.again

    @property
    def may_end(self) -> Number:
        """Whether a turn may be the last: no weight moves, of those that it has found so far."""
        moved = self._w.code.some(self._moved.get() > SETTLED)
        return self._last | (self.again & ~moved)

    @property
    def settled(self) -> Any:
        """Whether no weight moves any more."""
        return self._left.get() <= TOLERANCE

    def weigh(self, sensor: Sensor, at: Whole, sighting: Sighting, point: Point) -> Weighed:
        """A sighting's weight at the last belief, and the square that it is of.

        The weight is one where all begins, and stays so where a gate rejects the sighting.
        """
        loss = sensor.loss
        assert loss is not None
        w, code = self._w, self._w.code
        left = sighting.left - sighting.matrix @ (self.belief.mean - point.at)
        cov = self.belief.cov if loss.expects else None
        root = sighting.own.root()
        square = step.whitened(left, root, sighting.matrix, cov, sighting.error).square
        known = [w.at(array, at) for array in (loss.weights, loss.squares)]
        kept = [w.at(array, at) for array in loss.trial] if self._trial else known
        weight, of = held(code, 1.0), held(code, 0.0)
        with code.when(~self.begins(point)):
            weight.set(known[0].load(0))
            of.set(known[1].load(0))
        if self._trial:
            with code.when(self.again):
                weight.set(kept[0].load(0))
                of.set(kept[1].load(0))
        with code.when(self.again):
            new = weight_of(w, loss, square, sighting.count)
            active, old = self._active.get(), weight.get()
            if sensor.gate is not None:
                active = active & ~is_rejected(w, sensor.gate, at)
            change = where(active, abs(new - old), 0.0)
            self._moved.set(most(change, self._moved.get()))
            weight.set(where(active, new, old))
            of.set(where(active, square, of.get()))
        kept[0].store(0, weight.get())
        kept[1].store(0, of.get())
        return Weighed(weight.get(), of.get())
