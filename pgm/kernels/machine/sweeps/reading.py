"""The measurements of a step taken into its belief, one sighting after another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

from pgm.kernels import step
from pgm.kernels.gaussian import NEARLY_SINGULAR
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.matrices.protocol import Belief
from pgm.kernels.machine.sweeps.called import rows_of
from pgm.kernels.machine.sweeps.control import Anchor, Control, Solve, tried
from pgm.kernels.machine.sweeps.cpd import REGULAR
from pgm.kernels.machine.sweeps.outliers import gated, kept_surplus, surplus
from pgm.kernels.machine.sweeps.settling import Settling, moved
from pgm.kernels.machine.sweeps.sighting import Point, Sighting
from pgm.kernels.machine.sweeps.told import Forward, Sensor
from pgm.kernels.machine.sweeps.weighing import Weighed, Weighing, weighed_alone
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import least, where
from pgm.kernels.settling import REWEIGHINGS
from pgm.kernels.step import AnyMatrix

# The part of S (10 + rᵀ S⁻¹ r) that noise has to exceed in all directions. Below, a belief that is
# linearised again, or any, is not known to a billionth of a deviation: an order of sums shows. A
# measurement that leaves a thousandth of each variance is never so sharp.
_CURVED, _STRAIGHT, _MILD = 1e-6, 1e-8, 1e-3
# A length rᵀ S⁻¹ r from which on little or nothing can be told.
_FARTHEST = 1e12


class Counts(NamedTuple):
    """Numbers of the sightings of a step.

    `nis` is the normalised innovation squared of those taken in, `dof` the number of their
    components. `judged` counts the sightings that gates have judged, `rejected` those rejected.
    """

    nis: Any
    dof: Any
    rejected: Any
    judged: Any


class Taken:
    """A belief that takes in measurements: moments, their log-density, and whether it is sure."""

    def __init__(self, w: Writer, mean: AnyMatrix, cov: AnyMatrix, sensors: int = 0) -> None:
        self.moments = w.matrices.carried(mean, cov)
        # Of each sensor, of so many, the normalised innovation squared of its sightings.
        self.squares = [w.code.varying(0.0) for _ in range(sensors)]
        self._density, self._sure = w.code.varying(0.0), w.code.varying(True)
        self._settled = w.code.varying(True)
        self._counts = [w.code.varying(0.0) for _ in Counts._fields]

    @property
    def counts(self) -> Counts:
        """Numbers of the sightings so far."""
        return Counts(*(each.get() for each in self._counts))

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

    def begin(self, mean: AnyMatrix, cov: AnyMatrix) -> None:
        """Begin again, at a predicted belief."""
        self.moments.set(mean, cov)
        self._density.set(0.0)
        self._sure.set(True)
        for each in self._counts:
            each.set(0.0)

    def count(self, *more: Any) -> None:
        """Count a sighting, as `Counts` has it."""
        for each, number in zip(self._counts, more, strict=True):
            each.set(each.get() + number)

    def take(self, mean: AnyMatrix, cov: AnyMatrix, density: Any, sure: Number) -> None:
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


def taken(
    w: Writer, chain: Forward, at: Whole, mean: AnyMatrix, cov: AnyMatrix, *, decided: bool = False
) -> Taken:
    """The belief given the measurements of a step, whose predicted moments are N(mean, cov).

    `decided` says that gates have decided before.
    """
    found = Taken(w, mean, cov, len(chain.squares))
    weighing = None
    if chain.alone is None and any(sensor.weighs for sensor in chain.sensors):
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
    mean: AnyMatrix,
    cov: AnyMatrix,
    weighing: Weighing | None,
) -> None:
    """Linearise again at what was found, until a belief settles."""
    code = w.code
    point, damping, settling = w.matrices.carried(mean, cov), w.settings.load(1), Settling(w)
    most_often = code.variable(code.whole(1))
    with code.when(_are_curved(w, chain, at)):
        most_often.set(w.iterations)
    control = Control(w, chain, at, mean, cov) if chain.controlled else None
    active = code.varying(True)
    with code.loop(most_often.get()) as k:
        active.set(~settling.settled)
        if control is None:
            with code.when(k > 0), w.matrices.scratch():
                _move(w, point, found.moments, damping, settling.settled)
        here = Point(mean, cov, point.mean, point.cov, k == 0)
        _solved(w, chain, at, found, here, weighing)
        with code.when(k > 0), w.matrices.scratch():
            far = moved(w, found.moments.mean, found.moments.cov, point.mean)
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


def _trial(w: Writer, chain: Forward, at: Whole, mean: AnyMatrix, cov: AnyMatrix) -> Solve:
    """The measurements of a step, as they were linearised last, solved with an anchor."""

    def solve(anchor: Anchor) -> tuple[AnyMatrix, Number]:
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
    """Take in the measurements of a step, the robust ones by weights that have settled.

    They settle in turns of a `weighing`, unless the only one is weighed before it is taken in.
    """
    if weighing is None:
        found.begin(point.mean, point.cov)
        _once(w, chain, at, found, point, None)
        return
    weighing.begin()
    # What stays the same in all turns; of several sightings it would have to be kept in memory.
    alone = [each for each in chain.sensors if each.bounds is None and each.called is None]
    shown = {sensor: Sighting.of(w, sensor, at, point) for sensor in alone}
    with w.code.loop(w.code.whole(REWEIGHINGS + 1)) as turn:
        weighing.turn(turn)
        found.begin(point.mean, point.cov)
        _once(w, chain, at, found, point, weighing, shown)
        w.code.leave_unless(weighing.turned(found.moments))
        w.code.leave_unless(w.code.some(found.sure))
    found.settle(weighing.settled)


def _are_curved(w: Writer, chain: Forward, at: Whole) -> Number:
    """Whether some measurement of a step has to be linearised."""
    found = w.code.constant(False).lane(0)
    for sensor in chain.sensors:
        if not sensor.curved:
            continue
        if sensor.bounds is None:
            return w.code.constant(True).lane(0)
        first, last = w.sightings(sensor, at)
        found = found | (first < last)
    return found


def _move(w: Writer, point: Belief, found: Belief, damping: Number, settled: Number) -> None:
    """Move the point of linearisation to the belief that was found, where it has not settled."""

    def mixed(a: AnyMatrix, b: AnyMatrix) -> AnyMatrix:
        between = a.scaled(damping) + b.scaled(1.0 - damping)
        return w.matrices.chosen(settled, a, between)

    point.set(mixed(point.mean, found.mean), mixed(point.cov, found.cov))


def _once(
    w: Writer,
    chain: Forward,
    at: Whole,
    found: Taken,
    point: Point,
    weighing: Weighing | None,
    shown: Mapping[Sensor, Sighting] = MappingProxyType({}),
) -> None:
    """Take in the measurements of a step, linearised at a point, where that is not `shown`."""
    fresh = point.first is None  # no measurement has moved the belief from the point yet
    again = None if weighing is None else weighing.again
    for k, sensor in enumerate(chain.sensors):
        fresh = fresh and sensor.bounds is None
        apart = Apart(w, point) if k and found.squares else None
        with w.each_sighting(sensor, at) as row:
            rows = rows_of(w, sensor, at, row)
            sighting = shown.get(sensor) or Sighting.of(w, sensor, row, point, again, rows)
            weighed = None
            if sensor.weighs and weighing is not None:
                weighed = weighing.weigh(sensor, row, sighting, point)
            elif sensor.weighs:
                weighed, settled = weighed_alone(w, sensor, row, sighting, point)
                found.settle(settled)
            read(w, sensor, row, sighting, found, point, weighed, weighing, apart, fresh=fresh)
        if found.squares:
            found.squares[k].set(found.counts.nis if apart is None else apart.square)
        fresh = False
    if point.anchor is not None:
        found.hold(point.anchor)


class Apart:
    """The sightings of one sensor taken in without those of others, for their NIS by itself."""

    def __init__(self, w: Writer, point: Point) -> None:
        self._moments, self._point = w.matrices.carried(point.mean, point.cov), point
        self._square = w.code.varying(0.0)

    @property
    def square(self) -> Number:
        """The normalised innovation squared of the sightings so far."""
        return self._square.get()

    def take(self, w: Writer, sighting: Sighting, noise: AnyMatrix, rejected: Number) -> None:
        """Take in a sighting of this noise, unless it is rejected."""
        mean, cov, matrix = self._moments.mean, self._moments.cov, sighting.matrix
        residual = sighting.left - matrix @ (mean - self._point.at)
        after = step.update(mean, cov, matrix, residual, noise)
        chosen = w.matrices.chosen
        self._moments.set(chosen(rejected, mean, after.mean), chosen(rejected, cov, after.cov))
        self._square.set(self.square + where(rejected, 0.0, after.square))


def read(
    w: Writer,
    sensor: Sensor,
    at: Whole,
    sighting: Sighting,
    found: Taken,
    point: Point,
    weighed: Weighed | None = None,
    weighing: Weighing | None = None,
    apart: Apart | None = None,
    *,
    fresh: bool = False,
) -> None:
    """Take in a sighting, as it was `weighed` if its noise is robust, in a turn of a `weighing`.

    `fresh` says that no other of its step is taken in yet; `apart` takes in those of its sensor.
    """
    line, noise = sighting.line, sighting.noise
    surplus_of: Callable[[], Any] = float
    if sensor.loss is not None:
        count = sighting.count
        if sensor.weighs:
            assert weighed is not None
            weight, of = weighed
            noise = sighting.weighed(weight)
            noise = noise if sighting.error is None else noise + sighting.error
            if sensor.kept is not None:  # of components that are missing, or rejected, as well
                own = line.own.scaled(1.0 / weight)
                w.keep(sensor.kept, own if line.error is None else own + line.error, at)
            surplus_of = partial(surplus, w, sensor.loss, of, count, weight)
        else:
            surplus_of = partial(kept_surplus, w, sensor.loss, at, count)
    else:
        w.keep(sensor.kept, line.noise, at)
    mean, cov = found.moments.mean, found.moments.cov
    residual = sighting.left
    if not fresh:
        residual = residual - sighting.matrix @ (mean - point.at)
    after = step.update(mean, cov, sighting.matrix, residual, noise)
    whole = step.predict(point.cov, sighting.matrix, noise)
    # Of a turn that is not the last no more is asked than its belief.
    told, mild = w.code.varying(0.0), w.code.varying(True)
    with nullcontext() if weighing is None else w.code.when(weighing.may_end), w.matrices.scratch():
        part = least(
            (_CURVED if sensor.curved else _STRAIGHT) * (10.0 + after.square),
            w.code.constant(_MILD),
        )
        told.set(sighting.density(after) + surplus_of())
        mild.set((after.square < _FARTHEST) & ((noise - whole.scaled(part)).root().share > 0.0))
    density, sharp = told.get(), mild.get()
    if sensor.gate is None:
        sure = line.sure & (after.share > NEARLY_SINGULAR) & sharp
        found.take(after.mean, after.cov, density, sure)
        found.count(after.square, sighting.count, 0.0, 0.0)
        if apart is not None:
            apart.take(w, sighting, noise, w.code.constant(False))
        return
    square, share = after.square, after.share
    if not fresh:
        alone = step.innovation(sighting.left, whole)
        square, share = alone.square, least(alone.share, after.share)
    begins = point.first if weighing is None else weighing.begins(point)
    rejected = gated(w, sensor, at, square, sighting.count, begins)
    sure = line.sure & (share > NEARLY_SINGULAR) & (rejected | sharp)
    found.take(
        w.matrices.chosen(rejected, mean, after.mean),
        w.matrices.chosen(rejected, cov, after.cov),
        where(rejected, 0.0, density),
        sure,
    )
    found.count(
        where(rejected, 0.0, after.square),
        where(rejected, 0.0, sighting.count),
        rejected.number(),
        where(sighting.count > 0.0, 1.0, 0.0),
    )
    if apart is not None:
        apart.take(w, sighting, noise, rejected)
