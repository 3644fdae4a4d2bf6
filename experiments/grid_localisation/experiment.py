"""Localisation from an unknown pose: a grid, which is never lost, beside Gaussians, which may be.

One landmark in sight leaves a ring of poses, and the second one a single pose. The oracle is the
grid that knows nothing of the first pose; filters and smoothers of every lineariser start as
ignorant, right at the true pose, or wrong and sure of it. In summary.json ``found`` is the first
step where the grid's deviation in the plane is below half a metre; ``starts.<start>.<lineariser>
.<filter|smoother>`` has the mean KL from the grid over the steps and over those from `found` on,
``settled``, the step from which it stays below one nat (null if it never does), RMSE in the plane
[m] and of the heading [rad], mean NEES of three, and ln p(z); ``alike`` the same where the grid,
too, starts right, so that nothing but linearising is left; ``grid`` the grid's own figures.
"""

from __future__ import annotations

import time
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

import pgm
from experiments.grid_localisation import figures, problem
from experiments.grid_localisation.problem import LINEARISERS, STARTS
from experiments.record import Out, Record, Seed
from models.networks import pose
from models.simulation import Drive
from pgm.results import Row

Array = npt.NDArray[np.float64]

QUICK: dict[str, Any] = {"steps": 16, "cell": 0.5, "turn": 7.5}
# A place is found where the deviation in the plane is below this [m], and a belief is as good as
# the grid's where its KL stays below that [nats].
FOUND, NEAR = 0.5, 1.0


def run(
    out: Out = None,
    seed: Seed = 0,
    steps: Annotated[int, typer.Option(min=12, help="Steps of the drive, of a second.")] = 40,
    cell: Annotated[float, typer.Option(min=0.05, max=1.0, help="Width of a cell [m].")] = 0.25,
    turn: Annotated[
        float, typer.Option(min=1.0, max=15.0, help="Width of a cell of headings [degrees].")
    ] = 5.0,
) -> None:
    """A grid finds a robot that no one has placed, and tells how far linearisers are off."""
    record = Record(
        "grid_localisation", out, seed=seed, steps=steps, cell=cell, turn=turn, starts=STARTS
    )
    drive = problem.drive(steps, np.random.default_rng(seed))
    grid = problem.grid(cell, turn)
    began = time.perf_counter()
    oracle = pgm.smooth(problem.network("unknown"), drive.evidence, belief=grid)
    seconds = time.perf_counter() - began
    found = found_at(oracle)
    tables = {start: compared(start, drive, oracle) for start in STARTS}
    alike = compared("right", drive, grid)
    results = {start: judged(table, found) for start, table in tables.items()}
    for start, table in tables.items():
        _tabulate(record, f"Started {start}; the grid unknown", results[start], table)
    _tabulate(record, "Started right, the grid too", judged(alike, found), alike)
    record.note(
        f"{oracle.kind} on {oracle.grid!r}: {seconds:.1f} s for filter and smoother; it has found "
        f"the place at step {found}. {in_a_line(oracle.status)}"
    )
    gaussians = {
        start: pgm.smooth(problem.network(start), drive.evidence, lineariser=pgm.Taylor())
        for start in STARTS
    }
    record.figure(
        figures.maps(oracle, gaussians, drive, figures.moments(found, steps)),
        "beliefs",
        "The grid's beliefs of the place at some steps [m], filtered (above) and smoothed (below): "
        "the darker, the more probable, arrows are headings. Crosses are the robot, ellipses "
        "(95 %) the extended Kalman filters and smoothers by their start. One landmark leaves a "
        "ring of places, which no ellipse is.",
    )
    with record.file("drive.gif") as path:
        figures.animate(oracle, gaussians, drive, path)
    record.picture(
        "drive.gif",
        "The filtered beliefs of the place over time [m]: the grid's in blue, and 95 % ellipses of "
        "the extended Kalman filters by their start.",
    )
    record.figure(
        figures.divergences(tables, found),
        "kl",
        "How far filters are from the grid that knows nothing of the start: KL [nats] at each "
        "step, a panel a start; dotted, where the grid has found the place. Grey, the grid from a "
        "Gaussian of its own moments, which no Gaussian filter can be below for long.",
    )
    record.figure(
        figures.alike(alike),
        "alike",
        "Where filter and grid both start right, KL [nats] at each step is the linearisers' own "
        "part; grey, the grid from a Gaussian of its moments, with gaps where cells are too wide "
        "to tell it from 0.",
    )
    record.summary(
        found=found,
        starts=results,
        alike=judged(alike, found),
        grid=of_grid(oracle, tables["unknown"]) | {"seconds": seconds},
        truth=drive.truth,
    )


def compared(
    start: str, drive: Drive, oracle: pgm.Grid | pgm.results.Posterior
) -> pgm.results.Comparison:
    """Every lineariser from one start, as filter and smoother, beside the oracle and the truth."""
    return pgm.compare(
        problem.network(start),
        drive.evidence,
        linearisers=LINEARISERS,
        oracle=oracle,
        truth={pose: drive.truth},
    )


def found_at(posterior: pgm.results.Posterior) -> int:
    """The first step where the filtered grid's deviation in the plane is below half a metre.

    The last step, where it never is.
    """
    std = np.linalg.norm(posterior.filtered[pose].std[:, :2], axis=1)
    below = np.flatnonzero(std < FOUND)
    return int(below[0]) if below.size else std.size - 1


def judged(table: pgm.results.Comparison, found: int) -> dict[str, dict[str, dict[str, Any]]]:
    """The figures of each lineariser, as filter and as smoother."""
    results: dict[str, dict[str, dict[str, Any]]] = {}
    for row in table.rows:
        results.setdefault(row.lineariser, {})[row.schedule] = {
            "kl": row.kl,
            "kl_found": float(np.nanmean(row.kl_by_step[found:])),
            "settled": settled(row.kl_by_step),
            **of_row(row),
            "error": row.error,
        }
    return results


def of_row(row: Row) -> dict[str, Any]:
    """The figures of a row against the truth, and its log-evidence."""
    return {
        "plane": float(np.hypot(row.rmse["east"], row.rmse["north"])),
        "heading": row.rmse["heading"],
        "nees": row.nees,
        "log_evidence": row.log_evidence,
    }


def settled(kl: Array) -> int | None:
    """The step from which a divergence stays below one nat; None if it never does."""
    above = np.flatnonzero(~(kl < NEAR))
    first = int(above[-1]) + 1 if above.size else 0
    return first if first < kl.size else None


def in_a_line(status: object) -> str:
    """A status with its remarks, which is printed on several lines."""
    return "; ".join(line.strip() for line in repr(status).splitlines())


def of_grid(posterior: pgm.results.Posterior, table: pgm.results.Comparison) -> dict[str, Any]:
    """The grid's own figures."""
    return {
        "cells": repr(posterior.grid),
        "outside": float(posterior.status.outside),
        "status": in_a_line(posterior.status),
        "by_kind": {
            row.kind.name: {"from_gaussian": row.kl, **of_row(row)} for row in table.oracle_rows
        },
    }


def _tabulate(
    record: Record,
    title: str,
    results: dict[str, dict[str, dict[str, Any]]],
    table: pgm.results.Comparison,
) -> None:
    heads = ("lineariser", "schedule", "KL [nats]", "once found", "from step")
    rows: list[tuple[object, ...]] = [
        (label, word, each["kl"], each["kl_found"], _or_never(each["settled"]), *_figures(each))
        for label, by_word in results.items()
        for word, each in by_word.items()
    ]
    for row in table.oracle_rows:
        rows.append((row.lineariser, row.kind, row.kl, "", "", *_figures(of_row(row))))
    record.table(
        title,
        (*heads, "RMSE [m]", "[rad]", "NEES (3)", "ln p(z)"),
        rows,
        about="KL: the mean over steps of KL(grid ‖ belief); once found: the same from the step on "
        "at which the grid has found the place; from step: the first from which it stays below "
        f"{NEAR:g} nat. RMSE of position and heading, and mean NEES, of which 3 is right, are "
        "against the truth. The grid's own KL is from a Gaussian of its moments.",
        best={"KL [nats]": -np.inf, "RMSE [m]": -np.inf, "NEES (3)": 3.0},
        within=("schedule",),
    )


def _figures(each: dict[str, Any]) -> tuple[object, ...]:
    return tuple(each[name] for name in ("plane", "heading", "nees", "log_evidence"))


def _or_never(step: int | None) -> object:
    return "never" if step is None else step
