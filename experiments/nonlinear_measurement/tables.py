"""Tables and notes of the report."""

from __future__ import annotations

import math
from collections.abc import Callable

from experiments.nonlinear_measurement import findings, reference
from experiments.nonlinear_measurement.audits import RIGHT, WRONG
from experiments.nonlinear_measurement.cases import HEADINGS
from experiments.nonlinear_measurement.reference import Against
from experiments.nonlinear_measurement.rules import SETTLED, Rule
from experiments.nonlinear_measurement.scores import Score
from experiments.nonlinear_measurement.study import EXACT, Study
from experiments.record import Record

Shown = Callable[[Score], str]
_WIDEST = str(HEADINGS[-1])


def write(
    record: Record, found: Study, against: Against, runs: int, compared: dict[str, Rule]
) -> None:
    """Write all tables, each with its finding, and notes."""
    for s in map(str, HEADINGS):
        record.note(findings.means(found, s, compared))
        _table(record, found, f"mean KL [nats] ± standard error, s = {s} rad", _means(found, s))
        if s in next(iter(against.values())):
            title = (
                f"the reference's mean KL [nats], s = {s} rad (ours less it, in standard errors "
                "of both)"
            )
            _table(record, found, title, _references(found, against, s))
    z, where = reference.largest(against)
    record.note(
        f"The reference is an earlier, independent implementation, one seed of {reference.RUNS} "
        f"simulations. The largest difference is {z:+.2f} standard errors of the difference "
        f"({where}), the reference's error taken to be ours at its number of simulations. Where "
        "the mean is far above the median a few simulations make it, and its standard error is "
        "itself uncertain."
    )
    record.note(findings.medians(found))
    record.table(
        "median KL [nats]",
        ("rule", "s [rad]", *found.scores),
        [
            (rule, s, *(cases[s][rule].kl_median for cases in found.scores.values()))
            for s in map(str, HEADINGS)
            for rule in found.rules
        ],
        about="Over simulations, a column a sensor; far below the mean where few simulations make "
        "that.",
        best=dict.fromkeys(found.scores, -math.inf),
        within=("s [rad]",),
        folded=True,
    )
    for finding, title, shown in (
        (
            findings.calibration,
            "NEES, 3 is right",
            lambda each: f"{each.nees:.2f} ± {each.nees_se:.2g}",
        ),
        (findings.errors, "RMSE of position [m] / heading [rad]", _rmse),
    ):
        record.note(finding(found))
        _table(record, found, f"{title}, s = {_WIDEST} rad", _at_widest(found, shown))
    record.note(findings.costs(found))
    record.table(
        "evaluations of functions / µs, of a step of a robot; all simulations in one batch",
        ("rule", *found.costs),
        [
            (rule, *(_cost(found, sensor, rule) for sensor in found.costs))
            for rule in next(iter(found.costs.values()))
        ],
        about="Evaluations of functions and Jacobians, and microseconds, for one robot; a column a "
        "sensor.",
        folded=True,
    )
    record.note(findings.rest(found))
    record.table(
        "IteratedCubature: simulations at rest, whose last linearisation moved no mean by more "
        f"than {SETTLED:g} deviations, their mean KL [nats], and that of the others",
        ("sensor", "s [rad]", "at rest", "KL at rest", "KL of the others"),
        [
            (sensor, s, *_rest(each))
            for sensor, cases in found.settled.items()
            for s, each in cases.items()
        ],
        about="At rest: the share of simulations. Their mean KL [nats], and that of the others.",
        folded=True,
    )
    record.note(findings.estimates(found))
    record.table(
        f"pgm.estimate at s = {_WIDEST} rad",
        ("sensor", "KL", "± standard error", "vouched for", "within", "beyond it", "draws"),
        [
            (s, e.kl, e.kl_se, f"{e.vouched:.1%}", e.within, f"{e.beyond:.1%}", f"{e.draws:.0f}")
            for s, e in found.estimates.items()
        ],
        about="Mean KL [nats] over simulations; the share vouched for, the median of the bounds "
        "that their verdicts state [nats], and the share of them that are further off.",
    )
    record.note(findings.audits(found))
    record.table(
        f"the audit at s = {_WIDEST} rad: results that are {WRONG:g} nats or more off, and less "
        f"than {RIGHT:g}, and how many of each are suspect",
        (
            "sensor",
            "rule",
            f"off ≥ {WRONG:g}",
            "caught",
            f"off < {RIGHT:g}",
            "alarms",
            "trusted",
        ),
        [
            (sensor, rule, a.wrong, a.caught, a.right, a.alarms, f"{a.trusted:.1%}")
            for sensor, audits in found.audits.items()
            for rule, a in audits.items()
        ],
        about="Simulations. Caught: results of the column before that the audit calls suspect, "
        "rightly; alarms: the same of the column before, wrongly; trusted: the share of all "
        "simulations whose audit can be trusted.",
        folded=True,
    )
    truths = [each for cases in found.truth.values() for each in cases.values()]
    record.note(
        f"Truth: effective sample sizes from {min(t['effective_min'] for t in truths):.0f}, "
        f"medians from {min(t['effective_median'] for t in truths):.0f}; "
        f"{sum(t['dropped'] for t in truths):.0f} of {runs * len(truths)} simulations dropped. "
        "The two ranges of a step are linearised as one stacked vector."
    )


def _means(found: Study, s: str) -> dict[str, list[str]]:
    """The standard errors in per cent: as numbers of their own they are too wide for a page."""
    scores = {rule: [cases[s][rule] for cases in found.scores.values()] for rule in found.rules}
    return {
        rule: [f"{each.kl:.3g} ±{each.kl_se / each.kl:.0%}" for each in cases]
        for rule, cases in scores.items()
    }


def _references(found: Study, against: Against, s: str) -> dict[str, list[str]]:
    return {
        rule: [
            f"{due['reference']:g} ({due['z']:+z.1f})"
            for due in (against[sensor][s][rule] for sensor in found.scores)
        ]
        for rule in reference.KL
    }


def _table(record: Record, found: Study, title: str, rows: dict[str, list[str]]) -> None:
    record.table(
        title,
        ("rule", *found.scores),
        [(rule, *cells) for rule, cells in rows.items()],
        about="A column a sensor: range and bearing far and near, ranges of two beacons, of two "
        "in line with the robot, and the position itself. s: the heading's standard deviation.",
        best=dict.fromkeys(found.scores, -math.inf) if "KL" in title else None,
        folded=title.startswith(("the reference", "RMSE")),
    )


def _at_widest(found: Study, shown: Shown) -> dict[str, list[str]]:
    return {
        rule: [shown(cases[_WIDEST][rule]) for cases in found.scores.values()]
        for rule in (EXACT, *found.rules)
    }


def _rmse(each: Score) -> str:
    return f"{each.rmse:.3f} / {each.rmse_heading:.3f}"


def _rest(each: dict[str, float]) -> tuple[str, float, float | str]:
    others = each["kl_others"] if each["share"] < 1.0 else "–"
    return f"{each['share']:.1%}", each["kl"], others


def _cost(found: Study, sensor: str, rule: str) -> str:
    cost = found.costs[sensor][rule]
    return f"{cost.evaluations:.0f} / {cost.microseconds:.1f}"
