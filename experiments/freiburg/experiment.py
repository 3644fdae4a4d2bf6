"""The Freiburg exercise: an extended Kalman filter of odometry and ranges, and what it leaves out.

The exercise's noise is far wider than the robot's, so that beliefs are wide and linearisers part.
The references are a particle filter and a grid, as Gaussians of their moments at each step. In
summary.json, ``divergence.<alone|stacked>.<lineariser>`` has mean, median and largest
KL(particles ‖ filter) over the steps, the ranges of a step linearised one by one or as one vector;
``divergence_from_grid`` mean and largest KL of filters and of smoothers from the grid; ``grid`` its
cells, the seconds it took, how far it is from a Gaussian itself, and the largest difference of a
filter's mean KL from that to the particles, as a part of it; ``log_evidence`` those of the filters,
of the particles and of the grid; ``from_dead_reckoning`` root mean square distances in the plane;
``heading_std`` the mean standard deviation that the filters give their headings; ``steps_apart``
the steps where the filters are furthest from the particles.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

import pgm
from experiments.freiburg import exercise, figures
from experiments.freiburg import log as recording
from experiments.freiburg.exercise import LINEARISERS
from experiments.freiburg.grid import compared, gridded
from experiments.freiburg.log import Log
from experiments.freiburg.particles import particle_filter
from experiments.record import Out, Record, Seed, note, progress
from models.networks import pose
from pgm import consistency

Array = npt.NDArray[np.float64]
Posteriors = dict[str, pgm.results.Posterior]

QUICK: dict[str, Any] = {"particles": 20_000}
STACKED = {"alone": False, "stacked": True}


def run(
    out: Out = None,
    seed: Seed = 0,
    path: Annotated[
        Path | None,
        typer.Option(
            help="Folder of sensor_data.dat and world.dat; freiburg in PGM_DATA or in "
            "../shared/data without.",
            exists=True,
            file_okay=False,
        ),
    ] = None,
    particles: Annotated[
        int, typer.Option(min=1000, help="Particles of the filter that tells what is right.")
    ] = 1_000_000,
) -> None:
    """Localise a recorded robot by ranges with pessimistic noise, where linearisers part."""
    folder = path or recording.find()
    if folder is None:
        note(
            "freiburg: the recording is not there; give its folder with --path, or name the "
            f"folder that holds it as freiburg/ in the environment variable {recording.VARIABLE}"
        )
        return
    log = recording.load(folder)
    record = Record(
        "freiburg",
        out,
        seed=seed,
        particles=particles,
        start_variance=exercise.START,
        motion_variance=exercise.MOTION,
        sensor_variance=exercise.SENSOR,
    )
    record.note(
        f"{len(log.odometry)} steps, {len(log.ranges)} ranges of {len(log.landmarks)} landmarks; "
        "the exercise uses no bearings"
    )
    posteriors = {name: smooth(log, grouped=grouped) for name, grouped in STACKED.items()}
    cloud = particle_filter(log, particles, seed)
    found = {name: divergences(cloud.belief, each) for name, each in posteriors.items()}
    grid = gridded(log)
    tables = {
        name: compared(log, grid.posterior, grouped=grouped) for name, grouped in STACKED.items()
    }
    from_grid = {name: by_schedule(each) for name, each in tables.items()}
    alone, reckoned = posteriors["alone"], dead_reckoning(log)
    headings = {label: own_deviation(p.filtered[pose]) for label, p in alone.items()}
    headings["particles"] = own_deviation(cloud.belief)
    evidence = {
        name: {label: float(p.log_evidence) for label, p in each.items()}
        for name, each in posteriors.items()
    }
    away = {
        label: {"filter": rms(p.filtered[pose], reckoned), "smoother": rms(p[pose], reckoned)}
        for label, p in alone.items()
    }
    record.table(
        f"KL of the filtered belief from {particles:,} particles [nats], and log-evidence",
        ("lineariser", "mean", "median", "largest", "mean, stacked", "ln p(z)", "ln p(z), stacked"),
        [
            (
                label,
                *found["alone"][label].values(),
                found["stacked"][label]["mean"],
                evidence["alone"][label],
                evidence["stacked"][label],
            )
            for label in LINEARISERS
        ]
        + [("particles", "", "", "", "", cloud.log_evidence, "")],
        about="KL(particles ‖ filter) over the steps, and the log-evidence ln p(z); stacked: the "
        "same where the ranges of a step are linearised as one vector.",
        best={"mean": -np.inf, "mean, stacked": -np.inf},
    )
    record.note(
        f"at least {int(cloud.effective.min()):,} particles carry the weight, at any step; stacked "
        "filters linearise the ranges of a step as one vector"
    )
    record.table(
        f"KL from a grid of {cell_count(grid.posterior):,} cells [nats]",
        (
            "lineariser",
            "filter",
            "filter's largest",
            "filter, stacked",
            "smoother",
            "smoother's largest",
            "smoother, stacked",
        ),
        [
            (
                label,
                *(
                    value
                    for word in ("filter", "smoother")
                    for value in (
                        *from_grid["alone"][label][word].values(),
                        from_grid["stacked"][label][word]["mean"],
                    )
                ),
            )
            for label in LINEARISERS
        ]
        + [
            (
                "grid, from its own Gaussian",
                *(v for row in tables["alone"].oracle_rows for v in (row.kl, row.kl_most, "")),
            )
        ],
        about="KL(grid ‖ belief), the mean and the largest of the steps; stacked: the mean where "
        "the ranges of a step are linearised as one vector. Last, the grid from a Gaussian of its "
        "own moments.",
    )
    differ = largest_difference(found, from_grid)
    record.note(
        f"the grid took {grid.seconds:.1f} s for filter and smoother; its log-evidence is "
        f"{float(grid.posterior.log_evidence):.2f}; mean KL of filters from it and from the "
        f"particles differ by at most {100.0 * differ:.2g} %"
    )
    record.table(
        "RMS distance from dead reckoning, and the filters' own deviation of the heading",
        ("lineariser", "filter [m]", "smoother [m]", "heading [rad]"),
        [(label, *each.values(), headings[label]) for label, each in away.items()]
        + [("particles", "", "", headings["particles"])],
        about="Dead reckoning has the odometry alone, which is good here; heading: the mean "
        "standard deviation that a filter gives it.",
        folded=True,
    )
    apart = furthest(cloud.belief, alone)
    record.note(
        "No truth was recorded. The odometry is far better than the exercise takes it to be: the "
        "path that it makes alone is a good one."
    )
    record.figure(
        figures.path(log, alone["Taylor"], reckoned),
        "path",
        "The exercise as set, in metres: extended Kalman filter (left), and beside it the "
        "smoother, with 95 % ellipses; dead reckoning for comparison, since no truth was recorded.",
    )
    record.figure(
        figures.filters(log, alone, cloud.belief),
        "filters",
        "Filtered means by lineariser over the particles' (black), with 95 % ellipses, in metres.",
    )
    record.figure(
        figures.divergence(cloud.belief, alone),
        "divergence",
        "How far each filtered belief is from the Gaussian of the particles' moments: KL [nats] "
        "over the steps.",
    )
    record.figure(
        figures.compared(tables["alone"]),
        "comparison",
        "How far filters and smoothers are from the grid's beliefs: KL [nats] over the steps; "
        "grey, the grid from a Gaussian of its own moments.",
    )
    record.figure(
        figures.beliefs(alone, cloud, apart),
        "beliefs",
        "Particles and 95 % ellipses of the filters, in the plane [m], at the steps where they "
        "differ most.",
    )
    record.summary(
        divergence=found,
        log_evidence=evidence
        | {"particles": cloud.log_evidence, "grid": float(grid.posterior.log_evidence)},
        divergence_from_grid=from_grid,
        grid={
            "cells": repr(grid.posterior.grid),
            "seconds": grid.seconds,
            "outside": float(grid.posterior.status.outside),
            "from_gaussian": {row.kind.name: row.kl for row in tables["alone"].oracle_rows},
            "from_particles": differ,
        },
        from_dead_reckoning=away,
        heading_std=headings,
        effective_particles=float(cloud.effective.min()),
        steps_apart=apart,
    )


def smooth(log: Log, *, grouped: bool = False) -> Posteriors:
    """The smoothed posterior of each lineariser, which has its filtered one."""
    model, evidence = exercise.network(grouped=grouped), log.evidence
    return {
        label: pgm.smooth(model, evidence, lineariser=LINEARISERS[label])
        for label in progress(list(LINEARISERS), "freiburg")
    }


def divergences(
    reference: pgm.Gaussian, posteriors: Mapping[str, pgm.results.Posterior]
) -> dict[str, dict[str, float]]:
    """Mean, median and largest KL(reference ‖ filtered belief) over the steps, by lineariser.

    Parameters
    ----------
    reference : Gaussian
        Of the pose, over steps 0..T: the moments of any filter that knows better.
    posteriors : mapping of str to Posterior
    """
    found = {}
    for label, posterior in posteriors.items():
        kl = consistency.kl(reference, posterior.filtered[pose])
        found[label] = {
            "mean": float(kl.mean()),
            "median": float(np.median(kl)),
            "largest": float(kl.max()),
        }
    return found


def by_schedule(table: pgm.results.Comparison) -> dict[str, dict[str, dict[str, float]]]:
    """Mean and largest KL over the steps, by lineariser and schedule."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for row in table.rows:
        by_word = found.setdefault(row.lineariser, {})
        by_word[row.schedule] = {"mean": row.kl, "largest": row.kl_most}
    return found


def largest_difference(
    particles: Mapping[str, Mapping[str, Mapping[str, float]]],
    grid: Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]],
) -> float:
    """The largest difference of filters' mean KL from two references, as a part of the first."""
    return max(
        abs(grid[name][label]["filter"]["mean"] / each["mean"] - 1.0)
        for name, by_label in particles.items()
        for label, each in by_label.items()
    )


def cell_count(posterior: pgm.results.Posterior) -> int:
    """The number of a grid's cells."""
    return int(np.prod([each.size for each in posterior[pose.at(0)].centres]))


def furthest(
    reference: pgm.Gaussian, posteriors: Mapping[str, pgm.results.Posterior], count: int = 4
) -> list[int]:
    """The steps where the filters are furthest from the reference, well apart, in order."""
    kl = sum(consistency.kl(reference, p.filtered[pose]) for p in posteriors.values())
    chosen: list[int] = []
    for step in np.argsort(-np.asarray(kl)).tolist():
        if all(abs(step - other) >= 30 for other in chosen):
            chosen.append(step)
    return sorted(chosen[:count])


def dead_reckoning(log: Log) -> Array:
    """The path (T+1, 3) that the odometry alone makes, from (0, 0, 0) [m, m, rad]."""
    return log.recording.dead_reckoning(np.zeros(3)).values


def rms(belief: pgm.Gaussian, reckoned: Array) -> float:
    """Root mean square distance of a belief's means from a path in the plane [m]."""
    return consistency.rmse(belief, reckoned, ("east", "north"))


def own_deviation(belief: pgm.Gaussian) -> float:
    """The mean over the steps of the heading's standard deviation [rad]."""
    return float(belief.std[:, 2].mean())
