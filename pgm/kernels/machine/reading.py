"""The measurements of a step taken into its belief, one sighting after another."""

from __future__ import annotations

from typing import Any, NamedTuple

from pgm.kernels import step
from pgm.kernels.arrays import LOG_2PI
from pgm.kernels.gaussian import NEARLY_SINGULAR
from pgm.kernels.machine.control import Anchor, Control, Solve, tried
from pgm.kernels.machine.cpd import REGULAR, Line, keep, linearised
from pgm.kernels.machine.numbers import Number
from pgm.kernels.machine.outliers import (
    REWEIGHINGS,
    Weighing,
    both_known,
    gated,
    kept_surplus,
    surplus,
)
from pgm.kernels.machine.settling import Settling, moved
from pgm.kernels.machine.told import Forward, Sensor
from pgm.kernels.machine.wholes import Whole
from pgm.kernels.machine.writer import Carried, Writer, chosen
from pgm.kernels.numbers import Matrix, least, where

# The part of S (10 + rᵀ S⁻¹ r) that noise has to exceed in all directions. Below, a belief that is
# linearised again, or any, is not known to a billionth of a deviation: an order of sums shows. A
# measurement that leaves a thousandth of each variance is never so sharp.
_CURVED, _STRAIGHT, _MILD = 1e-6, 1e-8, 1e-3
# A length rᵀ S⁻¹ r from which on little or nothing can be told.
_FARTHEST = 1e12


class Taken:
    """A belief that takes in measurements: its moments, their log-density, and whether it is sure."""

    def __init__(self, w: Writer, mean: Matrix, cov: Matrix) -> None:
        self.moments = Carried(w.code, mean, cov)
        self._density, self._sure = w.code.variable(0.0), w.code.variable(True)
        self._settled = w.code.variable(True)

    @property
    def density(self) -> Number:
        """The log-density of the measurements that are taken in."""
        return self._density.get()

    @property
    def sure(self) -> Number:
        """Whether all of it is right, so far as can be told."""
        return self._sure.get()

    @property
    def settled(self) -> Number:
        """Whether the weights of robust noise have settled."""
        return self._settled.get()

    def begin(self, mean: Matrix, cov: Matrix) -> None:
        """Begin again, at a predicted belief."""
        self.moments.set(mean, cov)
        self._density.set(0.0)
        self._sure.set(True)

    def take(self, mean: Matrix, cov: Matrix, density: Any, sure: Number) -> None:
        """Go on to a belief that knows one measurement more."""
        self.moments.set(mean, cov)
        self._density.set(self.density + density)
        self._sure.set(self.sure & sure)

    def hold(self, anchor: Anchor) -> None:
        """Take in the measurement of an anchor, which has no density."""
        after = anchor.hold(self.moments.mean, self.moments.cov)
        self.take(after.mean, after.cov, 0.0, after.share > REGULAR)

    def doubt(self, sure: Number) -> None:
        """Note that all of it is right only if this is."""
        self._sure.set(self.sure & sure)

    def settle(self, settled: Any) -> None:
        """Note whether weights have settled."""
        self._settled.set(settled)


class Point(NamedTuple):
    """Where the measurements of a step are linearised, and what they are taken into.

    `mean` and `cov` are the predicted moments, `at` and `about` those of the linearisation. `first`
    is whether this is the first linearisation, None if there is one alone. An `anchor` is taken in
    as well.
    """

    mean: Matrix
    cov: Matrix
    at: Matrix
    about: Matrix
    first: Number | None
    anchor: Anchor | None = None


def taken(
    w: Writer, chain: Forward, at: Whole, mean: Matrix, cov: Matrix, *, decided: bool = False
) -> Taken:
    """The belief given the measurements of a step, whose predicted moments are N(mean, cov).

    `decided` says that gates have decided before.
    """
    found = Taken(w, mean, cov)
    weighing = None
    if any(sensor.weighs for sensor in chain.sensors):
        weighing = Weighing(w, mean, cov)
    anchor = None
    if chain.anchor:
        means, std, weight = chain.anchor
        deviations = [s for (s,) in w.column(std, at).rows]
        anchor = Anchor(w.column(means, at), deviations, w.at(weight).load(0))
    if chain.iterated:
        _iterated(w, chain, at, found, mean, cov, weighing)
    else:
        first = w.code.constant(False).lane(0) if decided else None
        _solved(w, chain, at, found, Point(mean, cov, mean, cov, first, anchor), weighing)
    return found


def _iterated(
    w: Writer,
    chain: Forward,
    at: Whole,
    found: Taken,
    mean: Matrix,
    cov: Matrix,
    weighing: Weighing | None,
) -> None:
    """Linearise again at what was found, until a belief settles."""
    code = w.code
    point, damping, settling = Carried(code, mean, cov), w.settings.load(1), Settling(w)
    most_often = code.variable(code.whole(1))
    with code.when(_are_curved(w, chain, at)):
        most_often.set(w.iterations)
    control = Control(w, chain, at, mean, cov) if chain.controlled else None
    active = code.variable(True)
    with code.loop(most_often.get()) as k:
        active.set(~settling.settled)
        if control is None:
            with code.when(k > 0):
                _move(point, found.moments, damping, settling.settled)
        here = Point(mean, cov, point.mean, point.cov, k == 0)
        _solved(w, chain, at, found, here, weighing)
        with code.when(k > 0):
            known = found.moments
            far = moved(known.mean, known.cov.diagonal, point.mean)
            settling.note(k, far, found.settled)
        if control is not None:
            with code.when(most_often.get() > 1):
                parts = point, found.moments, active.get(), settling.settled
                found.doubt(control.step(*parts, _trial(w, chain, at, mean, cov)))
        code.leave_when(code.every(settling.settled))
        code.leave_unless(code.some(found.sure))
    with code.when(most_often.get() > 1):
        if control is not None:  # the means that were accepted last
            found.moments.set(control.shown, found.moments.cov)
        settling.close(most_often.get())


def _trial(w: Writer, chain: Forward, at: Whole, mean: Matrix, cov: Matrix) -> Solve:
    """The measurements of a step, as they were linearised last, solved with an anchor."""

    def solve(anchor: Anchor) -> tuple[Matrix, Number]:
        found, weighing = Taken(w, mean, cov), None
        if any(sensor.weighs for sensor in chain.sensors):
            weighing = Weighing(w, mean, cov, trial=True)
        point = Point(mean, cov, mean, cov, w.code.constant(False).lane(0), anchor)
        _solved(w, tried(chain), at, found, point, weighing)
        return found.moments.mean, found.sure

    return solve


def _solved(
    w: Writer, chain: Forward, at: Whole, found: Taken, point: Point, weighing: Weighing | None
) -> None:
    """Take in the measurements of a step, the robust ones by weights that have settled."""
    if weighing is None:
        found.begin(point.mean, point.cov)
        _once(w, chain, at, found, point, None)
        return
    weighing.begin()
    with w.code.loop(w.code.whole(REWEIGHINGS + 1)) as turn:
        weighing.turn(turn)
        found.begin(point.mean, point.cov)
        _once(w, chain, at, found, point, weighing)
        w.code.leave_unless(weighing.turned(found.moments))
        w.code.leave_unless(w.code.some(found.sure))
    found.settle(weighing.settled)


def _are_curved(w: Writer, chain: Forward, at: Whole) -> Number:
    """Whether some measurement of a step has to be linearised."""
    found = w.code.constant(False).lane(0)
    for sensor in chain.sensors:
        if sensor.function is None:
            continue
        if sensor.bounds is None:
            return w.code.constant(True).lane(0)
        first, last = w.sightings(sensor, at)
        found = found | (first < last)
    return found


def _move(point: Carried, found: Carried, damping: Number, settled: Number) -> None:
    """Move the point of linearisation to the belief that was found, where it has not settled."""
    def mixed(a: Any, b: Any) -> Any:
        return where(settled, a, damping * a + (1.0 - damping) * b)

    def mix(a: Matrix, b: Matrix) -> Matrix:
        return Matrix(
            [mixed(x, y) for x, y in zip(*rows, strict=True)]
            for rows in zip(a.rows, b.rows, strict=True)
        )

    point.set(mix(point.mean, found.mean), mix(point.cov, found.cov))


def _once(
    w: Writer, chain: Forward, at: Whole, found: Taken, point: Point, weighing: Weighing | None
) -> None:
    """Take in the measurements of a step, linearised at a point."""
    fresh = point.first is None  # no measurement has moved the belief from the point yet
    for sensor in chain.sensors:
        if sensor.bounds is None:
            _read(w, sensor, at, found, point, weighing, fresh=fresh)
        else:
            first, last = w.sightings(sensor, at)
            with w.code.loop(last, first) as row:
                _read(w, sensor, row, found, point, weighing)
        fresh = False
    if point.anchor is not None:
        found.hold(point.anchor)


def _read(
    w: Writer,
    sensor: Sensor,
    at: Whole,
    found: Taken,
    point: Point,
    weighing: Weighing | None,
    *,
    fresh: bool = False,
) -> None:
    """Take in a sighting; `fresh` says that no other of its step is taken in yet."""
    parents = sensor.parents
    x = point.at.part(parents, (0,))
    line = linearised(w, sensor, at, x, point.about.part(parents, parents))
    keep(w, sensor, at, x, line)
    values = [number for (number,) in w.column(sensor.readings, at).rows]
    for k in sensor.angles:
        values[k] = step.nearest(values[k], line.value[k, 0])
    w.keep(sensor.moved, Matrix.column(values), at)
    left = Matrix.column(values) - line.value
    sighting = _Sighting.of(w, sensor, line, left, point.at.shape[0], values)
    noise = sighting.noise
    begins = point.first
    if weighing is not None:
        begins = ~weighing.again if begins is None else begins & ~weighing.again
    surplus_of: Any = 0.0
    if sensor.loss is not None:
        count = sighting.count
        if sensor.weighs:
            assert weighing is not None
            assert begins is not None
            belief = weighing.belief
            residual = sighting.left - sighting.matrix @ (belief.mean - point.at)
            cov = belief.cov if sensor.loss.expects else None
            square = step.weighed_square(
                residual, sighting.own, sighting.matrix, cov, sighting.error
            )
            weight, of = weighing.weigh(sensor.loss, at, square, count, begins)
            noise = sighting.own.scaled(1.0 / weight)
            noise = noise if sighting.error is None else noise + sighting.error
            w.keep(sensor.kept, noise, at)
            surplus_of = surplus(w, sensor.loss, of, count, weight)
        else:
            surplus_of = kept_surplus(w, sensor.loss, at, count)
    else:
        w.keep(sensor.kept, line.noise, at)
    mean, cov = found.moments.mean, found.moments.cov
    residual = sighting.left
    if not fresh:
        residual = residual - sighting.matrix @ (mean - point.at)
    after = step.update(mean, cov, sighting.matrix, residual, noise)
    limit = _STRAIGHT if sensor.function is None else _CURVED
    part = least(limit * (10.0 + after.square), w.code.constant(_MILD))
    whole = step.predict(point.cov, sighting.matrix, noise)
    sharp = (after.square < _FARTHEST) & _is_positive(noise - whole.scaled(part))
    density = -0.5 * (after.square + LOG_2PI * sighting.count) - after.volume + surplus_of
    if sensor.gate is None:
        sure = line.sure & (after.share > NEARLY_SINGULAR) & sharp
        found.take(after.mean, after.cov, density, sure)
        return
    square, share = after.square, after.share
    if not fresh:
        root = whole.root()
        white, share = root.solve(sighting.left), least(root.share, after.share)
        square = (white.T @ white)[0, 0]
    rejected = gated(w, sensor, at, square, sighting.count, begins)
    sure = line.sure & (share > NEARLY_SINGULAR) & (rejected | sharp)
    found.take(
        chosen(rejected, mean, after.mean),
        chosen(rejected, cov, after.cov),
        where(rejected, 0.0, density),
        sure,
    )


class _Sighting(NamedTuple):
    """A sighting as linearised: z = value + H (x − m) + e over the whole slice.

    `left` is z − value, `own` and `error` are the covariances of the noise and of the line's error,
    None for zero, and `count` is how many components were measured; others say nothing.
    """

    left: Matrix
    matrix: Matrix
    own: Matrix
    error: Matrix | None
    count: Any

    @classmethod
    def of(
        cls, w: Writer, sensor: Sensor, line: Line, left: Matrix, size: int, values: list[Any]
    ) -> _Sighting:
        """A sighting of some values, as linearised over a slice of so many components."""
        matrix = _widened(line, sensor, size)
        if not sensor.missing:
            return cls(left, matrix, line.own, line.error, float(sensor.height))
        known = [value == value for value in values]
        left, matrix, own = step.seen(known, left, matrix, line.own)
        error = line.error
        if error is not None:
            error = both_known(known, error)
        return cls(left, matrix, own, error, w.sum([truth.number() for truth in known]))

    @property
    def noise(self) -> Matrix:
        """The covariance of e."""
        return self.own if self.error is None else self.own + self.error


def _is_positive(matrix: Matrix) -> Number:
    """Whether a matrix is positive definite."""
    return (matrix[0, 0] > 0.0) & (step.open_share(matrix) > 0.0)


def _widened(line: Line, sensor: Sensor, size: int) -> Matrix:
    """The matrix of a linearisation over the whole slice."""
    if sensor.parents == tuple(range(size)):
        return line.matrix
    place = {parent: k for k, parent in enumerate(sensor.parents)}
    return Matrix(
        [row[place[j]] if j in place else 0.0 for j in range(size)] for row in line.matrix.rows
    )
