"""Recorded drives from starts that are hardly known: there linearisers part company.

Starts are drawn about the true one, with the deviations that the prior says. A start's NEES is the
mean over the first seconds, of a component of the position; what counts is the 90th percentile over
starts. From the true start there is KL(oracle ‖ belief), mean over steps, the oracle being a grid
where its cells are narrow enough, and else particles.
In summary.json ``results.<data>.<lineariser>`` has them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

import pgm
from experiments.freiburg import exercise
from experiments.record import Out, Record, Seed, note, progress
from experiments.recordings.drives import Drive
from experiments.wide_start import figures
from experiments.wide_start.cases import CASES, load, starts
from models.networks import pose
from pgm import consistency

Array = npt.NDArray[np.float64]

QUICK: dict[str, Any] = {"data": "plaza2", "runs": 3}
PLANE = ("east", "north")
LINEARISERS: dict[str, pgm.Lineariser] = {
    **exercise.LINEARISERS,
    "Gauss–Hermite 3": pgm.GaussHermite(3),
}


def run(
    out: Out = None,
    seed: Seed = 0,
    data: Annotated[
        str | None, typer.Option(help=f"One of {', '.join(CASES)}; all that are found without.")
    ] = None,
    runs: Annotated[int, typer.Option(min=1, help="Starts that are drawn.")] = 20,
) -> None:
    """Begin recorded drives anywhere near the truth, and see which linearisers bear it."""
    if data is not None and data not in CASES:
        raise pgm.EvidenceError(f"{data!r} is not a recording: {', '.join(CASES)}")
    found = {name: load(name) for name in ([data] if data else CASES)}
    for name, drive in found.items():
        if drive is None:
            note(f"wide_start: {name} is not here; {CASES[name].setting.needs}")
    there = {name: drive for name, drive in found.items() if drive is not None}
    if not there:
        return
    record = Record("wide_start", out, seed=seed, data=list(there), runs=runs)
    results: dict[str, Any] = {}
    for name, drive in there.items():
        results[name] = {label: {} for label in LINEARISERS}
        if drive.truth is not None:
            _drawn(record, drive, runs, np.random.default_rng(seed), results[name])
        if CASES[name].oracle is not None:
            _beside_oracle(record, drive, results[name])
    record.summary(results=results)


def judged(
    drive: Drive, means: Array, of: Iterable[str] = LINEARISERS
) -> dict[str, tuple[Array, Array]]:
    """By lineariser: NEES of the position, a component's, (starts, T+1), and RMSE [m] (starts,)."""
    assert drive.truth is not None
    found = {}
    for label in progress(list(of), drive.name):
        squares, errors = [], []
        for mean in means:
            model = drive.network(start=mean)
            belief = pgm.filter(model, drive.evidence, lineariser=LINEARISERS[label])[pose]
            squares.append(consistency.nees(belief, drive.truth, PLANE) / len(PLANE))
            errors.append(consistency.rmse(belief, drive.truth, PLANE))
        found[label] = np.array(squares), np.array(errors)
    return found


def _drawn(
    record: Record, drive: Drive, runs: int, rng: np.random.Generator, results: dict[str, Any]
) -> None:
    """The NEES over time of every start, with every lineariser."""
    case = CASES[drive.name]
    over_time = {}
    for label, (squares, errors) in judged(drive, starts(drive, runs, rng)).items():
        over_time[label] = squares
        each = np.nanmean(squares, axis=1)
        known = squares[:, ~np.isnan(squares[0])]
        results[label] |= {
            "nees_90": float(np.percentile(each, 90)),
            "nees_median": float(np.median(each)),
            "nees_end": float(np.percentile(known[:, -1], 90)),
            "rmse_90": float(np.percentile(errors, 90)),
        }
    record.table(
        f"{drive.name}: {runs} starts, known to {case.about}; the first {case.seconds:g} s",
        ("lineariser", "NEES, 90 % of starts", "median", "at the end, 90 %", "RMSE, 90 % [m]"),
        [
            (label, found["nees_90"], found["nees_median"], found["nees_end"], found["rmse_90"])
            for label, found in results.items()
        ],
        about="NEES of the position, a component's: 1 of a right belief; a start's is its mean "
        "over time. Percentiles are over starts.",
        best={"NEES, 90 % of starts": -np.inf, "RMSE, 90 % [m]": -np.inf},
    )
    record.figure(
        figures.over_time(drive, over_time),
        f"{drive.name}_nees",
        f"NEES of the position of {drive.name} over time [s], a component's, on a logarithmic "
        "axis: the 90th percentile of starts. A right belief has 1 on average.",
    )


def _beside_oracle(record: Record, drive: Drive, results: dict[str, Any]) -> None:
    """Every lineariser, from the true start, beside the oracle."""
    case = CASES[drive.name]
    kind = "grid" if isinstance(case.oracle, pgm.Grid) else "particles"
    model, evidence = drive.network(), drive.evidence
    found = pgm.compare(
        model,
        evidence,
        linearisers=LINEARISERS,
        schedules={"filter": pgm.Filtering()},
        oracle=pgm.filter(model, evidence, belief=case.oracle),
    )
    for label in LINEARISERS:
        row = found[label, "filter"]
        results[label] |= {"kl": float(row.kl), "kl_error": float(row.kl_error)}
    record.table(
        f"{drive.name}: KL from the {kind}, the start known to {case.about}",
        ("lineariser", f"KL({kind} ‖ filter) [nats]", "± of the oracle"),
        [(label, each["kl"], each["kl_error"]) for label, each in results.items()],
        about="From the true start; the mean over steps, of the Gaussian of the oracle's moments, "
        "and its Monte Carlo error.",
        best={f"KL({kind} ‖ filter) [nats]": -np.inf},
    )
    record.note(repr(found))
    figure, ax = figures.empty()
    pgm.plot.comparison(found, ax=ax)
    record.figure(
        figure,
        f"{drive.name}_kl",
        f"KL({kind} ‖ filter) [nats] over the steps of {drive.name}, each from the true start.",
    )
