"""The rows of a study, from the sums over all of its runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pgm.comparison.judgement import BAND
from pgm.comparison.study_methods import Method
from pgm.comparison.study_oracle import errors_of
from pgm.comparison.study_result import Statistic, StudyRow
from pgm.comparison.sums import Sums, far
from pgm.comparison.tally import Tally
from pgm.comparison.weakness import SAME
from pgm.display import count
from pgm.kernels.arrays import Array
from pgm.variables import Variable


def rows_of(
    sums: Mapping[str, Sums],
    methods: Mapping[str, Method],
    states: Sequence[Variable],
    confidence: float,
) -> list[StudyRow]:
    """A row for each method and state, marked where the oracle is too weak for its KL."""
    with far():
        rows = list(_rows(sums, methods, states, confidence))
    return [row if row.kl is None else replace(row, weak=_weak(row, rows)) for row in rows]


def _rows(
    sums: Mapping[str, Sums],
    methods: Mapping[str, Method],
    states: Sequence[Variable],
    confidence: float,
) -> Iterator[StudyRow]:
    for name, (lineariser, schedule, belief) in methods.items():
        tallies, runs, diverged, failed, unsettled, worst, doubtful = sums[name]
        for each in (diverged, failed, doubtful):
            each.flags.writeable = False
        nis = {
            z: _statistic(tally, float(tallies["dof", z].over_all()[0]))
            for (what, z), tally in tallies.items()
            if what == "nis"
        }
        for state in states:
            its = {what: tally for (what, v), tally in tallies.items() if v == state}
            kl, error, error_by_step = None, np.nan, np.full(len(its["nees"].known), np.nan)
            if "kl" in its:
                kl = _statistic(its["kl"])
                error, error_by_step = errors_of(its)
            error_by_step.flags.writeable = False
            yield StudyRow(
                name,
                lineariser,
                schedule,
                state,
                schedule.kind,
                runs,
                _root(_statistic(its["square"])),
                _statistic(its["error"], 0.0),
                _statistic(its["nees"], float(state.dimension)),
                _statistic(its["held"], confidence),
                nis,
                diverged,
                failed,
                unsettled,
                worst[state][1] if worst[state][0] > -np.inf else None,
                belief,
                kl,
                error,
                error_by_step,
                doubtful,
            )


def _weak(row: StudyRow, rows: Sequence[StudyRow]) -> str:
    """Why the oracle is too weak for a row's KL, in words; empty where it is not."""
    assert row.kl is not None
    if len(row.doubtful):
        return (
            f"its beliefs are not to be trusted in {count(len(row.doubtful), 'run')}, such as "
            f"{row.doubtful[0]}"
        )
    if np.isnan(row.kl_error):
        return "its Monte Carlo error is not known"
    value = float(row.kl.value)
    others = [
        float(each.kl.value)
        for each in rows
        if each is not row and each.kl and (each.state, each.kind) == (row.state, row.kind)
    ]
    gaps = [abs(value - other) for other in others]
    due, band = max(gaps, default=abs(value)), BAND * row.kl_error
    if band >= max(due, SAME):
        what = "differences between methods are" if gaps else "KL itself is"
        return f"its KL is known to ± {band:.2g} nats, and the {what} {due:.2g}"
    return ""


def _statistic(tally: Tally, expected: float = np.nan) -> Statistic:
    value, error = map(np.asarray, tally.over_all())
    by_step, error_by_step = tally.by_step()
    for each in (value, error, by_step, error_by_step):
        each.flags.writeable = False
    return Statistic(value, error, by_step, error_by_step, expected)


def _root(squares: Statistic) -> Statistic:
    """The root of mean squares, with its errors to first order."""

    def root(square: Array, error: Array) -> tuple[Array, Array]:
        value = np.asarray(np.sqrt(square))
        return value, np.divide(error, 2.0 * value, out=np.array(error), where=value > 0.0)

    return Statistic(
        *root(squares.value, squares.error), *root(squares.by_step, squares.error_by_step)
    )
