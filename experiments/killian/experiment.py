"""The Killian Court recording: a laser's scans found again in a map that other scans have made.

In summary.json, ``graph`` has the pose graph's error at the recording's poses and at its optimum,
and how far these are apart [m, m, rad]; ``map`` its cells; ``dead_reckoning`` and ``particles``
RMS, median and largest distance from the recording's poses [m], the heading's RMS error [rad], and
of particles their own RMS deviation [m], the mean NEES (3, where a belief is right about itself)
and seconds; ``starts`` by start from anywhere the step from which on it is found, or null;
``part`` the same numbers of a grid and of particles on a part of the drive, and ln p(z).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer

import pgm
from experiments.killian import figures, log, made_up
from experiments.killian.drive import EVERY, RESOLUTION, STD, STRAY_STD, WEIGHT, Drive, driven
from experiments.killian.graph import Fit, differing, fitted
from experiments.killian.localise import (
    LOST,
    TURNS,
    Gridded,
    Stray,
    Tracked,
    errors,
    gridded,
    strays,
    tracked,
)
from experiments.record import Out, Record, Seed, note

QUICK: dict[str, Any] = {
    "data": "made_up",
    "particles": 500,
    "starts": 3,
    "stray": 10_000,
    "part": 62,
}


def run(
    out: Out = None,
    seed: Seed = 0,
    path: Annotated[
        Path | None,
        typer.Option(help="The .g2o file, or its .zip; that of rtb-data without.", exists=True),
    ] = None,
    data: Annotated[
        Literal["recorded", "made_up"], typer.Option(help="The recording, or a small drive.")
    ] = "recorded",
    particles: Annotated[
        int, typer.Option(min=100, help="Particles of the robot that knows where it began.")
    ] = 2000,
    starts: Annotated[
        int, typer.Option(min=1, help="Starts of a robot that may be anywhere.")
    ] = 20,
    stray: Annotated[int, typer.Option(min=1000, help="Particles at each of these.")] = 100_000,
    part: Annotated[
        int, typer.Option(min=0, help="The step with which the grid's part of the drive begins.")
    ] = 570,
    cell: Annotated[float, typer.Option(min=0.05, help="Width of the grid's cells [m].")] = 0.25,
) -> None:
    """Find a recorded robot by its laser in a map that its other scans have made."""
    simulated = data == "made_up"
    if simulated and path is not None:
        raise pgm.EvidenceError("--path names a recording, --data made_up none: give one of them")
    if not simulated and path is None and log.find() is None:
        note(f"killian: {log.MISSING}")
        return
    recording = made_up.drive(seed) if simulated else log.load(path)
    record = Record(
        "killian",
        out,
        seed=seed,
        data=data,
        particles=particles,
        starts=starts,
        stray=stray,
        part=part,
        cell=cell,
        resolution=RESOLUTION,
        every=EVERY,
        weight=WEIGHT,
        std=STD,
        stray_std=STRAY_STD,
    )
    fit = fitted(recording)
    drive = driven(recording)
    known = tracked(drive, particles, seed)
    lost = strays(drive, starts, stray, seed)
    cells = gridded(drive, part, cell, stray, seed)

    if simulated:
        record.note("The drive is made up, and no recording: two laps around a block of corridors.")
    _poses(record, drive, fit)
    record.figure(
        figures.overview(drive, known.followed),
        "map",
        "The map that the even scans make [m] (black: occupied, blue: never seen), and on it the "
        "drive of the odd ones: the recording's poses, the particles' means, and the odometry "
        "alone, which drifts away.",
    )
    reckoned = errors(differing(drive.dead_reckoning, drive.poses))
    _tracked(record, known, particles, reckoned)
    record.figure(
        figures.by_distance(drive, known.followed),
        "errors",
        "Distance [m] and heading [degrees] from the recording's poses over the metres driven, of "
        "odometry alone and of particles, beside the deviation that the particles give themselves. "
        "Logarithmic; the odometry's begin with its first motion.",
    )
    record.figure(
        figures.zoom(drive, known.followed),
        "zoom",
        "Around the largest error, in metres: the recording's poses, the particles' means with 95 "
        "% ellipses, and one scan where the particles place it in the map.",
    )
    _strays(record, lost, stray)
    shown = next((each for each in lost if each.found_at is not None), lost[0])
    record.figure(
        figures.stray(drive, shown),
        "anywhere",
        f"A start from anywhere at step {shown.first} of the drive, and the particles some steps "
        "later, the larger the heavier, in metres; the cross is the recording's pose. Fewer are "
        "kept as they gather.",
    )
    record.figure(
        figures.strays(lost),
        "starts",
        "All starts from anywhere: distance from the recording's pose [m] over the steps, "
        f"logarithmic. Dashed, {LOST:g} m, below which a start has found the place.",
    )
    _gridded(record, cells, cell, stray)
    record.figure(
        figures.grid(drive, cells),
        "grid",
        "The grid's belief of the place, given one scan and two [m]: a ring marks the recording's "
        "pose, and cells below a thousandth of the likeliest are left out. Right, distances from "
        "the recording's poses [m] beside the particles', logarithmic.",
    )
    record.summary(
        graph={"before": fit.before, "after": fit.after, "moved": fit.moved},
        map={"shape": drive.map.shape, "within": int(drive.within.sum())},
        dead_reckoning=reckoned,
        particles=known.followed.numbers | {"effective": known.effective},
        starts={each.first: each.found_at for each in lost},
        part={
            name: each.numbers | {"log_evidence": each.log_evidence}
            for name, each in cells.followed.items()
        },
    )


def _poses(record: Record, drive: Drive, fit: Fit) -> None:
    """Note the recording's poses, and the edges made of them."""
    edges, log = drive.log.edges, drive.log
    met = int((edges.second - edges.first != 1).sum())
    east, north, turned = fit.moved.tolist()
    record.note(
        f"{len(log.poses):,} poses, {len(edges.first) - met:,} edges from each to the next and "
        f"{met:,} where places are met again. The poses are no odometry: least squares over all "
        f"edges (Gauss–Newton) lowers their weighted square error from {fit.before:.1f} to "
        f"{fit.after:.1f} only, and moves none by more than {east:.3f} m east, {north:.3f} m north "
        f"and {np.degrees(turned):.2f} degrees: they are an optimum already, and are taken as they "
        "are. The odometry is the edges from each to the next."
    )
    rows, columns = drive.map.shape
    record.note(
        f"The map is of the {len(log.poses[::2]):,} even scans: {rows:,} by {columns:,} cells of "
        f"{RESOLUTION:g} m, in {drive.seconds:.1f} s. The {len(drive.poses):,} odd ones are looked "
        f"for in it, {drive.distance[-1]:,.0f} m; the noise of a motion is that of its two edges "
        f"as the file tells it, {_deviations(drive)}. Scans are judged by a likelihood field, one "
        f"ray in {EVERY}, as if one in {1.0 / WEIGHT:g} of these were independent."
    )
    record.note(
        "Errors are those against the recording's poses of the odd scans. These are no ground "
        "truth of higher accuracy: they were found from the same scans, together with the poses "
        "that the map is made of. Errors tell how well a filter agrees with that optimum, given "
        "the scans up to each step alone."
    )


def _deviations(drive: Drive) -> str:
    ahead, left, turn = np.sqrt(np.diag(drive.cov)).tolist()
    return f"{ahead:.3f} m ahead, {left:.3f} m aside and {np.degrees(turn):.2f} degrees"


def _tracked(record: Record, known: Tracked, count: int, reckoned: dict[str, float]) -> None:
    numbers = known.followed.numbers
    columns = ("rmse", "median", "largest", "heading")
    record.table(
        "Distance from the recording's poses, from a known start",
        ("estimate", "RMSE [m]", "median", "largest", "heading [rad]", "own [m]", "NEES"),
        [
            ("odometry alone", *(reckoned[name] for name in columns), "", ""),
            (
                f"{count:,} particles",
                *(numbers[name] for name in columns),
                numbers["own"],
                numbers["nees"],
            ),
        ],
        about="RMS, median and largest distance [m] and the RMS error of the heading [rad] over "
        "all steps; own: the particles' RMS deviation [m]; NEES: 3 in the mean where a belief is "
        "right about itself.",
    )
    steps = len(known.followed.error) - 1
    record.note(
        f"{numbers['seconds']:.1f} s, {1e3 * numbers['seconds'] / steps:.1f} ms a step; the "
        f"weights are never worth less than {known.effective:.0f} particles."
    )
    record.note(
        "No Gaussian filter is beside it. Scans would have to become readings of the pose, the "
        "maximum of the field near what is predicted; such a reading has used the prediction, "
        "which the filter would then count twice, and in a corridor it says nothing of the place "
        "along it, which a covariance fitted around a maximum, or cut off by where it is looked "
        "for, does not tell."
    )


def _strays(record: Record, lost: list[Stray], count: int) -> None:
    found = [each.found_at for each in lost]
    last = len(lost[0].followed.error) - 1
    limits = (0, 1, 2, 5, 10, last)
    record.table(
        f"Starts from anywhere: how many stay within {LOST:g} m from a step on",
        ("of", *(f"step {limit}" for limit in limits)),
        [
            (
                len(lost),
                *(sum(step is not None and step <= limit for step in found) for limit in limits),
            )
        ],
        about=f"Of so many starts, how many are within {LOST:g} m of the recording's pose from "
        "that step to the last.",
    )
    seconds = np.mean([each.followed.seconds for each in lost])
    text = (
        f"{count:,} particles are drawn from the first scan's likelihood over all cells and "
        f"headings, and as many as KLD-sampling says are kept: {seconds:.2f} s for {last} steps."
    )
    if None in found:
        text += (
            " Starts that are not found follow another place: it explains scans better for some "
            "steps, and when it no longer does, no particle is left where the robot is."
        )
    record.note(text)


def _gridded(record: Record, cells: Gridded, cell: float, count: int) -> None:
    record.table(
        f"{len(cells.followed['grid'].error) - 1} steps from step {cells.first} on, from anywhere "
        "near",
        ("belief", "RMSE [m]", "median", "largest", "heading [rad]", "ln p(z)", "seconds"),
        [
            (
                name,
                *(each.numbers[key] for key in ("rmse", "median", "largest", "heading")),
                each.log_evidence,
                each.seconds,
            )
            for name, each in cells.followed.items()
        ],
        about="Distances from the recording's poses [m] and the RMS error of the heading; the "
        "log-evidence ln p(z) of the scans, which each computes in its own way.",
    )
    record.note(
        f"The grid has {cells.cells:,} cells, {cell:g} m and {360 / TURNS:g} degrees wide, which "
        f"is wide for these motions and scans: the lattice adds a deviation of {cells.added:.2f} m "
        "over all steps, and the field is read at centres alone, so that its ln p(z) is another "
        f"one. {count:,} particles are drawn over the same part of the map, and stay as many."
    )
