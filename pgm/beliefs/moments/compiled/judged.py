"""Points at which a sweep in machine code evaluated functions, whose traces are judged there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.steps.open_sensor import OpenSensor
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Index, Integers, Mask, block, deviation, times_transposed
from pgm.linearisation.family import Family
from pgm.linearisers import Taylor
from pgm.linearisers.regression import StatisticalRegression

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
    layout, runs = plan.layout, None if done.all() else np.flatnonzero(done)
    front, states, span = layout.state_size, layout.state_places, np.arange(plan.steps)
    for link in plan.transition:
        family = link.family
        if family.compiled is None or not plan.steps:
            continue
        at = _Points.of(family, plan.runs, runs)
        before, later = at.moments(known, span), at.moments(predicted, span + 1)
        mean = np.concatenate([before[0][:, states], later[0]], axis=-1)
        cov = np.zeros((*mean.shape, mean.shape[1]))
        cov[:, :front, :front] = block(before[1], states, states)
        cov[:, front:, front:] = later[1]
        _judge(family, link.parents, at, mean, cov)
    for sensor in plan.read:
        family = sensor.family
        if family.compiled is None:
            continue
        at = _Points.of(family, plan.runs, runs)
        step = family.step - plan.first
        first = sensor.point if isinstance(sensor, OpenSensor) else predicted
        for moments in (first, known) if again else (first,):
            _judge(family, sensor.parents, at, *at.moments(moments, step))


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
        runs = np.arange(count) if runs is None else runs
        some = family.compiled.sample(np.arange(family.step.size * len(runs)))
        return cls(some // max(len(runs), 1), runs[some % max(len(runs), 1)])

    def moments(self, moments: Moments, step: Integers) -> tuple[Array, Array]:
        """Means (k, n) and covariances (k, n, n) at the points, of rows of these steps."""
        mean, cov = moments[:2]
        if self.row is None:
            size = mean.shape[-1]
            return mean[step].reshape(-1, size), cov[step].reshape(-1, size, size)
        where = step[self.row], self.run
        return mean[where], cov[where]

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


def _judge(family: Family, parents: Index, at: _Points, mean: Array, cov: Array) -> None:
    template, rule, answers = family.template, family.lineariser, family.compiled
    assert template is not None
    assert answers is not None
    x, spread = mean[:, parents], block(cov, parents, parents)
    known = [
        None if place is not None else at.inputs(family.inputs[parent], family.shape[:2])
        for parent, place in zip(template.given, template.places, strict=True)
    ]
    finite = np.isfinite(x).all(axis=-1)
    if not finite.all():
        x, spread = x[finite], spread[finite]
        known = [None if a is None else a[finite] for a in known]
    std: Array | None = None
    if family.hidden and isinstance(rule, StatisticalRegression) and not isinstance(rule, Taylor):
        points = rule.points(template.size, template.child.name, 0).points
        lower = roots.root(spread)
        x = x[:, None] + np.nan_to_num(times_transposed(points, lower))
        known = [None if a is None else a.repeat(x.shape[1], 0) for a in known]
        x = x.reshape(-1, template.size)
    else:
        std = deviation(spread)
    pairs = zip(template.places, known, strict=True)
    answers.judge([x[:, place] if a is None else a for place, a in pairs], std)
