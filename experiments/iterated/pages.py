"""Tables and notes of the report: what was measured, and what it says."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from experiments.iterated import chain
from experiments.iterated.case import Case
from experiments.iterated.changes import CLEAR, Change, verdicts
from experiments.iterated.methods import AT_REST, TITLES, WORST, Array, Grid, Outcome, Score
from experiments.record import Record

# The smoother of the readings so far.
ALL_STEPS = "all steps relinearised"


def answer(controlled: Mapping[str, Grid]) -> str:
    """Say whether step control makes iterating win on chains."""
    return (
        "Does step control make iterating win on chains? The RMSE of the position after so many "
        "linearisations, against one; a change is clear from "
        f"{CLEAR:g} standard errors of the paired difference on. {verdicts(controlled)}"
    )


def chain_page(
    record: Record,
    chains: Mapping[str, Grid],
    controlled: Mapping[str, Grid],
    last: Mapping[str, Mapping[str, Mapping[str, float]]],
    most: int,
) -> None:
    """The answer, its numbers, its reasons."""
    record.note(answer(controlled))
    title = f"Drives of {chain.STEPS} steps: RMSE of the position [m]"
    _errors(record, title, controlled)
    _errors(
        record,
        f"{title}, other rules",
        {name: grid for name, grid in chains.items() if name not in controlled},
    )
    record.table(
        "The last step, where filter and smoother know the same",
        ("method", "RMSE [m]", "turn (RMS) [rad]", "claimed (median) [rad]"),
        [
            (f"{name} {method}", one["rmse"], one.get("turn", "–"), one.get("turn_claimed", "–"))
            for name, each in last.items()
            for method, one in each.items()
        ],
        about="RMSE: of the position [m]. Turn: the RMS error of the turn of the whole estimate "
        "about the landmark [rad]; claimed: the median run's own standard deviation of it [rad].",
        folded=True,
    )
    for name, grid in controlled.items():
        record.note(_reasons(name, grid, last[name], most))


def growth_page(record: Record, grown: Mapping[str, Mapping[str, Grid]]) -> None:
    """The growth model, all controls."""
    for sensor, by_name in grown.items():
        title = f"Growth model, {sensor} sensor"
        record.note(f"{title}, against one linearisation. {verdicts(by_name)}")
        _errors(record, f"{title}: RMSE", by_name)


def ends_page(record: Record, grids: Mapping[str, Grid]) -> None:
    """Beliefs after the largest number of linearisations that all controls have."""
    rows = [
        (f"{name} {kind}", controls["plain"][1], _last(controls))
        for name, grid in grids.items()
        for kind, controls in grid.items()
    ]
    columns = tuple(TITLES[control] for control in TITLES)
    record.table(
        "NEES: median (mean), linearised once and n times",
        ("model and estimator", "n", "once", *columns),
        [
            (what, str(count), *(_nees(one) for one in (once, *(ends.get(c) for c in TITLES))))
            for what, once, (count, ends) in rows
        ],
        about="Each cell: the median run's NEES, and in brackets the mean over runs; 1 is right "
        "for the growth model, 3 for a pose. n: the number of linearisations.",
        folded=True,
    )
    worst = max((once for _, once, _ in rows), key=lambda once: once.score.nees)
    what = next(what for what, once, _ in rows if once is worst)
    record.note(
        "A right belief over n components has a mean NEES of n: 1 for the growth model, 3 for a "
        "pose. Means are heavy-tailed, as a belief that is sure of a wrong branch divides its "
        f"error by a very small variance: the worst {WORST:.0%} of runs make "
        f"{worst.score.nees_tail:.1%} of the largest mean, {what} linearised once."
    )
    record.table(
        f"Runs at rest: the last linearisation moved no mean by more than {AT_REST:g} deviations",
        ("model and estimator", "n", *columns),
        [
            (what, str(count), *(_settled(ends, control) for control in TITLES))
            for what, _, (count, ends) in rows
        ],
        about="Each cell: the share of runs at rest after n linearisations, and z: the difference "
        "of squared errors from plain iteration in its standard errors; below 0 is better.",
        folded=True,
    )


def last_steps(
    case: Case, controlled: Mapping[str, Grid], batch: Mapping[str, Array], most: int
) -> dict[str, dict[str, dict[str, float]]]:
    """Errors at the last step by lineariser and method, and what is claimed of the turn."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name, grid in controlled.items():
        found[name] = {}
        for method, outcome in _methods(grid, most).items():
            error, std = chain.turned(outcome.belief, case.truth)
            found[name][method] = {
                "rmse": float(outcome.by_step[-1]),
                "turn": float(np.sqrt((error[:, -1] ** 2).mean())),
                "turn_claimed": float(np.median(std[:, -1])),
            }
        found[name][ALL_STEPS] = {"rmse": float(np.sqrt((batch[name][:, -1] ** 2).mean()))}
    return found


def _methods(grid: Grid, most: int) -> dict[str, Outcome]:
    return {
        method: outcome
        for kind, controls in grid.items()
        for method, outcome in (
            (f"{kind}, once", controls["plain"][1]),
            *((f"{kind}, {most}, {control}", each[most]) for control, each in controls.items()),
        )
    }


def _errors(record: Record, title: str, grids: Mapping[str, Grid]) -> None:
    """RMSE by number of linearisations, a column for each control."""
    shown = [
        c for c in TITLES if any(c in each for grid in grids.values() for each in grid.values())
    ]
    rows = []
    for name, grid in grids.items():
        for kind, controls in grid.items():
            for count in controls["plain"]:
                cells = (_error(controls[c], count) if c in controls else "–" for c in shown)
                rows.append((f"{name} {kind}", str(count), *cells))
    record.table(
        title,
        ("estimator", "n", *(TITLES[control] for control in shown)),
        rows,
        about="Each cell: the RMSE after n linearisations, in brackets the median run's, and z: "
        "the difference of squared errors from one linearisation, in standard errors of the "
        "paired difference; below 0 iterating helps. Columns are ways to control the step.",
        best={TITLES[control]: -np.inf for control in shown},
        within=("estimator",),
    )


def _error(each: Mapping[int, Outcome], count: int) -> str:
    if count not in each:
        return "–"
    score = each[count].score
    z = f", {Change(each[1], each[count]).z:+.1f}" if count > 1 else ""
    return f"{score.rmse:.3f} ({score.median:.3f}){z}"


def _last(controls: Mapping[str, Mapping[int, Outcome]]) -> tuple[int, dict[str, Outcome]]:
    count = min(max(each) for each in controls.values())
    return count, {control: each[count] for control, each in controls.items()}


def _nees(outcome: Outcome | None) -> str:
    return f"{outcome.score.nees_median:.2f} ({outcome.score.nees:.3g})" if outcome else "–"


def _settled(ends: Mapping[str, Outcome], control: str) -> str:
    if control not in ends or (settled := ends[control].score.settled) is None:
        return "–"
    z = f", {Change(ends['plain'], ends[control]).z:+.1f}" if control != "plain" else ""
    return f"{settled:.0%}{z}"


def _reasons(name: str, grid: Grid, last: Mapping[str, Mapping[str, float]], most: int) -> str:
    filters = grid["filter"]
    methods = {
        "once": (filters["plain"][1].score, last["filter, once"]),
        "plain": (filters["plain"][most].score, last[f"filter, {most}, plain"]),
        "Levenberg–Marquardt": (filters["lm"][most].score, last[f"filter, {most}, lm"]),
    }

    def each(text: Callable[[Score, Mapping[str, float]], str]) -> str:
        return ", ".join(f"{title} {text(*both)}" for title, both in methods.items())

    move = np.median(filters["plain"][most].residuals[-1])
    lost = each(lambda score, _: f"{score.lost:.1%}")
    trimmed = each(lambda score, _: f"{score.trimmed:.3f}")
    nees = each(lambda score, _: f"{score.nees:.2f}")
    turn = each(lambda _, at: f"{at['turn_claimed']:.3f} for {at['turn']:.3f}")
    end = each(lambda _, at: f"{at['rmse']:.3f}")
    again = last[f"smoother, {most}, plain"]["rmse"]
    return (
        f"{name} filter, {most} linearisations, reasons looked at. Divergence: the last plain "
        f"relinearisation moves the median run's worst step by {move:.2g} deviations; runs lost: "
        f"{lost}. A bad tail: RMSE without the worst {WORST:.0%} of runs [m]: {trimmed}. "
        f"Over-confidence: mean NEES (3 is right): {nees}; the turn about the landmark at the last "
        f"step, claimed for true [rad]: {turn}. Earlier linearisations that stand: RMSE at the "
        f"last step [m]: {end}; relinearising all steps, from the same readings, {again:.3f}."
    )
