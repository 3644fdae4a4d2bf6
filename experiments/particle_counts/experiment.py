"""How many particles: errors against their number, ways of drawing anew, and numbers that adapt.

The problems are 1, 2a and 2b of the assignment that `differential_drive` has, here with particles
beside Kalman filters. In summary.json, ``estimators.<1|2a|2b>.<estimator>`` has the RMSE [m], what
its mean square error is above the exact answer's (``excess`` [m²]), the fraction of drives where it
is (``worse``), and its RMS distance from the exact means [m], each number with its standard error;
``slope`` that of the logarithms of distance and number; ``resamplers`` distances and the RMS error
of ln p(z) of each way; ``adapted`` the numbers of particles that KLD-sampling chose, the median and
the range over drives by step.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import typer

from experiments.differential_drive.problems import problems
from experiments.particle_counts import choices, figures, pages
from experiments.particle_counts.study import study
from experiments.record import Out, Record, Seed, progress

COUNTS = (30, 100, 300, 1000, 3000)
# As many as the assignment takes, which its figures show.
SHOWN = 100
# Particles and repeats of the comparison of resamplers.
DRAWN, REPEATS = 300, 5
ADAPTED_RUNS = 8
QUICK: dict[str, Any] = {"runs": 12, "seconds": 4, "reference": 2000}


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=2, help="Drives of each problem.")] = 40,
    seconds: Annotated[int, typer.Option(min=3, help="Seconds of a drive, at most.")] = 16,
    reference: Annotated[
        int, typer.Option(min=1000, help="Particles that stand for the exact answer of problem 2.")
    ] = 10_000,
    noise: Annotated[
        Literal["deviation", "variance"], typer.Option(help="As what N(0, ·) is read.")
    ] = "variance",
) -> None:
    """How many particles are enough: errors by number, four resamplers, and KLD-sampling."""
    record = Record(
        "particle_counts",
        out,
        seed=seed,
        runs=runs,
        seconds=seconds,
        reference=reference,
        noise=noise,
        counts=COUNTS,
    )
    chosen = problems(noise, seconds)
    studies = {
        name: study(chosen[name], runs, COUNTS, reference, seed)
        for name in progress(list(chosen), "particle_counts")
    }
    estimators = {name: each.numbers() for name, each in studies.items()}
    drawn = choices.resamplers(studies["1"], DRAWN, REPEATS, seed)
    adapted = choices.adapted(chosen, ADAPTED_RUNS, seed)

    pages.readings(record, noise, runs, reference)
    pages.estimators(record, studies, estimators, SHOWN)
    record.figure(figures.errors(studies), "errors", pages.errors(studies))
    for name, each in studies.items():
        record.figure(figures.drives(each, SHOWN), f"drive_{name}", pages.drive(each, SHOWN))
        record.figure(figures.tracked(each, SHOWN), f"tracked_{name}", pages.tracked(each, SHOWN))
    pages.resamplers(record, drawn, DRAWN, REPEATS)
    record.figure(figures.resamplers(drawn), "resamplers", pages.RESAMPLERS)
    record.figure(figures.adapted(adapted), "adapted", pages.ADAPTED)
    pages.adapted(record, adapted)
    record.summary(
        estimators=estimators,
        slope={name: each.slope() for name, each in studies.items()},
        resamplers={
            name: {"distance": each.distance.numbers, "spread": each.spread.numbers}
            for name, each in drawn.items()
        },
        adapted={name: each.numbers() for name, each in adapted.items()},
    )
