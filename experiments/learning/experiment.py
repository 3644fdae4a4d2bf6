"""Noise learnt by expectation-maximisation, its expectations taken by each lineariser.

As Kokkala, Solin and Särkkä (Sigma-point filtering and smoothing based parameter estimation in
nonlinear dynamic systems, 2015) compare them, with models of our own choice. In summary.json,
``shares`` has the learnt variances as a part of the true ones, by problem, lineariser and number,
one of each recording; ``log_evidence`` the log-evidence at the start, at the truth and where the
search ended, and ``e_steps`` what that took.
"""

from __future__ import annotations

from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import typer
from matplotlib.figure import Figure

import pgm
from experiments.learning.problems import START, Problem, problems
from experiments.record import Out, Record, Seed, progress
from experiments.unsettled import unsettled
from pgm.plot.drawing.colours import INK, PALETTE

QUICK: dict[str, Any] = {"runs": 2, "steps": 40}
LINEARISERS: dict[str, pgm.Lineariser] = {
    "Taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "cubature": pgm.Cubature(),
    "Gauss–Hermite": pgm.GaussHermite(3),
}
TICKS = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0)
Found = dict[str, Any]


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=1, help="Recordings, each learnt by itself.")] = 20,
    steps: Annotated[int, typer.Option(min=2, help="Steps of a recording.")] = 300,
) -> None:
    """Noise of motions and sensors, learnt by each lineariser from the readings alone."""
    record = Record("learning", out, seed=seed, runs=runs, steps=steps, start=START)
    chosen, found = problems(), {}
    for name, problem in chosen.items():
        found[name] = {
            rule: learnt(problem, lineariser, runs, steps, seed)
            for rule, lineariser in progress(list(LINEARISERS.items()), name)
        }
    for name, problem in chosen.items():
        record.table(
            f"{name}: learnt variances as a part of the true ones, median (10 % to 90 %)",
            ("lineariser", *problem.shares, "gain", "E steps", "refused"),
            [(rule, *_row(each)) for rule, each in found[name].items()],
            about=f"Of {runs} recordings of {steps} steps; 1 is the truth, {START:g} the start. "
            "Gain: of log-evidence over the true model's, median; refused: recordings whose "
            "search ended since no part of a step raised the linearised log-evidence.",
        )
    record.figure(
        figure(chosen, found),
        "shares",
        "Learnt variances as a part of the true ones, a point for each recording; the bar is the "
        "median, the line at 1 the truth. Left the growth model, whose readings do not tell the "
        "sign of the state; right a turning target seen by radar.",
    )
    record.summary(
        shares={n: {r: each["shares"] for r, each in rules.items()} for n, rules in found.items()},
        log_evidence={
            n: {r: each["log_evidence"] for r, each in rules.items()} for n, rules in found.items()
        },
        refused={
            n: {r: each["refused"] for r, each in rules.items()} for n, rules in found.items()
        },
        e_steps={
            n: {r: each["e_steps"] for r, each in rules.items()} for n, rules in found.items()
        },
        median={
            n: {r: _medians(each["shares"]) for r, each in rules.items()}
            for n, rules in found.items()
        },
    )


@unsettled()
def learnt(problem: Problem, lineariser: pgm.Lineariser, runs: int, steps: int, seed: int) -> Found:
    """The noise learnt from each recording, by one lineariser."""
    shares: dict[str, list[float]] = {name: [] for name in problem.shares}
    evidences: dict[str, list[float]] = {"start": [], "truth": [], "end": []}
    e_steps, refused = [], 0
    for run in range(runs):
        drawn = problem.truth.sample(problem.inputs(steps), steps=steps, rng=seed + run)
        found = pgm.fit(
            problem.start,
            drawn.evidence,
            learn=problem.learn,
            lineariser=lineariser,
            steps=steps,
            tolerance=1e-3,
        )
        for name, share in problem.shares.items():
            shares[name].append(share(found.model))
        truth = pgm.smooth(problem.truth, drawn.evidence, lineariser=lineariser, steps=steps)
        evidences["start"].append(float(found.log_evidence[0]))
        evidences["truth"].append(float(truth.log_evidence))
        evidences["end"].append(float(found.log_evidence[-1]))
        e_steps.append(found.status.e_steps)
        refused += not found.status.converged
    return {"shares": shares, "log_evidence": evidences, "e_steps": e_steps, "refused": refused}


def _medians(shares: dict[str, list[float]]) -> dict[str, float]:
    return {name: float(np.median(values)) for name, values in shares.items()}


def _row(found: Found) -> list[Any]:
    cells: list[Any] = []
    for values in found["shares"].values():
        low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
        cells.append(f"{middle:.2f} ({low:.2f} to {high:.2f})")
    gained = np.subtract(found["log_evidence"]["end"], found["log_evidence"]["truth"])
    return [
        *cells,
        f"{np.median(gained):.2f}",
        f"{np.median(found['e_steps']):.0f}",
        found["refused"],
    ]


def figure(chosen: dict[str, Problem], found: dict[str, dict[str, Found]]) -> Figure:
    """The learnt variances of each recording, by lineariser."""
    result, axes = plt.subplots(1, len(chosen), figsize=(11, 4.6), layout="constrained")
    for ax, (name, problem) in zip(axes, chosen.items(), strict=True):
        width = len(LINEARISERS) + 1
        ax.axhline(1.0, color=INK, linewidth=0.8)
        for k, (rule, each) in enumerate(found[name].items()):
            for place, values in enumerate(each["shares"].values()):
                at = place * width + k
                spread = np.linspace(-0.25, 0.25, len(values))
                colour = PALETTE[k]
                label = rule if place == 0 else None
                ax.scatter(at + spread, values, s=12, color=colour, label=label)
                ax.hlines(np.median(values), at - 0.4, at + 0.4, color=colour, linewidth=2)
        ax.set_yscale("log")
        ticks = [t for t in TICKS if ax.get_ylim()[0] <= t <= ax.get_ylim()[1]]
        ax.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        ax.set_yticks([], minor=True)
        ax.set_xticks([p * width + 1.5 for p in range(len(problem.shares))], list(problem.shares))
        ax.set_title({"growth": "growth model", "turn": "turning target"}[name])
    axes[0].set_ylabel("learnt variance / true variance")
    result.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    plt.close(result)
    return result
