"""Tables and notes of the report."""

from __future__ import annotations

from collections.abc import Callable

from experiments.nonlinear_measurement import reference
from experiments.nonlinear_measurement.cases import HEADINGS
from experiments.nonlinear_measurement.reference import Against
from experiments.nonlinear_measurement.rules import SETTLED
from experiments.nonlinear_measurement.scores import Score
from experiments.nonlinear_measurement.study import EXACT, Study
from experiments.record import Record

Shown = Callable[[Score], str]
_ALL = " / ".join(f"{s:g}" for s in HEADINGS)
_WIDEST = str(HEADINGS[-1])


def write(record: Record, found: Study, against: Against, runs: int) -> None:
    """Write all tables and notes."""
    for s in map(str, HEADINGS):
        told = ", in brackets the reference's" if s in next(iter(against.values())) else ""
        _kl_table(record, found, against, s, f"mean KL [nats] ± standard error, s = {s} rad{told}")
    z, where = reference.largest(against)
    record.note(
        f"The reference is an earlier, independent implementation, one seed of {reference.RUNS} "
        f"simulations. The largest difference is {z:+.2f} standard errors of the difference "
        f"({where}), the reference's error taken to be ours at its number of simulations. Where "
        "the mean is far above the median a few simulations make it, and its standard error is "
        "itself uncertain."
    )
    _table(record, found, f"median KL [nats], s = {_ALL} rad", _medians(found))
    for title, shown in (
        ("NEES, 3 is right", lambda each: f"{each.nees:.2f} ± {each.nees_se:.2g}"),
        ("RMSE of position [m] / heading [rad]", _rmse),
    ):
        _table(record, found, f"{title}, s = {_WIDEST} rad", _at_widest(found, shown))
    record.table(
        "evaluations of functions / µs, of a step of a robot; all simulations in one batch",
        ("rule", *found.costs),
        [
            (rule, *(_cost(found, sensor, rule) for sensor in found.costs))
            for rule in next(iter(found.costs.values()))
        ],
    )
    record.table(
        "IteratedCubature: simulations at rest, whose last linearisation moved no mean by more "
        f"than {SETTLED:g} deviations / their mean KL / that of the others",
        ("s [rad]", *found.settled),
        [(s, *(_rest(cases[s]) for cases in found.settled.values())) for s in map(str, HEADINGS)],
    )
    truths = [each for cases in found.truth.values() for each in cases.values()]
    record.note(
        f"Truth: effective sample sizes from {min(t['effective_min'] for t in truths):.0f}, "
        f"medians from {min(t['effective_median'] for t in truths):.0f}; "
        f"{sum(t['dropped'] for t in truths):.0f} of {runs * len(truths)} simulations dropped. "
        "The two ranges of a step are linearised as one stacked vector."
    )


def _kl_table(record: Record, found: Study, against: Against, s: str, title: str) -> None:
    def cell(sensor: str, rule: str) -> str:
        score, due = found.scores[sensor][s][rule], against[sensor].get(s, {}).get(rule)
        told = f" ({due['reference']:g})" if due else ""
        return f"{score.kl:.3g} ± {score.kl_se:.1g}{told}"

    _table(record, found, title, {r: [cell(n, r) for n in found.scores] for r in found.rules})


def _table(record: Record, found: Study, title: str, rows: dict[str, list[str]]) -> None:
    record.table(title, ("rule", *found.scores), [(rule, *cells) for rule, cells in rows.items()])


def _medians(found: Study) -> dict[str, list[str]]:
    return {
        rule: [
            " / ".join(f"{cases[str(s)][rule].kl_median:.2g}" for s in HEADINGS)
            for cases in found.scores.values()
        ]
        for rule in found.rules
    }


def _at_widest(found: Study, shown: Shown) -> dict[str, list[str]]:
    return {
        rule: [shown(cases[_WIDEST][rule]) for cases in found.scores.values()]
        for rule in (EXACT, *found.rules)
    }


def _rmse(each: Score) -> str:
    return f"{each.rmse:.3f} / {each.rmse_heading:.3f}"


def _rest(each: dict[str, float]) -> str:
    others = f"{each['kl_others']:.2g}" if each["share"] < 1.0 else "–"
    return f"{each['share']:.1%} / {each['kl']:.2g} / {others}"


def _cost(found: Study, sensor: str, rule: str) -> str:
    cost = found.costs[sensor][rule]
    return f"{cost.evaluations:.0f} / {cost.microseconds:.1f}"
