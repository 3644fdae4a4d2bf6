"""Tables and notes of the report: what was measured, and what it says."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from experiments.iterated import chain, growth
from experiments.iterated.case import Case
from experiments.iterated.changes import CLEAR, Change
from experiments.iterated.methods import TITLES, Array, Grid, Outcome, Score
from experiments.iterated.published import Comparison, furthest
from experiments.record import Record

Comparisons = Mapping[str, Mapping[str, Sequence[Comparison]]]
# The smoother of the readings so far.
ALL_STEPS = "all steps relinearised"
# What tables show of a score, in a cell.
_SHOWN: dict[str, Callable[[Score], str]] = {
    "RMSE (median run)": lambda score: f"{score.rmse:.3f} ({score.median:.3f})",
    "NEES, mean (median)": lambda score: f"{score.nees:.3g} ({score.nees_median:.2f})",
    "share of runs converged, seconds": lambda s: f"{s.converged:.2f}, {s.seconds:.1f} s",
}


def comparisons(found: Comparisons) -> dict[str, Any]:
    """Of published numbers, for a summary."""
    return {
        case: {name: [one.as_dict() for one in each] for name, each in by_name.items()}
        for case, by_name in found.items()
    } | {"largest_z": max(furthest(by_name) for by_name in found.values())}


def published_page(
    record: Record, found: Comparisons, other: Mapping[str, Sequence[Comparison]]
) -> None:
    """Published numbers beside ours, and the case read in other ways."""
    record.table(
        "Published numbers and ours, plain iteration: RMSE, but where NEES stands",
        ("", "n", "publ.", "ours", "s.e.", "z", "median"),
        [
            (
                " ".join((case, name, *_what(one))),
                str(one.number.method[1]),
                f"{one.number.value:g}",
                f"{one.mean:.3f}",
                f"{one.standard_error:.3f}",
                f"{one.z:+.1f}",
                f"{np.mean(one.medians):.3f}",
            )
            for case, by_name in found.items()
            for name, each in by_name.items()
            for one in each
        ],
    )
    everything = [one for by_name in found.values() for each in by_name.values() for one in each]
    inside = sum(abs(one.z) <= 3.0 for one in everything)
    record.note(
        f"{inside} of {len(everything)} published numbers lie within three standard errors of the "
        "difference, the published error taken equal to that of one seed of ours. Means are "
        "heavy-tailed: a few runs that follow another branch make most of a plain filter's, so "
        "medians over runs stand beside them. 'After k relinearisations' are k + 1 "
        "linearisations, n."
    )
    readings = {growth.MAIN.title: found["cubic"]["Unscented"], **other}
    record.table(
        "The cubic case read in other ways: z of the published RMSE (unscented), one seed",
        ("reading", *(_short(one) for one in found["cubic"]["Unscented"])),
        [(title, *(f"{one.z:+.1f}" for one in each)) for title, each in readings.items()],
    )
    record.note(
        "The first line, all seeds, is the case as it is taken here: the state before the first "
        "motion is N(5, 4), it is not read and does not count, and 8 cos 1.2k leads to state k. "
        "The authors' own programme reads 50 states, the first among them, with 8 cos 1.2k out of "
        "the k-th: the second line."
    )


def growth_page(record: Record, grown: Mapping[str, Mapping[str, Grid]]) -> None:
    """The growth model, all controls."""
    for sensor, by_name in grown.items():
        _tables(record, f"Growth model, {sensor} sensor", by_name)
    for sensor, by_name in grown.items():
        for name, grid in by_name.items():
            for kind, controls in grid.items():
                record.note(_note(f"{sensor}, {name}, {kind}", controls))


def chain_page(
    record: Record,
    chains: Mapping[str, Grid],
    controlled: Mapping[str, Grid],
    last: Mapping[str, Mapping[str, Mapping[str, float]]],
    most: int,
) -> None:
    """The chain, its reasons, and the answer."""
    _tables(record, f"{chain.STEPS}-step chains, positions [m]; NEES of the pose (3)", chains)
    for name, grid in controlled.items():
        for kind, controls in grid.items():
            record.note(_note(f"{name} {kind}", controls))
    record.table(
        "The last step, where filter and smoother know the same: RMSE of the position [m]; the "
        "turn about the landmark, which no sighting tells [rad]",
        ("", "RMSE", "turn (RMS)", "claimed (median)"),
        [
            (f"{name} {method}", one["rmse"], one.get("turn", "–"), one.get("turn_claimed", "–"))
            for name, each in last.items()
            for method, one in each.items()
        ],
    )
    for name, grid in controlled.items():
        record.note(_reasons(name, grid, last[name], most))
    record.note(_answer(controlled, most))


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


def _tables(record: Record, title: str, by_name: Mapping[str, Grid]) -> None:
    """What `_SHOWN` names, a column for each control."""
    for quantity, show in _SHOWN.items():
        rows = []
        for name, grid in by_name.items():
            for kind, controls in grid.items():
                for count in controls["plain"]:
                    found = [controls.get(control, {}).get(count) for control in TITLES]
                    cells = [show(outcome.score) if outcome else "–" for outcome in found]
                    rows.append((f"{name} {kind}", str(count), *cells))
        record.table(f"{title}: {quantity}", ("", "n", "plain", "damped", "LM"), rows)


def _note(what: str, controls: Mapping[str, Mapping[int, Outcome]]) -> str:
    """What iterating does to a filter or smoother, and what step control adds."""
    count = min(max(each) for each in controls.values())
    plain = controls["plain"]
    sentences = [
        f"{what}: iterating plainly, {count} linearisations, {Change(plain[1], plain[count])}"
    ]
    for control in ("damped", "lm"):
        change = Change(plain[count], controls[control][count])
        sentences.append(
            f"{TITLES[control]} against plain {change.verdict} it ({change.after.score.rmse:.3f}, "
            f"{change.z:+.1f} s.e.; median run {change.after.score.median:.3f})"
        )
    before, after = plain[1].score, plain[count].score
    sentences.append(
        f"NEES, once to plain: mean {before.nees:.3g} to {after.nees:.3g}, median "
        f"{before.nees_median:.2f} to {after.nees_median:.2f}; runs lost {before.lost:.1%} to "
        f"{after.lost:.1%}"
    )
    return "; ".join(sentences) + "."


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
        f"{name} filter, reasons looked at. Divergence: the last plain relinearisation moves the "
        f"median run's worst step by {move:.2g} deviations; runs lost: {lost}. A bad tail: RMSE "
        f"without the worst 5 % of runs [m]: {trimmed}. Over-confidence: mean NEES (3 is right): "
        f"{nees}; the turn about the landmark at the last step, claimed for true [rad]: {turn}. "
        f"Earlier linearisations that stand: RMSE at the last step [m]: {end}; relinearising all "
        f"steps, from the same readings, {again:.3f}."
    )


def _answer(controlled: Mapping[str, Grid], most: int) -> str:
    counts = [k for k in controlled["Taylor"]["filter"]["plain"] if 1 < k <= most]
    parts = []
    for name, grid in controlled.items():
        for kind, controls in grid.items():
            won = {
                k: [c for c in controls if Change(controls[c][1], controls[c][k]).z <= -CLEAR]
                for k in counts
            }
            told = (f"{k}: {', '.join(TITLES[c] for c in won[k]) or 'none'}" for k in counts)
            parts.append(f"{name} {kind} – {'; '.join(told)}")
    return (
        "Does step control make iterating win on chains? The controls that clearly lower the RMSE "
        f"of one linearisation, by {CLEAR:g} standard errors of the paired difference, after "
        f"{', '.join(str(k) for k in counts)} linearisations: {'. '.join(parts)}."
    )


def _what(one: Comparison) -> tuple[str, ...]:
    kind = one.number.method[0]
    return (kind,) if one.number.quantity == "rmse" else (kind, "NEES")


def _short(one: Comparison) -> str:
    kind, count = one.number.method
    return kind if count == 1 else str(count)
