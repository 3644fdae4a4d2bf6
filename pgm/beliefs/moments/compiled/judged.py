"""Points at which a sweep in machine code evaluated functions, whose traces are judged there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

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
    sensor at the `predicted` one, and `again`, in an iterated update, at the one that is known.
    """
    layout, runs = plan.layout, np.flatnonzero(done)
    front, states = layout.state_size, layout.state_places
    for link in plan.transition:
        family = link.family
        if family.compiled is None or not plan.steps:
            continue
        row, run = _rows(family, np.arange(plan.steps), runs)
        before, slice_so_far = known[0][row, run], predicted[0][row + 1, run]
        mean = np.concatenate([before[:, states], slice_so_far], axis=-1)
        cov = np.zeros((len(row), mean.shape[1], mean.shape[1]))
        cov[:, :front, :front] = block(known[1][row, run], states, states)
        cov[:, front:, front:] = predicted[1][row + 1, run]
        _judge(family, link.parents, row, run, mean, cov)
    for sensor in plan.read:
        family = sensor.family
        if family.compiled is None:
            continue
        row, run = _rows(family, np.arange(family.step.size), runs)
        step = family.step[row] - plan.first
        for moments in (predicted, known) if again else (predicted,):
            mean, cov = moments[0][step, run], moments[1][step, run]
            _judge(family, sensor.parents, row, run, mean, cov)


def judge_at(plan: ChainPlan, mean: Array, std: Array) -> None:
    """Judge the traces of a plan where all of it was linearised at means (T+1, runs, n)."""
    cov = std[..., None] * np.eye(std.shape[-1]) * std[..., None, :]
    judge(plan, (mean, cov), (mean, cov), np.ones(plan.runs, dtype=bool))


def _rows(family: Family, rows: Integers, runs: Integers) -> tuple[Integers, Integers]:
    """The rows and runs of a family's evaluations, or, of very many, of a sample of them."""
    assert family.compiled is not None
    every = np.arange(len(rows) * len(runs)) if len(runs) else np.arange(0)
    some = family.compiled.sample(every)
    return rows[some // max(len(runs), 1)], runs[some % max(len(runs), 1)]


def _judge(
    family: Family, parents: Index, row: Integers, run: Integers, mean: Array, cov: Array
) -> None:
    template, rule, answers = family.template, family.lineariser, family.compiled
    assert template is not None
    assert answers is not None
    x, spread = mean[:, parents], block(cov, parents, parents)
    finite = np.isfinite(x).all(axis=-1)
    x, spread, row, run = x[finite], spread[finite], row[finite], run[finite]
    std: Array | None = deviation(spread)
    if family.hidden and isinstance(rule, StatisticalRegression) and not isinstance(rule, Taylor):
        points = rule.points(template.size, template.child.name, 0).points
        lower = roots.root(spread)
        x = x[:, None] + np.nan_to_num(times_transposed(points, lower))
        row, run = (np.repeat(each, x.shape[1]) for each in (row, run))
        x, std = x.reshape(-1, template.size), None
    arguments = []
    for parent, place in zip(template.given, template.places, strict=True):
        if place is not None:
            arguments.append(x[:, place])
            continue
        values = family.inputs[parent]
        arguments.append(values[row if len(values) > 1 else 0, run if values.shape[1] > 1 else 0])
    answers.judge([np.broadcast_to(a, (len(x), a.shape[-1])) for a in arguments], std)
