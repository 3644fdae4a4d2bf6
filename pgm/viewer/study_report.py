"""The report of a study: methods beside each other over many runs, in one page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from pgm.comparison.table import shown
from pgm.display import count, number
from pgm.factors.scope import labels
from pgm.io.sources import whole
from pgm.kernels.arrays import Integers
from pgm.variables import Variable
from pgm.viewer.assembly import REPORT as PAGE
from pgm.viewer.assembly import assembled
from pgm.viewer.numbers import REPORT, SHOWN, Numbers, Ref, chosen_steps
from pgm.viewer.sections import LOOK, RIGHT, UNKNOWN, Sheet

if TYPE_CHECKING:
    from pgm.comparison.study_result import Statistic, Study, StudyRow

# Components of a state, and sensors, of which curves are drawn; numbers of runs that are listed.
_CURVES, _RUNS = 6, 12
# A right method leaves the band of one of its figures in one study of a hundred.
_CHANCE = 0.01


@dataclass(frozen=True)
class Series:
    """A method's curve: steps, values, and the ends of their 95 % intervals, (rows, 1) each."""

    name: str
    steps: Ref
    values: Ref
    low: Ref
    high: Ref


@dataclass(frozen=True)
class Chart:
    """The curves of a statistic over time, one a method, and the value of a right belief."""

    title: str
    up: str
    right: float | None
    series: Sequence[Series]


@dataclass(frozen=True)
class Part:
    """A section of the page."""

    title: str
    state: str
    told: str
    words: Sequence[str]
    tables: Sequence[Sheet]
    charts: Sequence[Chart]
    curves: Sequence[Any] = ()


def report(study: Study, path: str | PathLike[str]) -> Path:
    """Write the page that `Study.report` describes."""
    text = assembled(*_content(study), PAGE)
    target = Path(path)
    with whole(target) as beside:
        beside.write_text(text, encoding="utf-8")
    return target


def _content(study: Study) -> tuple[dict[str, Any], Numbers]:
    numbers = Numbers()
    span, cut = chosen_steps(None, study.steps, REPORT)
    draw = _Drawing(numbers, np.arange(span.start, span.stop))
    parts = [_of_runs(study)]
    for state in study.states:
        parts += [_errors(study, state, draw), _consistency(study, state, draw)]
    sensors = _sensors(study, draw)
    parts += [sensors] if sensors else []
    return {
        "title": study._title,
        "facts": [f"seed {study.seed}", f"regions of confidence {number(study.confidence)}"],
        "sections": [asdict(part) for part in parts],
        "chain": None,
        "notes": [cut] if cut else [],
    }, numbers


@dataclass(frozen=True)
class _Drawing:
    """Charts into the numbers of a page, at these steps."""

    numbers: Numbers
    steps: Integers

    def chart(
        self, title: str, rows: Sequence[tuple[str, Statistic]], place: int | None = None
    ) -> Chart:
        """A statistic's chart; of the component at a place, where it has components."""
        every = [self._series(name, statistic, place) for name, statistic in rows]
        right = rows[0][1].expected
        up = title.split(" of ")[0]
        return Chart(title, up, None if np.isnan(right) else float(right), every)

    def _series(self, name: str, statistic: Statistic, place: int | None) -> Series:
        values, error = (
            (each if place is None else each[:, place])[self.steps]
            for each in (statistic.by_step, statistic.error_by_step)
        )
        known = np.flatnonzero(~np.isnan(values))
        values, error = values[known], 1.96 * np.nan_to_num(error[known])
        return Series(
            name, *map(self._column, (self.steps[known], values, values - error, values + error))
        )

    def _column(self, values: npt.ArrayLike) -> Ref:
        return self.numbers.add(np.asarray(values, dtype=np.float64)[:, None], SHOWN)


def _methods(study: Study) -> list[str]:
    return list(dict.fromkeys(row.method for row in study.rows))


def _rows(study: Study, state: Variable) -> list[StudyRow]:
    return [row for row in study.rows if row.state == state]


def _of_runs(study: Study) -> Part:
    """The runs that a method has lost or could not finish, and those to look at first."""
    rows, lines = _rows(study, study.states[0]), []
    for row in rows:
        worst = [
            f"{each.worst}" + (f" ({each.state.name})" if len(study.states) > 1 else "")
            for each in study.rows
            if each.method == row.method and each.worst is not None
        ]
        lines.append(
            (
                row.method,
                f"{row.runs:,}",
                *map(_listed, (row.diverged, row.failed)),
                f"{row.unsettled:,}",
                ", ".join(worst) or "—",
            )
        )
    harmed = []
    for what, each in (
        ("diverged", [len(row.diverged) for row in rows]),
        ("failed", [len(row.failed) for row in rows]),
        ("did not settle", [row.unsettled for row in rows]),
    ):
        if most := max(each):
            harmed.append(f"{most:,} {what} by {rows[each.index(most)].method}")
    words = [
        "A run has diverged where its last belief leaves out the truth, by a region of which a "
        "right belief does so once in a million runs. Its number draws it again: study.run(k) has "
        "its truth and its evidence."
    ]
    heads = ("method", "runs that count", "diverged", "failed", "unsettled", "largest NEES in run")
    told = f"of {count(study.runs, 'run')} at most {', '.join(harmed)}"
    told = told if harmed else f"of {count(study.runs, 'run')} none diverged, none failed"
    return Part("Runs", LOOK if harmed else RIGHT, told, words, [Sheet(heads, lines)], ())


def _listed(runs: Integers) -> str:
    """How many runs, and the numbers of the first of them."""
    if not len(runs):
        return "0"
    few = ", ".join(map(str, runs[:_RUNS].tolist())) + (", …" if len(runs) > _RUNS else "")
    return f"{len(runs):,}: {few}"


def _errors(study: Study, state: Variable, draw: _Drawing) -> Part:
    """RMSE and bias of a state."""
    rows, names = _rows(study, state), labels((state,))
    table = [
        _line(f"{name} {label}{_unit(state, k)}", [getattr(row, what) for row in rows], k)
        for what, name in (("rmse", "RMSE"), ("bias", "bias"))
        for k, label in enumerate(names)
    ]
    charts = [
        draw.chart(f"{name} of {label}{_unit(state, k)}", _of(rows, what), k)
        for what, name in (("rmse", "RMSE"), ("bias", "Bias"))
        for k, label in enumerate(names[:_CURVES])
    ]
    far = _far((row.method, row.bias) for row in rows)
    words = [
        "Errors are beliefs' means less the truth, over all runs and steps, with standard errors "
        "over runs. Bands about curves are 95 % intervals."
    ]
    told = f"biased beyond chance: {', '.join(far)}" if far else "no bias beyond chance"
    title = f"Errors of {state.name}"
    return Part(title, LOOK if far else RIGHT, told, words, [_sheet(study, table)], charts)


def _consistency(study: Study, state: Variable, draw: _Drawing) -> Part:
    """NEES and coverage of a state: whether beliefs are right about their errors."""
    rows = _rows(study, state)
    table = [
        _line("NEES", [row.nees for row in rows]),
        _line("coverage", [row.coverage for row in rows]),
        *([_line("KL [nats]", [row.kl for row in rows])] if rows[0].kl else []),
    ]
    charts = [
        draw.chart(f"NEES of {state.name}", _of(rows, "nees")),
        draw.chart(f"Coverage of {state.name}", _of(rows, "coverage")),
        *([draw.chart(f"KL [nats] of {state.name}", _of(rows, "kl"))] if rows[0].kl else []),
    ]
    # Of the few runs that are far off NEES has large errors, and coverage small ones.
    bold, shy = (
        [
            row.method
            for row in rows
            if row.method in {*_far(_of(rows, "nees"), sign), *_far(_of(rows, "coverage"), -sign)}
        ]
        for sign in (1, -1)
    )
    words = [
        "NEES is the squared error in units of the belief's own covariance. Above its right value "
        "the belief claims to know more than it does; below, less. Coverage is the share of truths "
        "in its regions. With many runs a difference may be beyond chance and still too small to "
        "matter: look at its size."
    ]
    words += [
        f"KL of {row.method}: the oracle is too weak: {row.weak}." for row in rows if row.weak
    ]
    told = "; ".join(
        f"{what}: {', '.join(found)}"
        for what, found in (("too sure", bold), ("not sure enough", shy))
        if found
    )
    state_ = LOOK if told else RIGHT
    if all(np.isnan(row.nees.value) for row in rows):
        state_, told = UNKNOWN, "no covariance by which errors could be judged"
    return Part(
        f"Consistency of {state.name}",
        state_,
        told or "NEES and coverage as of a right belief",
        words,
        [_sheet(study, table)],
        charts,
    )


def _sensors(study: Study, draw: _Drawing) -> Part | None:
    """NIS of each sensor; None where no method has any."""
    rows = _rows(study, study.states[0])
    sensors = list(dict.fromkeys(z for row in rows for z in row.nis))
    if not sensors:
        return None
    every = {z: [(row.method, row.nis[z]) for row in rows if z in row.nis] for z in sensors}
    table = [
        _line(f"NIS {z.name}", [row.nis.get(z) for row in rows], right=every[z][0][1].expected)
        for z in sensors
    ]
    charts = [draw.chart(f"NIS of {z.name}", every[z]) for z in sensors[:_CURVES]]
    words = [
        "NIS is the squared innovation in units of the predicted covariance, of smoothers that of "
        "their forward pass."
    ]
    far = [f"{method} of {z.name}" for z in sensors for method in _far(every[z])]
    told = f"beyond chance: {', '.join(far)}" if far else "NIS as of a right filter"
    sheets = [_sheet(study, table)]
    return Part("Predicted readings", LOOK if far else RIGHT, told, words, sheets, charts)


def _of(rows: Sequence[StudyRow], what: str) -> list[tuple[str, Statistic]]:
    return [(row.method, getattr(row, what)) for row in rows]


def _far(every: Iterable[tuple[str, Statistic]], sign: int = 0) -> list[str]:
    """The methods of which a figure is off beyond chance: to one side (1 above), or either (0)."""
    pairs = list(every)
    values = sum(np.size(statistic.value) for _, statistic in pairs)
    band = ndtri(1.0 - 0.5 * _CHANCE / max(values, 1))
    found = []
    for method, statistic in pairs:
        with np.errstate(invalid="ignore", divide="ignore"):
            errors = np.ravel(statistic.value - statistic.expected) / np.ravel(statistic.error)
        if ((sign * errors if sign else np.abs(errors)) > band).any():
            found.append(method)
    return found


def _line(
    name: str, every: Sequence[Statistic | None], place: int | None = None, right: float = np.nan
) -> tuple[str, ...]:
    """A row of a table: the statistic, its right value, and the value of each method."""
    if np.isnan(right) and every[0] is not None:
        right = every[0].expected
    cells = []
    for each in every:
        if each is None:
            cells.append("—")
            continue
        value, error = (float(np.ravel(v)[place or 0]) for v in (each.value, each.error))
        cells.append(shown(value, error).replace("-", "−"))
    return (name, "" if np.isnan(right) else number(right), *cells)


def _sheet(study: Study, lines: Sequence[Sequence[str]]) -> Sheet:
    return Sheet(("", "right", *_methods(study)), lines)


def _unit(state: Variable, place: int) -> str:
    unit = state.unit_of(state.components[place])
    return f" [{unit}]" if unit else ""
