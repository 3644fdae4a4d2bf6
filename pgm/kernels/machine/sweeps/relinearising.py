"""CPDs linearised again at beliefs over all steps, as iterated smoothers do, and kept so.

What is written tells whether linearisations are right, so far as can be told.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from pgm.kernels import step
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps.cpd import Line, keep, linearised, readings
from pgm.kernels.machine.sweeps.outliers import is_rejected, square_of, weight_of
from pgm.kernels.machine.sweeps.told import Array, Forward, Linearised, Motion, Sensor
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.step import AnyMatrix

# A number from which on little or nothing can be told.
_LARGEST = 1e150
Steps = Forward | Linearised


class Beliefs(NamedTuple):
    """Beliefs over slices, by row, and covariances of the pairs of the states and the next slice.

    Covariances are None where no CPD is linearised by them.
    """

    mean: Array
    cov: Array | None = None
    joint: Array | None = None


def written(w: Writer, chain: Linearised) -> Number:
    """Write the linearisation of all steps."""
    code, beliefs = w.code, Beliefs(*chain.point)
    sure = code.varying(True)
    with code.loop(w.last + 1) as at, w.matrices.scratch():
        with code.when(at > 0), w.matrices.scratch():
            sure.set(sure.get() & move(w, chain, at - 1, beliefs, at - 1))
        sure.set(sure.get() & read(w, chain, at, beliefs, at))
    return sure.get()


def pair_at(
    w: Writer, chain: Steps, beliefs: Beliefs, row: Whole
) -> Iterator[tuple[Motion, AnyMatrix, AnyMatrix, AnyMatrix]]:
    """The CPDs of a transition from one row to the next, with the moments of their parents.

    Covariances are None where no CPD needs them. The last are the means of their children.
    """
    front = chain.states
    before, after = w.column(beliefs.mean, row), w.column(beliefs.mean, row + 1)
    pair, own, joint = w.matrices.above(before.part(front, (0,)), after), None, None
    if beliefs.cov is not None:
        own = w.symmetric(beliefs.cov, row).part(front, front)
    if beliefs.joint is not None:
        joint = w.symmetric(beliefs.joint, row)
    child = 0
    for motion in chain.motions:
        places, last = motion.parents, child + motion.height
        cov = joint if max(places, default=0) >= len(front) else own
        cov = None if cov is None else cov.part(places, places)
        yield motion, pair.part(places, (0,)), cov, after.part(range(child, last), (0,))
        child = last


def move(w: Writer, chain: Steps, at: Whole, beliefs: Beliefs, row: Whole) -> Number:
    """Linearise the transition at a row of its own, from the belief at a row to that after it."""
    sure = w.true
    for motion, mean, cov, child in pair_at(w, chain, beliefs, row):
        if motion.function is not None:
            line = _on_chart(w, motion, linearised(w, motion, at, mean, cov), child)
            keep(w, motion, at, mean, line)
            w.keep(motion.kept, line.noise, at)
            sure = sure & _is_sure(w, line)
    return sure


def read(w: Writer, chain: Steps, at: Whole, beliefs: Beliefs, row: Whole) -> Number:
    """Linearise, and weigh, the sightings of a step at the belief at a row."""
    mean = w.column(beliefs.mean, row)
    cov = None if beliefs.cov is None else w.symmetric(beliefs.cov, row)
    sure = w.code.varying(True)
    for sensor in chain.sensors:
        if sensor.function is None and sensor.loss is None and sensor.moved is None:
            continue
        with w.each_sighting(sensor, at) as sighting:
            sure.set(sure.get() & _read(w, sensor, sighting, mean, cov))
    return sure.get()


def _read(w: Writer, sensor: Sensor, at: Whole, mean: AnyMatrix, cov: AnyMatrix) -> Number:
    places, m = sensor.parents, w.matrices
    x, spread = mean.part(places, (0,)), None if cov is None else cov.part(places, places)
    line = linearised(w, sensor, at, x, spread)
    keep(w, sensor, at, x, line)
    values = readings(w, sensor, at, line.value)
    loss, noise = sensor.loss, line.noise
    if loss is not None:
        known: Any = None
        if sensor.missing or sensor.gate is not None:
            known = [value == value for value in m.beside(values)]
        if sensor.gate is not None:
            rejected = is_rejected(w, sensor.gate, at)
            known = [truth & ~rejected for truth in known]
        parts = (line.matrix, spread, line.error) if loss.expects else (None, None, None)
        square, count = square_of(w, known, values - line.value, line.own, *parts)
        weight = weight_of(w, loss, square, count)
        w.at(loss.weights, at).store(0, weight)
        w.at(loss.squares, at).store(0, square)
        noise = line.own.scaled(1.0 / weight)
        noise = noise if line.error is None else noise + line.error
    w.keep(sensor.kept, noise, at)
    return _is_sure(w, line)


def _is_sure(w: Writer, line: Line) -> Number:
    """Whether a linearisation is finite, and right so far as can be told."""
    m = w.matrices
    numbers = [abs(x) for x in m.beside(line.value)]
    for i in range(line.value.shape[0]):
        numbers += [abs(x) for x in m.row(line.matrix, i)]
    finite: Number = w.sum(numbers) < _LARGEST
    return line.sure & finite


def _on_chart(w: Writer, motion: Motion, line: Line, child: AnyMatrix) -> Line:
    """A linearisation whose angles are within half a turn of those that the child has."""
    value, near = line.value, {}
    for k in motion.angles:
        x = value[k, 0]
        near[k] = x + step.turns(child[k, 0] - x)
    return line._replace(value=w.matrices.replaced(value, near))
