"""Pages of the report about numbers of particles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from experiments.differential_drive.problems import NOISE
from experiments.particle_counts.choices import LEAST, LOST, MOST, WIDTHS, Adapted, Drawn
from experiments.particle_counts.figures import HIGHEST
from experiments.particle_counts.study import KALMAN, Study, label
from experiments.record import Record

RESAMPLERS = (
    "Four ways of drawing anew, at every step of problem 1: distance from the Kalman filter's "
    "means, and error of the log-evidence, with two standard errors over the drives. The same "
    "drives enter all four, so that the differences are better known than the bars say."
)
ADAPTED = (
    "Above, the numbers of particles that KLD-sampling chose (median and range over drives), and "
    "below the standard deviation of the place [m], both over time [s]: the wider the belief, the "
    "more particles."
)


def readings(record: Record, noise: str, runs: int, reference: int) -> None:
    """How the problems are read, and what is taken for exact."""
    listed = ", ".join(f"{name} {value:g}" for name, value in NOISE.items())
    record.note(
        f"Problems 1, 2a and 2b of an assignment (ME8135, 2023), its N(0, ·) read as {noise}s: "
        f"{listed}. The experiment differential_drive says how the rest is read. Every estimator "
        f"has the same {runs} drives of each. Exact is, on problem 1, the Kalman filter; on 2a and "
        f"2b, whose posterior has no formula, {reference:,} particles stand for it."
    )


def estimators(
    record: Record,
    studies: Mapping[str, Study],
    found: Mapping[str, Mapping[str, Any]],
    shown: int,
) -> None:
    """Every estimator of each problem."""
    for name, by in found.items():
        record.table(
            f"{studies[name].problem.title}: estimators, each number with its standard error",
            ("estimator", "RMSE [m]", "excess [m²]", "worse in", "from exact [m]"),
            [
                (
                    estimator,
                    _with_error(each["rmse"]),
                    _with_error(each["excess"]) if each["distance"]["value"] else "",
                    f"{each['worse']:.0%}" if each["distance"]["value"] else "",
                    _with_error(each["distance"]) if each["distance"]["value"] else "",
                )
                for estimator, each in by.items()
            ],
            about="RMSE of the place over drives and steps. Excess: the mean square error less the "
            "exact answer's, on the same drives, and the share of drives in which it is above 0. "
            "From exact: how far the means are from the exact answer's (RMS). Blank where the row "
            "is the exact answer.",
        )
    record.note(winner(found["1"], shown))
    record.note(
        "Excess is an estimator's mean square error less the exact answer's, on the same drives. "
        "Distances fall as 1/√N once there are enough: "
        + "; ".join(
            f"problem {name}, with N^{study.slope():.2f} from {_largest(study)} on"
            for name, study in studies.items()
        )
        + ". The particles that stand for the exact answer err too, by "
        + " and ".join(
            f"{study.own_error():.2g} m in problem {name}"
            for name, study in studies.items()
            if study.reference is not None
        )
        + " if it goes on so: no distance from them says less, and an excess below 0 is theirs, or "
        "chance."
    )


def winner(linear: Mapping[str, Any], shown: int) -> str:
    """The Kalman filter beside particles where everything is linear, as measured."""
    best = linear[KALMAN["exact"]]["rmse"]["value"]
    particles = linear[label(shown)]
    excess, error = particles["excess"]["value"], particles["excess"]["error"]
    others = {name: each["excess"] for name, each in linear.items() if name != KALMAN["exact"]}
    above = [name for name, e in others.items() if e["value"] > 2.0 * e["error"]]
    below = [name for name, e in others.items() if e["value"] < -2.0 * e["error"]]
    said = [
        f"{side} 0 by more than two standard errors with {', '.join(names)}"
        for side, names in (("above", above), ("below", below))
        if names
    ]
    verdict = "wins" if excess > 2.0 * error else "is not told from them" if not below else "loses"
    return (
        "The assignment finds its particle filter much more accurate than the Kalman filter. Where "
        "motion and readings are linear and noise is normal the Kalman filter is the exact answer, "
        "whose expected square error no other estimator's can be below. Measured here: RMSE "
        f"{best:.4f} m of the Kalman filter and {particles['rmse']['value']:.4f} m of {shown} "
        f"particles, an excess of {excess:.2g} ± {error:.1g} m², worse in "
        f"{particles['worse']:.0%} of the drives: the Kalman filter {verdict}. The excess is "
        f"{'; '.join(said) or 'within two standard errors of 0'}."
    )


def resamplers(record: Record, found: Mapping[str, Drawn], count: int, repeats: int) -> None:
    """Each way of drawing anew."""
    record.table(
        f"Ways of drawing anew, {count} particles at every step of problem 1, {repeats} times",
        ("way", "from exact [m]", "± s.e. [m]", "error of ln p(z)", "± s.e."),
        [
            (
                name,
                each.distance.value,
                each.distance.error,
                each.spread.value,
                each.spread.error,
            )
            for name, each in found.items()
        ],
        about="From exact: RMS distance of the means from the Kalman filter's. Error of ln p(z): "
        "RMS, of the log-evidence, in nats.",
        best={"from exact [m]": -np.inf, "error of ln p(z)": -np.inf},
    )


def adapted(record: Record, found: Mapping[str, Adapted]) -> None:
    """The numbers of particles that KLD-sampling chose."""
    widths = ", ".join(f"{name} {width:g}" for name, width in WIDTHS.items())
    told = "; ".join(
        f"{each.title}, {each.medians[0]:,} after the first step and {each.medians[1]:,} at the "
        f"end (all between {each.number[:, 1:].min():,} and {each.number[:, 1:].max():,}), there "
        f"{np.median(each.last):.2g} m from the truth"
        for each in found.values()
    )
    record.note(
        f"KLD-sampling, bins of {widths} [m, m, rad], from {LEAST:,} to {MOST:,} particles "
        f"(medians over {len(next(iter(found.values())).last)} drives): {told}. A belief that "
        "readings hold together needs few; about the one landmark of 2b it grows along the circle, "
        "and particles with it."
    )
    lost = [f"{each.lost} of {len(each.last)} ({each.title})" for each in found.values()]
    record.note(
        f"Drives lost at the end, more than {LOST:g} m from the truth: {', '.join(lost)}. Bins "
        "count particles that are there, none that lack: where a first reading leaves a handful of "
        "a wide belief, they fill few bins, and few are drawn, whose headings may all be wrong. "
        "Then `least` has to be larger."
    )


def errors(studies: Mapping[str, Study]) -> str:
    """The caption of the errors."""
    constants = ", ".join(f"{each.constant():.2g} ({name})" for name, each in studies.items())
    return (
        "Left: how far the particles' means are from the exact ones, with two standard errors; "
        "lines are c √(1/N + 1/M), M the number that stands for exact, infinite in problem 1, with "
        f"c = {constants} m of the largest N. Right: RMSE on the same drives, in units of the "
        "exact answer's, with two standard errors of the difference; cut where it is above "
        f"{HIGHEST:g}."
    )


def drive(study: Study, count: int) -> str:
    """The caption of a drive."""
    return (
        f"{study.problem.title}: a drive as {count} particles (left) and a Kalman filter (right) "
        "have it, places in metres, with 95 % ellipses of their beliefs after each reading; in the "
        "form of the assignment's figure 2."
    )


def tracked(study: Study, count: int) -> str:
    """The caption of readings over time."""
    band = "" if study.problem.given else ", with their 95 % band; readings in metres"
    return (
        f"{study.problem.title}: readings over time [s], and what they would be without noise at "
        "the true place "
        f"and at the mean of {count} particles{band}; in the form of the assignment's figures 3 "
        "and 4."
    )


def _with_error(number: Mapping[str, float]) -> str:
    return f"{number['value']:.4g} ± {number['error']:.1g}"


def _largest(study: Study) -> str:
    return f"{sorted(study.particles)[-3]:,}"
