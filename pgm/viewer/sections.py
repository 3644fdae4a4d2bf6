"""The sections of a report: each judges a posterior by evidence of one kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.consistency import Average, anees, anis, coverage, ranking, rmse
from pgm.display import LEFT_OUT, count, number, places
from pgm.errors import EvidenceError, PgmError, Unanswered
from pgm.factors import Gaussian
from pgm.factors.scope import listed
from pgm.inference import Posterior
from pgm.kernels.arrays import Array
from pgm.posteriors.nonlinearity import WRONG
from pgm.posteriors.status import ENOUGH_DIGITS
from pgm.variables import Discrete, Variable
from pgm.viewer.numbers import SHOWN, Numbers, Ref, Run

# What a section finds: nothing against the answer, something to look at, or nothing either way.
RIGHT, LOOK, UNKNOWN = "right", "look", "unknown"
# Sensors and states of which curves are drawn, and rows of a table.
_CURVES, _ROWS = 4, 40
_Rows = Sequence[Sequence[str]]
_FIGURES, _CONVERGENCE, _DIGITS = "Figures of the beliefs", "Convergence", "Numerical digits"
_LOST, _LINES = "Lost stretches", "Linearisation"
_SENSORS = "Sensors, by their innovations"


@dataclass(frozen=True)
class Sheet:
    """A table of words."""

    heads: Sequence[str]
    rows: _Rows


@dataclass(frozen=True)
class Curve:
    """A statistic at steps, with the band that a right belief keeps to and the steps marked in it.

    `log` draws it in decades. Values and bands are (rows, 1) among the page's numbers.
    """

    title: str
    across: str
    up: str
    steps: Ref
    values: Ref
    low: Ref | None = None
    high: Ref | None = None
    log: bool = False
    marked: Sequence[tuple[int, int]] = ()


@dataclass(frozen=True)
class Section:
    """The judgement of a posterior by one kind of evidence, for a section of a report.

    told: In a line, for the top of the page.
    """

    title: str
    state: str
    told: str
    words: Sequence[str] = ()
    tables: Sequence[Sheet] = ()
    curves: Sequence[Curve] = field(default_factory=tuple)


def sections(
    posterior: Posterior[Any], truth: Mapping[Variable, Array], numbers: Numbers
) -> list[dict[str, Any]]:
    """All sections of a report, for JSON.

    One to which a family has no answer says why in a line; one that does not apply is None.
    """
    made: list[tuple[str, Callable[[], Section | None]]] = [
        ("Verdict", lambda: _verdict(posterior)),
        (_FIGURES, lambda: _figures(posterior)),
        (_CONVERGENCE, lambda: _convergence(posterior, numbers)),
        (_DIGITS, lambda: _digits(posterior)),
        (_LOST, lambda: _lost(posterior)),
        (_LINES, lambda: _linearisation(posterior)),
        (_SENSORS, lambda: _sensors(posterior, numbers)),
        ("Against the truth", lambda: _truth(posterior, truth, numbers)),
    ]
    found = []
    for title, make in made:
        try:
            section = make()
        except Unanswered as error:
            section = _unknown(title, str(error))
        if section is not None:
            found.append(asdict(section))
    return found


def _unknown(title: str, why: str) -> Section:
    return Section(title, UNKNOWN, f"not known: {why}")


def stretches(posterior: Posterior[Any]) -> dict[Run, list[tuple[int, int]]]:
    """The first and last steps of the stretches at which each run was lost; none if not known."""
    found: dict[Run, list[tuple[int, int]]] = {}
    try:
        for each in posterior.lost.stretches:
            found.setdefault(each.run, []).append((each.first, each.last))
    except Unanswered:
        pass
    return found


def _verdict(posterior: Posterior[Any]) -> Section | None:
    """The verdict of `pgm.estimate`; None of a posterior of another call."""
    verdict = posterior.verdict
    if verdict is None:
        return None
    words = [line.strip() for line in str(verdict).splitlines()[1:]]
    every = bool(verdict.vouched.all())
    return Section("Verdict", RIGHT if every else LOOK, verdict.headline, words)


def _figures(posterior: Posterior[Any]) -> Section | None:
    """The figures by which a family of beliefs tells how good they are; None of one without."""
    status = posterior.status
    if not status.numbers:
        return None
    told, *words = (line.strip() for line in str(status).splitlines())
    return Section(_FIGURES, UNKNOWN, told.removeprefix("Status(").removesuffix(")"), words)


def _convergence(posterior: Posterior[Any], numbers: Numbers) -> Section:
    status = posterior.status
    converged, residuals = np.asarray(status.converged), np.asarray(status.residuals)
    every = bool(converged.all())
    if status.numbers and not len(residuals):
        return _unknown(_CONVERGENCE, "these beliefs have the figures above, and no residuals")
    if not len(residuals):
        if every:
            told = "nothing to iterate"
        else:
            told = "linearised once: how far it is from settled is not known"
        return Section(_CONVERGENCE, RIGHT if every else UNKNOWN, told)
    flat = residuals.reshape(len(residuals), -1)
    last = number(float(flat[-1].max(initial=0.0)), 3)
    runs = f"{int(converged.sum())} of {count(converged.size, 'run')} "
    told = "" if every and converged.size == 1 else "not " if converged.size == 1 else runs
    told += f"converged in {count(status.iterations, 'iteration')}, last residual {last}"
    worst = flat[:, int(np.argmax(flat[-1]))] if flat.shape[1] else flat[:, 0]
    curve = Curve(
        "Residual" + " of the worst run" * (flat.shape[1] > 1),
        "iteration",
        "residual",
        _column(numbers, np.arange(1, len(worst) + 1)),
        _column(numbers, worst),
        log=True,
    )
    return Section(_CONVERGENCE, RIGHT if every else LOOK, told, curves=[curve])


def _digits(posterior: Posterior[Any]) -> Section | None:
    """The digits that rounding leaves; None of beliefs that have no means."""
    found = posterior.status.digits
    variables = posterior.graph.network.variables
    if all(isinstance(v, Discrete) for v in variables):
        return None
    if posterior.status.numbers and found is None:
        return _unknown(_DIGITS, "these beliefs have the figures above, and count no digits")
    if found is None:
        told = "rounding to float64 moves no mean by more than 10⁻⁶ deviations"
        return Section(_DIGITS, RIGHT, told)
    least = max(float(np.min(found, initial=np.inf)), 0.0)
    told = f"rounding leaves {least:.1f} decimal digits of the mean that it harms most"
    few = int((found < ENOUGH_DIGITS).sum())
    words = ["Digits are counted from a mean's standard deviation: 6 are an error of 10⁻⁶ of it."]
    if few:
        words.append(f"{few} of {count(found.size, 'run')} have fewer than {ENOUGH_DIGITS:.0f}.")
    return Section(_DIGITS, LOOK if few else RIGHT, told, words)


def _lost(posterior: Posterior[Any]) -> Section | None:
    """The stretches at which the belief was lost; None without time."""
    if posterior.kind is None:
        return None
    lost = posterior.lost
    words = [
        "A belief is lost where its innovations are larger, or more of its readings rejected, than "
        "its covariances allow: Page's test, which a right model fails once in 10⁶ steps."
    ]
    if not lost:
        return Section(_LOST, RIGHT, "never lost", words)
    steps, every = int(lost.at.sum()), lost.at.size
    told = f"lost in {count(len(lost.stretches), 'stretch', 'stretches')}, {steps:,} of {every:,} "
    told += "steps"
    heads = ("run", "steps", "noticed at", "by", "NIS a component, or share rejected")
    rows = [
        (
            ", ".join(map(str, each.run)) or "—",
            f"{each.first}..{each.last}",
            str(each.declared),
            each.why,
            number(each.value, 3),
        )
        for each in lost.stretches
    ]
    return Section(_LOST, LOOK, told, words, [_sheet(heads, rows)])


def _linearisation(posterior: Posterior[Any]) -> Section | None:
    """How nonlinear CPDs are where they were linearised; None of tables, which never are."""
    if all(isinstance(v, Discrete) for v in posterior.graph.network.variables):
        return None
    try:
        found: Any = posterior.nonlinearity
    except Unanswered:
        raise
    except PgmError as error:  # of a function that fails over a belief
        return _unknown(_LINES, str(error))
    if not found:
        return Section(_LINES, RIGHT, "nothing was linearised")
    wrong = found.told(posterior.status.iterations)
    words = [
        "The figure of a reading or a motion says of how many of its components the error of the "
        f"best line governs, rather than the noise: above {WRONG} no line is to be trusted there."
    ]
    heads = ("CPD of", "known", "least", "median", "most", f"above {WRONG}")
    rows = []
    for variable, figures in found.items():
        known = figures[~np.isnan(figures)]
        ends = (known.min(), np.median(known), known.max()) if known.size else ()
        shown = [number(float(end), 3) for end in ends] or ["—"] * 3
        rows.append((repr(variable), f"{known.size:,}", *shown, f"{(known > WRONG).sum():,}"))
    told = wrong or f"no figure above {WRONG}: lines fit the functions over the beliefs"
    return Section(_LINES, LOOK if wrong else RIGHT, told, words, [_sheet(heads, rows)])


def _sensors(posterior: Posterior[Any], numbers: Numbers) -> Section:
    innovations = posterior.innovations
    ranked = ranking(innovations)
    if not len(ranked):
        return _unknown(_SENSORS, "nothing was measured")
    outside = [row for row in ranked.rows if not bool(row.average.inside)]
    above = sum(float(row.average.value) > float(row.average.high) for row in outside)
    told = f"{count(len(ranked), 'sensor')}, none outside the band of a right model"
    if outside:
        told = f"{count(len(ranked), 'sensor')}: {above} above the band of a right model, "
        told += f"{len(outside) - above} below it"
    words = [
        "NIS a component is 1 for a right model: above its band innovations are larger than their "
        "covariances say, below it smaller, as when a noise is declared larger than it is. The "
        "sensor on top is the first to look at."
    ]
    if posterior.status.iterations > 1:
        words.append(
            "Innovations are those of the last linearisation, which has seen the readings: they "
            "are smaller than a plain filter's."
        )
    heads = [
        *("sensor", "read", "NIS a component", "band, 99 %", "", "largest bias [σ]"),
        *("worst stretch", "NIS there", "by chance at most"),
    ]
    rows = []
    for row in ranked.rows:
        worst = int(np.argmax(np.abs(row.bias)))
        rows.append(
            (
                row.name,
                f"{int(row.average.count):,}",
                *_in_band(row.average),
                f"{row.bias[worst]:+.2f} ± {row.bias_error[worst]:.2f}",
                f"{row.first}..{row.last}",
                number(row.in_stretch, 3),
                f"{row.probability:.2g}",
            )
        )
    lost = stretches(posterior).get((), [])  # of a single run
    curves = [
        _band(f"NIS a component of {row.name}", anis(innovations[row.sensor]), numbers, lost)
        for row in ranked.rows[:_CURVES]
    ]
    state = LOOK if outside else RIGHT
    return Section(_SENSORS, state, told, words, [_sheet(heads, rows)], curves)


# Heads of the tables of continuous and discrete variables.
_ERRORS = ("state", "known", "RMSE", "NEES a component", "band, 99 %", "", "in 95 % regions")
_STATES = ("state", "known", "probability of the true state", "−ln of it, mean", "likeliest")


def _truth(posterior: Posterior[Any], truth: Mapping[Variable, Array], numbers: Numbers) -> Section:
    """Errors against the truth, in their units and in the belief's own deviations."""
    title = "Against the truth"
    rows, states, failed = list[Sequence[str]](), list[Sequence[str]](), list[str]()
    curves, outside = list[Curve](), list[Variable]()
    for variable, values in truth.items():
        try:
            belief = posterior[variable]
            if isinstance(variable, Discrete):
                states.append(_of_states(variable, belief, values[..., 0]))
                continue
            belief = _gaussian(variable, belief)
            each = anees(belief, values)
            whole = each.overall() if np.ndim(each.value) else each
            inside = coverage(belief, values)
        except PgmError as error:
            # Without time only what was observed has no belief: its truth is its evidence.
            if not (isinstance(error, EvidenceError) and posterior.kind is None):
                failed.append(f"{variable!r}: {error}")
            continue
        average = whole.per_dof()
        outside += [variable] * (not bool(average.inside))
        share = f"{100.0 * float(inside.actual):.0f} %"
        rows.append(
            (
                repr(variable),
                f"{whole.count:,}",
                _lengths(belief, values),
                *_in_band(average),
                share,
            )
        )
        if belief.steps is not None and len(curves) < _CURVES:
            curves.append(_band(f"NEES a component of {variable!r}", each, numbers))
    tables = [_sheet(heads, each) for heads, each in ((_ERRORS, rows), (_STATES, states)) if each]
    if not tables:
        told = "no truth was given" if not truth else "the truth given judges no belief"
        return Section(title, UNKNOWN, told, failed)
    if not rows:
        told = (
            f"true states had the probability {states[0][2]} on average"
            if len(states) == 1
            else f"{len(states)} discrete states judged by the probability of the true ones"
        )
        return Section(title, UNKNOWN, told, failed, tables)
    words = [
        "NEES a component is the squared error in the belief's own deviations: 1 on average if the "
        "belief is right about its errors, above 1 if it is too sure. Steps of one run depend on "
        "each other, so that the band of a single run is wide."
    ]
    told = f"errors of {', '.join(row[0] for row in rows)} as large as the beliefs say"
    if outside:
        told = f"NEES outside the band of a right belief: {listed(outside)}"
    return Section(title, LOOK if outside else RIGHT, told, [*words, *failed], tables, curves)


def _gaussian(variable: Variable, belief: Any) -> Gaussian:
    """A belief of any form by its moments."""
    if isinstance(belief, Gaussian):
        return belief
    return Gaussian(variable, belief.mean, belief.cov, steps=belief.steps)


def _lengths(belief: Gaussian, values: Array) -> str:
    """The RMSE of each component of which some truth is known."""
    variable, found = belief.scope[0], []
    for k, name in enumerate(variable.components):
        if not np.isnan(values[..., k]).all():
            length = number(rmse(belief, values, (name,)), 3)
            found.append(f"{name} {length} {variable.unit_of(name)}".strip())
    return ", ".join(found)


def _of_states(variable: Discrete, belief: Any, values: Array) -> tuple[str, ...]:
    """How probable the true states of a discrete variable were, where these are known."""
    known = np.isfinite(values)
    index = np.where(known, values, 0).astype(np.intp)
    each = np.broadcast_to(belief.probabilities, (*index.shape, variable.size))
    likely = np.take_along_axis(each, index[..., None], axis=-1)[..., 0][known]
    right = (each.argmax(axis=-1) == index)[known]
    if not likely.size:
        return (repr(variable), "0", "—", "—", "—")
    with np.errstate(divide="ignore"):
        score = float(-np.log(likely).mean())
    return (
        repr(variable),
        f"{likely.size:,}",
        number(float(likely.mean()), 3),
        number(score, 3),
        f"{100.0 * right.mean():.0f} % right",
    )


def _in_band(average: Average) -> tuple[str, str, str]:
    """A mean, its band, and where it is, in words."""
    value, low, high = (float(part) for part in (average.value, average.low, average.high))
    where = "inside" if bool(average.inside) else "above" if value > high else "below"
    return number(value, 3), f"{number(low, 3)} to {number(high, 3)}", where


def _band(
    title: str, average: Average, numbers: Numbers, marked: Sequence[tuple[int, int]] = ()
) -> Curve:
    """A mean over runs at each step of a chain with its band, for a component."""
    each = average.per_dof()
    kept = np.flatnonzero(np.isfinite(each.value))
    value, low, high = (_column(numbers, part[kept]) for part in (each.value, each.low, each.high))
    up = title.split(" of ")[0]
    return Curve(title, "step", up, _column(numbers, kept), value, low, high, marked=marked)


def _column(numbers: Numbers, values: npt.ArrayLike) -> Ref:
    return numbers.add(np.asarray(values, dtype=np.float64)[:, None], SHOWN)


def _sheet(heads: Sequence[str], rows: _Rows) -> Sheet:
    """A table of the first and last rows, where there are many."""
    blank = [LEFT_OUT, *[""] * (len(heads) - 1)]
    shown = places((len(rows),), _ROWS)
    return Sheet(heads, [blank if place is None else rows[place[0]] for place in shown])
