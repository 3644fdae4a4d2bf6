"""CPDs linearised again at beliefs over all steps, as iterated smoothers do, and kept so."""

from __future__ import annotations

from typing import Any, NamedTuple

from pgm.kernels import step
from pgm.kernels.machine.cpd import Line, keep, linearised
from pgm.kernels.machine.outliers import is_rejected, square_of, weight_of
from pgm.kernels.machine.told import Array, Forward, Motion, Sensor
from pgm.kernels.machine.wholes import Whole
from pgm.kernels.machine.writer import Writer
from pgm.kernels.numbers import Matrix, nearest_whole


class Beliefs(NamedTuple):
    """Beliefs over slices, by row, and covariances of the pairs of the states and the next slice.

    Covariances are None where no CPD is linearised by them.
    """

    mean: Array
    cov: Array | None = None
    joint: Array | None = None


def move(w: Writer, chain: Forward, at: Whole, beliefs: Beliefs, row: Whole) -> None:
    """Linearise the transition at a row of its own, from the belief at a row to that after it."""
    front = chain.states
    before, after = w.column(beliefs.mean, row), w.column(beliefs.mean, row + 1)
    pair = Matrix([*before.part(front, (0,)).rows, *after.rows])
    size, states = pair.shape[0], range(len(front))
    own = joint = _nothing(size)
    if beliefs.cov is not None:
        own = w.symmetric(beliefs.cov, row).part(front, front)
    if beliefs.joint is not None:
        joint = w.symmetric(beliefs.joint, row)
    child = len(front)
    for motion in chain.motions:
        if motion.function is not None:
            places = motion.parents
            within = all(place in states for place in places)
            cov = (own if within else joint).part(places, places)
            line = linearised(w, motion, at, pair.part(places, (0,)), cov)
            line = _on_chart(motion, line, [number for (number,) in pair.rows[child:]])
            keep(w, motion, at, pair.part(places, (0,)), line)
            w.keep(motion.kept, line.noise, at)
        child += motion.height


def read(w: Writer, chain: Forward, at: Whole, beliefs: Beliefs, row: Whole) -> None:
    """Linearise, and weigh, the sightings of a step at the belief at a row."""
    mean = w.column(beliefs.mean, row)
    cov = None if beliefs.cov is None else w.symmetric(beliefs.cov, row)
    for sensor in chain.sensors:
        if sensor.function is None and sensor.loss is None and sensor.moved is None:
            continue
        if sensor.bounds is None:
            _read(w, sensor, at, mean, cov)
            continue
        first, last = w.sightings(sensor, at)
        with w.code.loop(last, first) as sighting:
            _read(w, sensor, sighting, mean, cov)


def _read(w: Writer, sensor: Sensor, at: Whole, mean: Matrix, cov: Matrix | None) -> None:
    places = sensor.parents
    x = mean.part(places, (0,))
    spread = _nothing(len(places)) if cov is None else cov.part(places, places)
    line = linearised(w, sensor, at, x, spread)
    keep(w, sensor, at, x, line)
    readings = [number for (number,) in w.column(sensor.readings, at).rows]
    for k in sensor.angles:
        readings[k] = step.nearest(readings[k], line.value[k, 0])
    w.keep(sensor.moved, Matrix.column(readings), at)
    loss, noise = sensor.loss, line.noise
    if loss is not None:
        known: Any = None
        if sensor.missing or sensor.gate is not None:
            known = [reading == reading for reading in readings]
        if sensor.gate is not None:
            known = [truth & ~is_rejected(w, sensor.gate, at) for truth in known]
        left = Matrix.column(readings) - line.value
        parts = (line.matrix, spread, line.error) if loss.expects else (None, None, None)
        square, count = square_of(w, known, left, line.own, *parts)
        weight = weight_of(w, loss, square, count)
        w.at(loss.weights, at).store(0, weight)
        w.at(loss.squares, at).store(0, square)
        noise = line.own.scaled(1.0 / weight)
        noise = noise if line.error is None else noise + line.error
    w.keep(sensor.kept, noise, at)


def _on_chart(motion: Motion, line: Line, child: list[Any]) -> Line:
    """A linearisation whose angles are within half a turn of those that the child has."""
    value = [number for (number,) in line.value.rows]
    for k in motion.angles:
        value[k] = value[k] + step.TURN * nearest_whole((child[k] - value[k]) / step.TURN)
    return line._replace(value=Matrix.column(value))


def _nothing(size: int) -> Matrix:
    return Matrix([[0.0] * size for _ in range(size)])
