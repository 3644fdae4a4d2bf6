"""The findings of a run in words, each computed from its numbers."""

from __future__ import annotations

from collections.abc import Iterable

from experiments.nonlinear_measurement.audits import RIGHT, WRONG, Audited
from experiments.nonlinear_measurement.cases import HEADINGS, SENSORS
from experiments.nonlinear_measurement.rules import ITERATED, Rule
from experiments.nonlinear_measurement.scores import Score
from experiments.nonlinear_measurement.study import EXACT, Study

SMOOTHER = "IteratedSmoother"
_WIDEST = str(HEADINGS[-1])
# Standard errors that a difference is to be called one.
_SURE = 2.0


def verdict(found: Study) -> list[str]:
    """The page's verdict in three points, each of short sentences."""
    cases = {sensor: scores[_WIDEST] for sensor, scores in found.scores.items()}
    better = [s for s, c in cases.items() if _below(c[SMOOTHER], c[ITERATED])]
    worse = [s for s, c in cases.items() if _below(c[ITERATED], c[SMOOTHER])]
    harmed = [s for s, c in cases.items() if _below(c["Cubature"], c[ITERATED])]

    def told(sensors: Iterable[str], first: str, second: str) -> str:
        """The mean KL of two rules with some sensors."""
        return _listed(
            f"from {cases[s][first].kl:.2g} to {cases[s][second].kl:.2g} nats with "
            f"{SENSORS[s].title}"
            for s in sensors
        )

    points = []
    if better:
        most = max(better, key=lambda s: cases[s][ITERATED].kl / cases[s][SMOOTHER].kl)
        points.append(
            f"Linearise the motion again too. With {len(better)} of {len(cases)} sensors a "
            "smoother of ten iterations is nearer than a filter that iterates its sensors alone. "
            f"The heading known to {_WIDEST} rad, it takes the mean KL "
            f"{told([most], ITERATED, SMOOTHER)}."
        )
    else:
        points.append(
            "In this run linearising the motion again gains nothing certain over linearising the "
            "sensors again."
        )
    if harmed or worse:
        harms = "Iterating harms where a reading leaves two places, since it settles at one."
        if harmed:
            harms += (
                " Linearising the sensors ten times instead of once takes the mean KL "
                f"{told(harmed, 'Cubature', ITERATED)}."
            )
        if worse:
            harms += f" The motion too takes it {told(worse, ITERATED, SMOOTHER)}."
        points.append(harms)
    else:
        points.append("In this run iterating does no certain harm with any sensor.")
    total = _sum(each for audits in found.audits.values() for each in audits.values())
    points.append(
        f"An audit tells which: it calls {_share(total.caught, total.wrong)} of the results "
        f"suspect that are {WRONG:g} nats or more off, and {_share(total.alarms, total.right)} "
        f"of those less than {RIGHT:g} off."
    )
    return points


def means(found: Study, s: str, rules: dict[str, Rule]) -> str:
    """Which rule is nearest, once and iterated."""
    once = [name for name, rule in rules.items() if rule.iterations == 1]
    again = [name for name in found.rules if name not in once]
    gains = []
    for sensor, cases in found.scores.items():
        kl = {rule: cases[s][rule].kl for rule in found.rules}
        first, second = min(once, key=kl.__getitem__), min(again, key=kl.__getitem__)
        gains.append((kl[first] / kl[second], sensor, first, second))
    gains.sort(reverse=True)
    factor, sensor, first, second = gains[0]
    least, other, *_ = gains[-1]
    return (
        f"At s = {s} rad the best iterated rule is {factor:.3g} times nearer than the best that "
        f"linearises once where iterating gains most ({SENSORS[sensor].title}: {second}, {first}), "
        f"and {least:.2g} times where it gains least ({SENSORS[other].title})."
    )


def medians(found: Study) -> str:
    """Where few simulations make the mean."""
    ratio, sensor, s, rule = max(
        (score.kl / score.kl_median, sensor, s, rule)
        for sensor, cases in found.scores.items()
        for s, scores in cases.items()
        for rule, score in scores.items()
        if rule != EXACT and score.kl_median > 0.0
    )
    return (
        f"The mean is furthest above the median, {ratio:.3g} times, for {rule} with "
        f"{SENSORS[sensor].title} at s = {s} rad: few simulations make it, and most are not harmed."
    )


def calibration(found: Study) -> str:
    """Which rules are too sure of themselves, and with which sensors."""
    scores = {
        (rule, sensor): cases[_WIDEST][rule]
        for sensor, cases in found.scores.items()
        for rule in found.rules
    }
    off = [key for key, each in scores.items() if each.nees - 3.0 > _SURE * each.nees_se]
    (rule, sensor), worst = max(scores.items(), key=lambda each: each[1].nees)
    return (
        f"Of {len(scores)} pairs of a rule and a sensor {len(off)} are too sure of themselves by "
        f"more than {_SURE:g} standard errors; most of all {rule} with {SENSORS[sensor].title}, "
        f"whose NEES is {worst.nees:.3g}."
    )


def errors(found: Study) -> str:
    """How much of the error is the linearisation's."""
    excess, sensor, rule = max(
        (cases[_WIDEST][rule].rmse / cases[_WIDEST][EXACT].rmse, sensor, rule)
        for sensor, cases in found.scores.items()
        for rule in found.rules
    )
    return (
        f"The largest RMSE beside that of the exact mean is {rule}'s with {SENSORS[sensor].title}, "
        f"{excess - 1.0:+.0%}: beliefs part earlier than errors do."
    )


def costs(found: Study) -> str:
    """The range of evaluations, and those of the iterated rules."""
    sensor = next(iter(found.costs))
    each = found.costs[sensor]
    few, many = (pick(each, key=lambda r: each[r].evaluations) for pick in (min, max))
    return (
        f"A step with {SENSORS[sensor].title} takes from {each[few].evaluations:.0f} evaluations "
        f"({few}) to {each[many].evaluations:.0f} ({many}); {ITERATED} takes "
        f"{each[ITERATED].evaluations:.0f}, {SMOOTHER} {each[SMOOTHER].evaluations:.0f}."
    )


def rest(found: Study) -> str:
    """Where iterating did not come to rest."""
    share, sensor, s = min(
        (each["share"], sensor, s)
        for sensor, cases in found.settled.items()
        for s, each in cases.items()
    )
    others = min(
        each["share"]
        for name, cases in found.settled.items()
        if name != sensor
        for each in cases.values()
    )
    return (
        f"Fewest simulations came to rest with {SENSORS[sensor].title} at s = {s} rad, {share:.1%}"
        f"; with every other sensor at least {others:.1%}."
    )


def audits(found: Study) -> str:
    """How often the audit's verdict is right."""
    total = _sum(each for audits in found.audits.values() for each in audits.values())
    return (
        f"With every sensor at s = {_WIDEST} rad, {total.caught} of {total.wrong} results that are "
        f"{WRONG:g} nats or more off are suspect, {total.alarms} of {total.right} that are less "
        f"than {RIGHT:g} off; {total.missed} of the former are neither suspect nor told to be "
        "beyond the audit's trust. Off by, in what the audit judges: the KL of the pose after the "
        "step, of a smoother that of both poses together, or the error of the log-evidence, "
        "whichever is larger."
    )


def estimates(found: Study) -> str:
    """How near estimates are, and how many are vouched for."""
    every = found.estimates.values()
    return (
        f"`pgm.estimate` at s = {_WIDEST} rad: mean KL from {min(e.kl for e in every):.2g} to "
        f"{max(e.kl for e in every):.2g} nats; {min(e.vouched for e in every):.0%} or more of the "
        "simulations of each sensor are vouched for, and of these at most "
        f"{max(e.beyond for e in every):.1%} are further from exact than their verdict says."
    )


def _below(one: Score, other: Score) -> bool:
    """Whether a mean KL is certainly the lower one."""
    error = (one.kl_se**2 + other.kl_se**2) ** 0.5
    return bool(other.kl - one.kl > _SURE * error)


def _sum(every: Iterable[Audited]) -> Audited:
    each = list(every)
    counts = ("wrong", "right", "caught", "alarms", "missed")
    trusted = sum(one.trusted for one in each) / max(len(each), 1)
    return Audited(
        **{name: sum(getattr(one, name) for one in each) for name in counts}, trusted=trusted
    )


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.0%}" if whole else "none"


def _listed(items: Iterable[str]) -> str:
    every = list(items)
    return ", ".join(every[:-1]) + (" and " if len(every) > 1 else "") + every[-1]
