"""Points at which a sweep in machine code evaluated functions, whose traces are judged there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.steps.open_sensor import OpenSensor
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile import SliceLayout
from pgm.kernels import roots
from pgm.kernels.arrays import (
    Array,
    Index,
    Integers,
    Mask,
    address,
    block,
    times_transposed,
    variances,
)
from pgm.kernels.machine.sweeps.chain import kept_runs
from pgm.linearisation.family import Family
from pgm.linearisers import Taylor
from pgm.linearisers.regression import StatisticalRegression
from pgm.tracing.clearing import Standing, in_order

# Of a chain: means (T+1, runs, n) and covariances (T+1, runs, n, n).
Moments = Sequence[Array]


def judge(
    plan: ChainPlan,
    known: Moments,
    predicted: Moments,
    done: Mask,
    *,
    again: bool = False,
    thinned: int = 1,
) -> None:
    """Judge the traces of a plan at the beliefs of its sweep, in runs that are done.

    A transition is evaluated at the belief `known` from the measurements of the step before, a
    sensor at the `predicted` one, or at that which is kept where its sightings are open, and
    `again`, in an iterated update, at the one that is known. Where `predicted` beliefs are thinned,
    those of `kept_runs` alone, traces are judged at these runs.
    """
    runs = None if done.all() else np.flatnonzero(done)
    moments = [(known, predicted)] if not again else [(known, predicted), (None, known)]
    for each in moments:
        for family, belief in evaluated(plan, *each, runs=runs, thinned=thinned):
            _judge(family, belief)


def evaluated(
    plan: ChainPlan,
    known: Moments | None,
    predicted: Moments,
    runs: Integers | None = None,
    thinned: int = 1,
) -> Iterator[tuple[Family, Belief]]:
    """The families whose traces a sweep has evaluated, with the beliefs at which it did.

    They are of `runs`, None for all. Without `known` beliefs they are the sensors alone.
    """
    for link in plan.transition if known is not None and plan.steps else ():
        if link.family.compiled is not None:
            assert known is not None
            at = _Points.of(link.family, plan.runs, runs, thinned)
            yield link.family, _Pair(plan.layout, link.parents, at, known, predicted)
    for sensor in plan.read:
        family = sensor.family
        if family.compiled is not None:
            at = _Points.of(family, plan.runs, runs, thinned)
            # Those that are open are linearised first at beliefs that are kept.
            moments = predicted
            if known is not None and isinstance(sensor, OpenSensor):
                moments = sensor.point
            yield family, _Slice(sensor.parents, at, moments, family.step - plan.first)


def judge_at(plan: ChainPlan, mean: Array, std: Array) -> None:
    """Judge the traces of a plan where all of it was linearised at means (T+1, runs, n)."""
    at = mean, diagonal(std)
    judge(plan, at, at, np.ones(plan.runs, dtype=bool))


def diagonal(std: Array) -> Array:
    """The covariances (T+1, runs, n, n) of independent components of these deviations."""
    cov: Array = std[..., None] * np.eye(std.shape[-1]) * std[..., None, :]
    return cov


class _Points(NamedTuple):
    """The points at which a family was evaluated: the row and the run of each.

    All rows of all runs, if these are None. Arrays are of all `runs`, or of those that are kept of
    `thinned` ones, among which a run has another place.
    """

    row: Integers | None
    run: Integers | None
    runs: int
    place: Integers | None = None

    @classmethod
    def of(cls, family: Family, every: int, runs: Integers | None, thinned: int) -> _Points:
        """The points of `runs`, None for `every` one, or, of very many points, some of them."""
        assert family.compiled is not None
        if thinned > 1:
            kept = kept_runs(every, thinned)
            places = np.arange(len(kept))
            if runs is not None:
                places = places[np.isin(kept, runs)]
            some = family.compiled.sample(family.step.size * len(places), thinned)
            row, k = np.divmod(some, max(len(places), 1))
            return cls(row, kept[places[k]], every, places[k])
        if runs is None and family.compiled.every == 1:
            return cls(None, None, every)
        count = every if runs is None else len(runs)
        row, run = np.divmod(family.compiled.sample(family.step.size * count), max(count, 1))
        return cls(row, run if runs is None else runs[run], every)

    def take(self, array: Array, step: Integers | slice) -> Array:
        """An array (T+1, runs, n, ...) at the points, (k, n, ...), of rows of these steps."""
        if self.row is None:
            rows = array[step]
            return rows.reshape(-1, *rows.shape[2:])
        run = self.run if self.place is None or array.shape[1] == self.runs else self.place
        if isinstance(step, slice):
            return array[step][self.row, run]
        return array[step[self.row], run]

    def inputs(self, values: Array, shape: tuple[int, ...]) -> Array:
        """Values (rows or 1, runs or 1, d) at the points, (k, d), by rows and runs."""
        if self.row is not None:
            assert self.run is not None
            rows, runs = values.shape[:2]
            found = values[self.row if rows > 1 else 0, self.run if runs > 1 else 0]
            return np.broadcast_to(found, (len(self.row), found.shape[-1]))
        if values.shape[:2] != shape:
            values = np.broadcast_to(values, (*shape, values.shape[2]))
        return values.reshape(-1, values.shape[2])


# Components of points in memory: addresses, floats from row to row, and the addresses of rows.
Places = list[tuple[int, int, int]]


class _Rows(NamedTuple):
    """Rows of arrays (T+1, runs, ...) in memory: all runs of some rows, or of all from `first`.

    `rows` are of int64, and `begin` is where they stand.
    """

    rows: npt.NDArray[np.int64]
    begin: int
    first: int = 0

    def components(self, array: Array, kept: list[object]) -> Places:
        """Where the components of means (T+1, runs or 1, n) stand, or of variances.

        These are the diagonals of (T+1, runs or 1, n, n). `kept` gets what owns memory for that.
        """
        return self.of(array, array.shape[1], kept)

    def of(self, array: Array, runs: int, kept: list[object]) -> Places:
        """The same of an array (rows or 1, runs or 1, n), of so many runs."""
        (down, side, *own), (count, width, size, *_) = array.strides, array.shape
        begin, across = address(array) + self.first * down, sum(own)
        down, side = down // 8 if count > 1 else 0, side // 8 if width > 1 else 0
        rows = self.begin
        if runs > 1:  # a point is a row of a run
            every = (down * self.rows[:, None] + side * np.arange(runs)).ravel()
            kept.append(every)
            down, rows = 1, address(every)
        return [(begin + k * across, down, rows) for k in range(size)]


class _Slice(NamedTuple):
    """The beliefs over the parents of a sensor at points: of the slices of these steps."""

    parents: Index
    at: _Points
    moments: Moments
    step: Integers

    @property
    def mean(self) -> Array:
        """The means, (k, n)."""
        return self.at.take(self.moments[0], self.step)[:, self.parents]

    @property
    def std(self) -> Array:
        """The standard deviations, (k, n)."""
        own = self.at.take(variances(self.moments[1]), self.step)[:, self.parents]
        return np.sqrt(np.maximum(own, 0.0))

    @property
    def cov(self) -> Array:
        """The covariances, (k, n, n)."""
        return block(self.at.take(self.moments[1], self.step), self.parents, self.parents)

    def standing(self, count: int, kept: list[object]) -> tuple[Places, Places]:
        """Where means and variances stand at so many rows; `kept` gets what owns the rows."""
        rows = self.step.astype(np.int64, copy=False)
        kept.append(rows)
        where = _Rows(rows, address(rows))
        mean, variance = (
            _picked(where.components(each, kept), self.parents) for each in self.moments[:2]
        )
        return mean, variance

    def of_sweep(self, known: Moments | None, predicted: Moments) -> _Slice:
        """The beliefs of another sweep."""
        return self._replace(moments=predicted)


class _Pair(NamedTuple):
    """The beliefs over the parents of a CPD of a transition at points, of pairs.

    They are of the states, as they are `known` a step before, and of the slice as it is predicted,
    and told as if these were independent.
    """

    layout: SliceLayout
    parents: Index
    at: _Points
    known: Moments
    predicted: Moments

    def _of(self, known: Array, predicted: Array) -> Array:
        """Numbers of components, (T+1, runs, n), of the parents at the points."""
        before = self.at.take(known, slice(-1))[:, self.layout.state_places]
        if isinstance(self.parents, slice) and self.parents.stop <= self.layout.state_size:
            return before[:, self.parents]
        later = self.at.take(predicted, slice(1, None))
        return np.concatenate([before, later], axis=-1)[:, self.parents]

    @property
    def mean(self) -> Array:
        """The means, (k, n)."""
        return self._of(self.known[0], self.predicted[0])

    @property
    def std(self) -> Array:
        """The standard deviations, (k, n)."""
        own = self._of(variances(self.known[1]), variances(self.predicted[1]))
        return np.sqrt(np.maximum(own, 0.0))

    @property
    def cov(self) -> Array:
        """The covariances, (k, n, n)."""
        front, states = self.layout.state_size, self.layout.state_places
        before = block(self.at.take(self.known[1], slice(-1)), states, states)
        later = self.at.take(self.predicted[1], slice(1, None))
        size = front + later.shape[-1]
        cov = np.zeros((len(later), size, size))
        cov[:, :front, :front], cov[:, front:, front:] = before, later
        return block(cov, self.parents, self.parents)

    def standing(self, count: int, kept: list[object]) -> tuple[Places, Places]:
        """Where means and variances stand at so many rows; `kept` gets what owns the rows."""
        order = in_order(count)
        before, later = _Rows(*order), _Rows(*order, 1)
        found = []
        for known, predicted in zip(self.known[:2], self.predicted[:2], strict=True):
            states = _picked(before.components(known, kept), self.layout.state_places)
            pair = [*states, *later.components(predicted, kept)]
            found.append(_picked(pair, self.parents))
        return found[0], found[1]

    def of_sweep(self, known: Moments | None, predicted: Moments) -> _Pair:
        """The beliefs of another sweep."""
        assert known is not None
        return self._replace(known=known, predicted=predicted)


# The beliefs at points.
Belief = _Slice | _Pair


def _picked(every: Places, places: Index) -> Places:
    return every[places] if isinstance(places, slice) else [every[k] for k in places.tolist()]


def standing(family: Family, belief: Belief) -> Standing:
    """The points at which a trace was evaluated, all rows of all runs, where they stand."""
    template, answers = family.template, family.compiled
    assert template is not None
    assert answers is not None
    (count, runs), kept = family.shape[:2], list[object]()
    mean, variance = belief.standing(count, kept)
    order, every = _Rows(*in_order(count)), list[tuple[int, int, int]]()
    kept.append(order)
    for parent, place in zip(template.given, template.places, strict=True):
        if place is None:
            every += order.of(family.inputs[parent], runs, kept)
        else:
            every += _picked(mean, place)
    every += [variance[k] for k in answers.places]
    flat = [number for each in every for number in each]
    return Standing(count * runs, flat, True, kept)


def is_regressed(family: Family) -> bool:
    """Whether a function is evaluated at points that are drawn about a belief's mean."""
    rule = family.lineariser
    by_points = isinstance(rule, StatisticalRegression) and not isinstance(rule, Taylor)
    return by_points and bool(family.hidden)


def laid_out(family: Family, belief: Belief, thin: int = 1) -> tuple[list[Array], Array | None]:
    """The points at which a function was evaluated, (k, width) of each argument.

    The deviations (k, n) by which derivatives are judged are None where none was used. Of the
    beliefs about which points are drawn, so many are thinned out to one.
    """
    template, rule = family.template, family.lineariser
    assert template is not None
    x, regressed = belief.mean, is_regressed(family)
    known = [
        None if place is not None else belief.at.inputs(family.inputs[parent], family.shape[:2])
        for parent, place in zip(template.given, template.places, strict=True)
    ]
    spread = belief.cov if regressed else belief.std
    if not np.isfinite(x.sum()):
        finite = np.isfinite(x).all(axis=-1)
        x, spread = x[finite], spread[finite]
        known = [None if a is None else a[finite] for a in known]
    if regressed:
        assert isinstance(rule, StatisticalRegression)
        points = rule.points(template.size, template.child.name, 0).points
        # Of very many points, of which a belief has several, some are judged.
        rows = slice(None, None, thin * len(points) if thin > 1 else None)
        x, spread = x[rows], spread[rows]
        known = [None if a is None else a[rows] for a in known]
        x = x[:, None] + np.nan_to_num(times_transposed(points, roots.root(spread)))
        known = [None if a is None else a.repeat(x.shape[1], 0) for a in known]
        x = x.reshape(-1, template.size)
    pairs = zip(template.places, known, strict=True)
    return [x[:, place] if a is None else a for place, a in pairs], None if regressed else spread


def _judge(family: Family, belief: Belief) -> None:
    answers = family.compiled
    assert answers is not None
    whole = belief.at.row is None and not is_regressed(family)
    if whole and answers.tracer.often and answers.clear(standing(family, belief)):
        return
    answers.judge(*laid_out(family, belief, answers.thin))
