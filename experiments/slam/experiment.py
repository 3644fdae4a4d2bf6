"""A robot maps a house while it drives through, and closes a loop: one network, no time."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

import pgm
from experiments.record import Out, Record, Seed, progress
from experiments.slam import figures
from experiments.slam.drive import DRIFT_STD, REACH, SENSOR_STD, TURN_STD, Drive, drive
from experiments.slam.judging import SHRUNK, compared, judged, misfit, quarters, shrinking
from experiments.slam.network import ANYWHERE, SCHEDULE, Map, evidence, mapped, network
from experiments.slam.rooms import rooms
from models import motion

Array = npt.NDArray[np.float64]

QUICK: dict[str, Any] = {"side": 1, "landmarks": 24, "poses": 80, "runs": 4}
# Parts of the way to the closing after which the robot is asked what it knows.
PARTS = (0.25, 0.5, 0.75)


def run(
    out: Out = None,
    seed: Seed = 0,
    side: Annotated[int, typer.Option(min=1, help="Rooms along each of four sides.")] = 5,
    landmarks: Annotated[int, typer.Option(min=12, help="Landmarks on the walls.")] = 300,
    poses: Annotated[int, typer.Option(min=60, help="Poses along the way.")] = 2000,
    runs: Annotated[int, typer.Option(min=2, help="Drives to average over.")] = 5,
) -> None:
    """Map a house of landmarks and locate the robot in it, before and after a loop is closed."""
    record = Record(
        "slam",
        out,
        seed=seed,
        side=side,
        landmarks=landmarks,
        poses=poses,
        runs=runs,
        reach=REACH,
        drift_std=DRIFT_STD,
        turn_std=TURN_STD,
        sensor_std=SENSOR_STD,
        anywhere=ANYWHERE,
        iterations=SCHEDULE.iterations,
    )
    driven = drive(rooms(side), poses, landmarks, runs, np.random.default_rng(seed))
    whole = mapped(driven)
    parts = _known(driven)
    closing = driven.closing
    before, after = parts[closing - 1], parts[closing]
    record.note(
        f"{len(driven.seen)} landmarks of {landmarks} are seen, {len(driven.step)} times from "
        f"{poses} poses along {driven.way[-1]:.0f} m; the loop is closed after "
        f"{driven.way[closing]:.0f} m, at step {closing}."
    )
    record.note(whole.graph._title)
    results = _judged(record, driven, whole, parts)
    changed = shrinking(driven, before, after)
    rows = quarters(changed, float(driven.way[closing]))
    record.table(
        "Closing the loop: deviations of poses before and after the step that closes it",
        ("way [m]", "before [m]", "after [m]", "ratio"),
        rows,
        about="Medians over the poses of each quarter of the way to the closing, of the first run: "
        "the root of the mean variance east and north. Something of the beginning is seen again, "
        f"and poses as far as {changed['reach']:.0f} m back along the way are known at least "
        f"{SHRUNK:.0%} better.",
    )
    record.figure(
        figures.closed(driven, before, after),
        "closing",
        "The house [m], its landmarks, and the first run's beliefs of them and of some poses, "
        "before and after the sighting that closes the loop: ellipses of 95 %. They grow with the "
        "way from the start, at the corner below on the left, and shrink all the way round when "
        "its landmarks are seen again.",
    )
    record.figure(
        figures.shrunk(driven, changed, results["filter"]),
        "shrinking",
        "Deviations of the place [m] along the way [m], of poses and of landmarks at the pose that "
        "saw them first, before and after the closing sighting (dotted); circles, what was known "
        "of each pose when the robot stood there, the mean over runs. What hangs on the last "
        "poses shrinks most, and the beginning, which is known, least.",
    )
    record.figure(
        figures.nees(driven, whole),
        "nees",
        f"NEES of the poses along the way [m], for each degree of freedom, averaged over {runs} "
        "runs, with its 95 % band. Errors of neighbouring poses hang together, so that whole "
        "stretches lie high or low.",
    )
    small = drive(rooms(1), 40, 8, 1, np.random.default_rng(seed)).until(12)
    record.figure(
        figures.clusters(pgm.compile(network(small)), evidence(small)),
        "cluster_graph",
        "The junction tree of the first twelve steps of a drive among eight landmarks, with the "
        "components of each cluster and sepset. Landmarks that are seen from several poses, and "
        "poses that see several landmarks, share clusters; a cluster has but few of them, whatever "
        "the length of the drive.",
    )
    record.summary(
        **results,
        closing={
            "step": closing,
            "way": float(driven.way[closing]),
            "reach": changed["reach"],
            "ratio": rows[-1][-1],
            "quarters": [
                dict(zip(("way", "before", "after", "ratio"), r, strict=True)) for r in rows
            ],
        },
    )


def _known(driven: Drive) -> dict[int, Map]:
    """Maps of what was known after parts of the drive, each begun at the one before."""
    closing = driven.closing
    steps = sorted({round(part * closing) for part in PARTS} | {closing - 1, closing})
    found: dict[int, Map] = {}
    poses = driven.truth[None, :1].repeat(len(driven.odometry), axis=0)
    for step in progress(steps, "slam"):
        poses = _continued(driven, poses, step)
        found[step] = mapped(driven.until(step), poses)
        poses = found[step].poses.mean
    return found


def _continued(driven: Drive, poses: Array, step: int) -> Array:
    """Poses (runs, t, 3) with those that the odometer makes of them up to a step."""
    every = list(poses.swapaxes(0, 1))
    for t in range(len(every) - 1, step):
        every.append(motion.increment(every[-1], driven.odometry[:, t]))
    return np.stack(every, axis=1)


def _judged(record: Record, driven: Drive, whole: Map, parts: dict[int, Map]) -> dict[str, Any]:
    """Tables of errors, of consistency, and of what it took."""
    reckoned = driven.reckoned()
    apart = np.linalg.norm(reckoned[..., :2] - driven.truth[:, :2], axis=-1)
    digits = whole.posterior.status.digits
    result: dict[str, Any] = {
        "dead_reckoning": float(np.sqrt(np.mean(apart**2))),
        "poses": judged(whole.poses[:, 1:], driven.truth[1:]),
        "landmarks": judged(whole.landmarks, driven.landmarks[driven.seen]),
        "misfit": misfit(driven, whole),
        "filter": compared(driven, parts, whole),
        "iterations": int(whole.posterior.status.iterations),
        "converged": float(whole.posterior.status.converged.mean()),
        "digits": None if digits is None else float(np.min(digits)),
        "seconds": whole.seconds,
    }
    runs, fit = len(driven.odometry), result["misfit"]
    record.table(
        f"The whole drive, {runs} runs",
        ("of", "RMSE [m]", "NEES / degrees", "in 95 % region"),
        [
            ("dead reckoning", result["dead_reckoning"], "", ""),
            *(
                (
                    kind,
                    result[kind]["rmse"],
                    f"{result[kind]['nees']:.3f} ± {result[kind]['nees_error']:.3f}",
                    f"{result[kind]['coverage']:.1%}",
                )
                for kind in ("poses", "landmarks")
            ),
        ],
        about="Errors in the plane over runs, and poses or landmarks. A right belief has an NEES "
        "of 1 a degree of freedom, and 95 % of the truths in its region; the error of the mean is "
        f"that over runs. χ² of all steps and sightings at the means is {fit['chi2']:.4f} a degree "
        f"of freedom; of a right model it is between {fit['low']:.4f} and {fit['high']:.4f} in "
        f"95 %. From dead reckoning {result['iterations']} linearisations were made, after which "
        f"{result['converged']:.0%} of the runs have settled.",
        best={"RMSE [m]": -np.inf, "NEES / degrees": 1.0},
    )
    record.table(
        "What was known on the way, and is known in the end",
        ("step", "way [m]", "filter ± [m]", "RMSE [m]", "smoother ± [m]", "RMSE [m] "),
        [
            (
                str(row["step"]),
                row["way"],
                row["filter_std"],
                row["filter_rmse"],
                row["smoother_std"],
                row["smoother_rmse"],
            )
            for row in result["filter"]
        ],
        about="The place of the robot at a step by all that it has seen until then (filter), and "
        "by the whole drive (smoother): mean deviation, and error over runs. The last two lines "
        "are just before and at the closing sighting.",
    )
    record.table(
        "Seconds",
        ("declare", "compile", "infer"),
        [tuple(f"{whole.seconds[key]:.2f}" for key in ("declare", "compile", "infer"))],
        about=f"As measured here, of the whole drive: all {runs} runs in one call, with the "
        "covariances of all poses and landmarks."
        + ("" if digits is None else f" Rounding leaves {np.min(digits):.1f} digits of a mean."),
        folded=True,
    )
    return result
