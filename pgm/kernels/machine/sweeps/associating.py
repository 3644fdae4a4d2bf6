"""Associations: open sightings are compared with all candidates, and read with the likeliest.

A step's sightings that leave nothing open are taken in first, and then the open ones of one sensor
after another. All of a sensor's are compared, and linearised, at one belief, that before them. With
each candidate a sighting has a *term*: the log-density of its innovation and of the candidate's
prior probability. Where two terms, or a square and its limit, are as close as rounding, other
arithmetic might decide otherwise: of that a sweep is not sure.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan
from typing import Any

from pgm.kernels import step
from pgm.kernels.gaussian import NEARLY_SINGULAR
from pgm.kernels.machine.emitter.variables import held
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps.called import Rows
from pgm.kernels.machine.sweeps.outliers import limit_of
from pgm.kernels.machine.sweeps.reading import Taken, read, taken
from pgm.kernels.machine.sweeps.sighting import Point, Sighting
from pgm.kernels.machine.sweeps.told import Forward, Sensor, chosen
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import least, most, where
from pgm.kernels.step import AnyMatrix

# Terms and squares that differ by less, as a part of their size, may be in another order elsewhere;
# and a number from which on little or nothing can be told.
_CLOSE, _LARGEST = 1e-8, 1e150


def is_open(chain: Forward) -> bool:
    """Whether some sightings of a chain are to be compared with candidates."""
    return any(sensor.candidates is not None for sensor in chain.sensors)


def associated(w: Writer, chain: Forward, at: Whole, mean: AnyMatrix, cov: AnyMatrix) -> Taken:
    """The belief given the measurements of a step, as of `taken`, some of whose sightings are open.

    Its log-density is that with the candidates chosen.
    """
    named = tuple(sensor for sensor in chain.sensors if sensor.candidates is None)
    found = taken(w, replace(chain, sensors=named), at, mean, cov)
    for sensor in chain.sensors:
        if sensor.candidates is None:
            continue
        here = w.matrices.carried(found.moments.mean, found.moments.cov)
        for array, part in zip(sensor.candidates.point, (here.mean, here.cov), strict=True):
            w.keep(array, part, at)
        point = Point(here.mean, here.cov, here.mean, here.cov, None)
        with w.each_sighting(sensor, at) as row:
            found.doubt(_choose(w, sensor, row, point))
            likeliest = chosen(sensor)
            sighting = Sighting.of(w, likeliest, row, point)
            read(w, likeliest, row, sighting, found, point, fresh=sensor.bounds is None)
    return found


def _choose(w: Writer, sensor: Sensor, at: Whole, point: Point) -> Any:
    """Choose a candidate for a sighting, and keep how it is read with it; whether that is sure."""
    of, code, m = sensor.candidates, w.code, w.matrices
    assert of is not None
    ranking, sure = _Ranking(w), code.varying(True)
    with code.loop(code.whole(of.count)) as k, m.scratch():
        first = at * of.count
        rows = Rows(first + k, first, first + of.count)
        sighting = Sighting.of(w, sensor, at, point, rows=rows)
        spread = step.predict(point.cov, sighting.matrix, sighting.noise)
        seen = step.innovation(sighting.left, spread)
        density, line = sighting.density(seen), sighting.line
        fine = line.sure & (seen.share > NEARLY_SINGULAR) & (abs(density) < _LARGEST)
        term = density + w.at(of.shares, k).load(0)
        if of.limits is not None:
            limit = limit_of(w, sensor, of.limits, sighting.count)
            fine = fine & (abs(seen.square - limit) > _CLOSE * limit)
            term = where(seen.square > limit, -inf, term)
        sure.set(sure.get() & fine)
        w.at(of.terms, at).store(k, term)
        # Of nothing measured all terms are alike, and do not matter.
        matters = sighting.count > 0.0 if sensor.missing else w.true
        better = ranking.meet(term, w.at(of.alike, k).load(0), matters)
        with code.when(code.some(better)), m.scratch():
            offset = line.value - line.matrix @ point.at.part(sensor.parents, (0,))
            w.keep(of.matrix, m.chosen(better, line.matrix, w.matrix(of.matrix)))
            w.keep(of.offset, m.chosen(better, offset, w.column(of.offset)))
            w.keep(of.noise, m.chosen(better, line.noise, w.symmetric(of.noise)))
    none = most(w.at(of.others).load(0), w.at(of.others).load(1))
    if of.values is not None:
        values, nothing = w.column(sensor.readings, at), m.constant([[nan]] * sensor.height)
        w.keep(of.values, m.chosen(ranking.best > none, values, nothing))
    return sure.get() & ranking.is_clear(none)


class _Ranking:
    """The largest term of those that were met, and the largest one of candidates unlike its own."""

    def __init__(self, w: Writer) -> None:
        self._best, self._rival = held(w.code, -inf), held(w.code, -inf)
        self._which = held(w.code, -1.0)

    @property
    def best(self) -> Any:
        """The largest term."""
        return self._best.get()

    def meet(self, term: Any, alike: Any, matters: Any) -> Any:
        """Meet a candidate; whether its term is the largest. `alike` is the first one like it."""
        best, rival = self.best, self._rival.get()
        other = (self._which.get() != alike) & matters
        better = term > best
        self._rival.set(where(other, most(least(term, best), rival), rival))
        self._best.set(where(better, term, best))
        self._which.set(where(better, alike, self._which.get()))
        return better

    def is_clear(self, none: Any) -> Any:
        """Whether no rounding chooses between what is likeliest, and all else, `none` too."""
        first = most(self.best, none)
        second = most(least(self.best, none), self._rival.get())
        return ~(first - second <= _CLOSE * (1.0 + abs(first)))
