"""Problems 1, 2a and 2b of an assignment in state estimation, and what it says of particle filters.

summary.json has ``results.<deviation|variance>.<1|2a|2b>.<lineariser>.<filter|smoother>``: RMSE of
position and heading, NEES (mean, at the last step, and the fraction of steps inside the band);
``particles``: the RMSE of the Kalman filter and of particle filters on problem 1, their mean square
error less the Kalman filter's, and its standard error; ``held_noise``: the Kalman filter told w T
in place of w √T; ``about_landmark``: deviations along and across the circle in problem 2b;
``pictures``: how many each animation has.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

import numpy as np
import typer

from experiments.differential_drive import page
from experiments.differential_drive.particles import against_kalman
from experiments.differential_drive.problems import NOISE, problems
from experiments.differential_drive.results import held_noise, solve, spread
from experiments.record import Out, Record, Seed, progress
from pgm import consistency

Meaning = Literal["deviation", "variance"]

PARTICLES = (30, 100, 300)
PARTICLE_DRIVES = 200  # at most, since particles take longer
QUICK: dict[str, Any] = {"runs": 200, "seconds": 4}


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=2, help="Drives of each problem.")] = 500,
    seconds: Annotated[int, typer.Option(min=3, help="Seconds of a drive, at most.")] = 100,
    noise: Annotated[
        Meaning, typer.Option(help="As what the figures and animations read N(0, ·).")
    ] = "deviation",
) -> None:
    """A robot on two driven wheels: filters, smoothers, and particles that are not better."""
    record = Record(
        "differential_drive", out, seed=seed, runs=runs, seconds=seconds, noise=noise, table=NOISE
    )
    solved = {
        meaning: {
            name: solve(problem, runs, np.random.default_rng(seed))
            for name, problem in problems(meaning, seconds).items()
        }
        for meaning in progress(list(get_args(Meaning)), "differential_drive")
    }
    found = {meaning: {n: s.numbers() for n, s in by.items()} for meaning, by in solved.items()}
    one = solved[noise]["1"]
    particles = against_kalman(
        one.problem,
        one.truth,
        one.evidence,
        PARTICLES,
        drives=PARTICLE_DRIVES,
        seed=seed,
    )
    held = held_noise(one, noise)
    around = {meaning: spread(by["2b"]) for meaning, by in solved.items()}

    page.note_readings(record, noise)
    page.tabulate(record, found, runs, noise)
    page.tabulate_particles(record, particles)
    page.note_findings(record, found, noise, held, around)
    pictures = page.show(record, solved, noise)
    record.summary(
        results=found,
        bands={str(n): list(consistency.mean_band(n, runs)) for n in (2, 3)},
        particles=particles,
        held_noise=held,
        about_landmark=around,
        pictures=pictures,
    )
