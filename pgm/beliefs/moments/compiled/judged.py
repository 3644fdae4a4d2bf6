"""Points at which a sweep in machine code evaluated functions, whose traces are judged there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

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
from pgm.linearisation.family import Family
from pgm.linearisers import Taylor
from pgm.linearisers.regression import StatisticalRegression
from pgm.tracing.clearing import Standing, in_order

# Of a chain: means (T+1, runs, n) and covariances (T+1, runs, n, n).
Moments = Sequence[Array]


def judge(
    plan: ChainPlan, known: Moments, predicted: Moments, done: Mask, *, again: bool = False
) -> None:
    """Judge the traces of a plan at the beliefs of its sweep, in runs that are done.

    A transition is evaluated at the belief `known` from the measurements of the step before, a
    sensor at the `predicted` one, or at that which is kept where its sightings are open, and
    `again`, in an iterated update, at the one that is known.
    """
    runs = None if done.all() else np.flatnonzero(done)
    alone = runs is None and plan.runs == 1
    moments = [(known, predicted)] if not again else [(known, predicted), (None, known)]
    for each in moments:
        for family, belief in evaluated(plan, *each, runs=runs):
            _judge(family, belief, alone=alone)


def evaluated(
    plan: ChainPlan,
    known: Moments | None,
    predicted: Moments,
    runs: Integers | None = None,
) -> Iterator[tuple[Family, _Slice | _Pair]]:
    """The families whose traces a sweep has evaluated, with the beliefs at which it did.

    They are of `runs`, None for all. Without `known` beliefs they are the sensors alone.
    """
    for link in plan.transition if known is not None and plan.steps else ():
        if link.family.compiled is not None:
            assert known is not None
            at = _Points.of(link.family, plan.runs, runs)
            yield link.family, _Pair(plan.layout, link.parents, at, known, predicted)
    for sensor in plan.read:
        family = sensor.family
        if family.compiled is not None:
            at = _Points.of(family, plan.runs, runs)
            # Those that are open are linearised first at beliefs that are kept.
            moments = predicted
            if known is not None and isinstance(sensor, OpenSensor):
                moments = sensor.point
            yield family, _Slice(sensor.parents, at, moments, family.step - plan.first)


def judge_at(plan: ChainPlan, mean: Array, std: Array) -> None:
    """Judge the traces of a plan where all of it was linearised at means (T+1, runs, n)."""
    cov = std[..., None] * np.eye(std.shape[-1]) * std[..., None, :]
    judge(plan, (mean, cov), (mean, cov), np.ones(plan.runs, dtype=bool))


class _Points(NamedTuple):
    """The points at which a family was evaluated: the row and the run of each.

    All rows of all runs, if these are None.
    """

    row: Integers | None
    run: Integers | None

    @classmethod
    def of(cls, family: Family, count: int, runs: Integers | None) -> _Points:
        """The points of `runs`, None for all `count`, or, of very many points, some of them."""
        assert family.compiled is not None
        if runs is None and family.compiled.every == 1:
            return cls(None, None)
        count = count if runs is None else len(runs)
        row, run = np.divmod(family.compiled.sample(family.step.size * count), max(count, 1))
        return cls(row, run if runs is None else runs[run])

    def take(self, array: Array, step: Integers | slice) -> Array:
        """An array (T+1, runs, n, ...) at the points, (k, n, ...), of rows of these steps."""
        if self.row is None:
            rows = array[step]
            return rows.reshape(-1, *rows.shape[2:])
        if isinstance(step, slice):
            return array[step][self.row, self.run]
        return array[step[self.row], self.run]

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

    def standing(self, count: int) -> tuple[Places, Places, object]:
        """Where means and variances stand of one run, at so many rows; and what owns the rows."""
        rows = self.step.astype(np.int64, copy=False)
        mean, variance = (
            _picked(_components(each, 0, address(rows)), self.parents) for each in self.moments[:2]
        )
        return mean, variance, rows


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

    def standing(self, count: int) -> tuple[Places, Places, object]:
        """Where means and variances stand of one run, at so many rows; and what owns the rows."""
        order = in_order(count)
        states = self.layout.state_places
        found = []
        for before, later in zip(self.known[:2], self.predicted[:2], strict=True):
            known = _components(before, 0, order[1])
            pair = [*_picked(known, states), *_components(later, 1, order[1])]
            found.append(_picked(pair, self.parents))
        return found[0], found[1], order


def _components(array: Array, first: int, rows: int) -> Places:
    """Where the components of means (T+1, 1, n) stand from row `first` on, or of variances.

    These are the diagonals of (T+1, 1, n, n). `rows` is the address of the points' rows.
    """
    down, _, *own = array.strides
    begin, across = address(array) + first * down, sum(own)
    return [(begin + k * across, down // 8, rows) for k in range(array.shape[-1])]


def _picked(every: Places, places: Index) -> Places:
    return every[places] if isinstance(places, slice) else [every[k] for k in places.tolist()]


def standing(family: Family, belief: _Slice | _Pair) -> Standing:
    """The points at which a trace of one run was evaluated, where they stand in memory."""
    template, answers = family.template, family.compiled
    assert template is not None
    assert answers is not None
    count = family.shape[0]
    mean, variance, rows = belief.standing(count)
    order, every = in_order(count), list[tuple[int, int, int]]()
    for parent, place in zip(template.given, template.places, strict=True):
        if place is not None:
            every += _picked(mean, place)
            continue
        values = family.inputs[parent]
        down, _, across = values.strides
        begin, down = address(values), 0 if len(values) == 1 else down // 8
        every += [(begin + k * across, down, order[1]) for k in range(values.shape[-1])]
    every += [variance[k] for k in answers.places]
    flat = [number for each in every for number in each]
    return Standing(count, flat, True, (rows, order))


def _judge(family: Family, belief: _Slice | _Pair, *, alone: bool) -> None:
    template, rule, answers = family.template, family.lineariser, family.compiled
    assert template is not None
    assert answers is not None
    regressed = isinstance(rule, StatisticalRegression) and not isinstance(rule, Taylor)
    regressed = regressed and bool(family.hidden)
    ready = alone and not regressed and answers.tracer.often
    if ready and answers.clear(standing(family, belief)):
        return
    x = belief.mean
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
        rows = slice(None, None, answers.thin * len(points) if answers.thin > 1 else None)
        x, spread = x[rows], spread[rows]
        known = [None if a is None else a[rows] for a in known]
        x = x[:, None] + np.nan_to_num(times_transposed(points, roots.root(spread)))
        known = [None if a is None else a.repeat(x.shape[1], 0) for a in known]
        x = x.reshape(-1, template.size)
    pairs = zip(template.places, known, strict=True)
    arguments = [x[:, place] if a is None else a for place, a in pairs]
    answers.judge(arguments, None if regressed else spread)
