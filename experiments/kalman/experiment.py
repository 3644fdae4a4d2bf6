"""Kalman filters: the cluster graph's messages are the textbook's numbers.

Figures 4.1 to 4.3 of the 2018 report, with drives and parameters of our own, since it gives none.
`experiments/textbook.py` has its Algorithms 1 to 4, and the smoother that they lead to. In
summary.json, ``difference`` has the largest differences between the two, by algorithm, length of
drive, filter or smoother, and what is compared; ``largest_difference_by`` the largest of each
algorithm, and ``largest_difference`` that of all.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

from experiments.kalman import figures
from experiments.kalman.comparison import Numbers, Solved, differences, solve
from experiments.kalman.problems import (
    DT,
    MOTION,
    MOTION_POSE,
    SENSOR,
    START,
    START_POSE,
    Problem,
    problems,
)
from experiments.record import Out, Record, Seed, progress

QUICK: dict[str, Any] = {"runs": 3, "steps": 20}
CAPTIONS = {
    "kalman": (
        "Figure 4.1: a linear robot at five time steps, located by the Kalman filter. Crosses: "
        "true positions; purple: means and 95 % ellipses; the leftmost is the initial belief."
    ),
    "extended": (
        "Figure 4.2: the velocity motion model, five controls, position measured, located by the "
        "extended Kalman filter (green). Black: the known initial belief; crosses: true positions."
    ),
    "unscented": "Figure 4.3: the same drive and readings, located by the unscented filter (blue).",
}


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=1, help="Drives to compare on; one is drawn.")] = 50,
    steps: Annotated[int, typer.Option(min=1, help="Steps of the longer drives.")] = 200,
) -> None:
    """Kalman filters and smoothers: the cluster graph gives the textbook's numbers."""
    record = Record(
        "kalman",
        out,
        seed=seed,
        runs=runs,
        steps=steps,
        dt=DT,
        linear={"start_std": START, "motion_std": MOTION, "sensor_std": SENSOR},
        velocity={"start_std": START_POSE, "motion_std": MOTION_POSE, "sensor_std": SENSOR},
    )
    chosen = problems()
    found: dict[str, dict[str, Numbers]] = {}
    drawn: dict[str, Solved] = {}
    for name in progress(list(chosen), "kalman"):
        drawn[name], found[name] = compare(chosen[name], runs, steps, seed)
        record.figure(figures.drive(chosen[name], drawn[name]), name, CAPTIONS[name])
    record.note(
        "The report gives neither the parameters nor the numbers of these figures: the parameters "
        "are ours. EKF and UKF means of the drive shown differ by at most "
        f"{_apart(chosen, drawn):.2g} m: the readings are linear and the steps short."
    )
    record.figure(
        figures.smoothers(chosen, drawn),
        "smoothers",
        "Beyond the report: messages sent back as well make the Rauch–Tung–Striebel smoothers. "
        "Places in metres; 95 % ellipses, grey of the filter and coloured of the smoother, which "
        "are smaller but at the last step, where both know the same.",
    )
    record.table(
        f"Cluster graph against textbook: largest difference in {runs} drives [m, rad]",
        ("algorithm", "steps", "means", "covariances", "ln p(z)"),
        [
            (f"{problem.title} {kind}", int(length), *numbers[kind].values())
            for name, problem in chosen.items()
            for kind in ("filter", "smoother")
            for length, numbers in found[name].items()
        ],
        about="Ours less the textbook's, the largest of all drives, steps and components.",
    )
    by = {name: largest(found[name]) for name in chosen}
    worst = max(by.values())
    record.note(f"largest difference of all: {worst:.2g}; 1e-9 is allowed")
    record.summary(difference=found, largest_difference_by=by, largest_difference=worst)


def compare(
    problem: Problem, runs: int, steps: int, seed: int
) -> tuple[Solved, dict[str, Numbers]]:
    """The five-step drives, and the differences there and on longer ones, by length."""
    short = solve(problem, problem.controls, runs, seed)
    longer = solve(problem, np.resize(problem.controls, (steps, 2)), runs, seed)
    return short, {
        str(length): differences(problem, solved)
        for length, solved in ((len(problem.controls), short), (steps, longer))
    }


def largest(found: dict[str, Numbers]) -> float:
    """The largest of an algorithm's differences."""
    return max(n for numbers in found.values() for kind in numbers.values() for n in kind.values())


def _apart(chosen: dict[str, Problem], drawn: dict[str, Solved]) -> float:
    """How far the means of the two nonlinear filters are apart on the drive shown."""
    one, other = (
        drawn[name].filtered[chosen[name].state].run(0).mean[:, :2]
        for name in ("extended", "unscented")
    )
    return float(np.linalg.norm(one - other, axis=-1).max())
