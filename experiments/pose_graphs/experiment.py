"""Pose graphs: their error at first, by a tree of edges alone, and at the optimum.

In summary.json ``results.<graph>`` has χ² before and after by start and lineariser, and of the
drawn graph how far its poses are from the truth, without and with closures that are false.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

import pgm
from experiments.pose_graphs import figures
from experiments.pose_graphs.drawn import with_false
from experiments.pose_graphs.given import (
    DRAWN,
    PUBLISHED,
    Given,
    drawn,
    find,
    own,
    published,
)
from experiments.pose_graphs.solving import Solved, prepared, solve
from experiments.record import Out, Record, Seed, note, progress
from experiments.recordings.methods import LINEARISERS
from models.pose_graphs import PoseGraphNetwork, squared_errors
from pgm import consistency
from pgm.recordings import PoseGraph

Array = npt.NDArray[np.float64]

QUICK: dict[str, Any] = {"data": DRAWN, "poses": 100}
KNOWN = (DRAWN, *PUBLISHED)
PLANE = ("east", "north")
# Noise of closures that may be false; the last forgets those beyond six deviations. With four it
# leaves out right ones too, from another minimum.
ROBUST: dict[str, pgm.RobustNoise] = {
    "Huber": pgm.Huber(1.345),
    "Cauchy": pgm.Cauchy(1.0),
    "truncated least squares": pgm.TruncatedLeastSquares(6.0),
}
# Robust noise needs more linearisations than Gaussian, as a part of them.
MORE = 4
# A closure of less weight is left out.
USED = 0.1


def run(
    out: Out = None,
    seed: Seed = 0,
    data: Annotated[
        str | None, typer.Option(help=f"One of {', '.join(KNOWN)}; all that are found, without.")
    ] = None,
    path: Annotated[
        Path | None, typer.Option(help="A file of g2o or TORO, in place of these.", exists=True)
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(help="What to make of a file, in TOML; the guide's page about recordings."),
    ] = None,
    linearisers: Annotated[
        str | None, typer.Option(help=f"One of {', '.join(LINEARISERS)}; Taylor without.")
    ] = None,
    poses: Annotated[int, typer.Option(min=40, help="Poses of the drawn graph.")] = 400,
    false: Annotated[
        float,
        typer.Option(min=0.0, help="False closures for each right one, in the drawn graph."),
    ] = 0.1,
) -> None:
    """Solve published pose graphs and a drawn one, from their own poses and from a tree's."""
    for what, value, known in (
        ("a pose graph", data, KNOWN),
        ("a lineariser", linearisers, LINEARISERS),
    ):
        if value is not None and value not in known:
            raise pgm.EvidenceError(f"{value!r} is not {what}: {', '.join(known)}")
    if data is not None and (path is not None or settings is not None):
        raise pgm.EvidenceError(
            f"--path and --settings are of a graph of your own, and --data {data} is not; leave it "
            "out"
        )
    rng = np.random.default_rng(seed)
    given = [own(path, settings)] if path or settings else _found(data, poses, rng)
    if not given:
        return
    used = [linearisers or "Taylor"]
    record = Record(
        "pose_graphs",
        out,
        seed=seed,
        data=[each.name for each in given],
        linearisers=used,
        iterations=given[0].iterations,
        poses=poses,
        false=false,
    )
    results = {}
    for each in given:
        best, results[each.name] = _solved(record, each, used)
        if each.truth is not None:
            results[each.name] |= _against_truth(record, each, best, false, rng)
    record.summary(results=results)


def _found(data: str | None, poses: int, rng: np.random.Generator) -> list[Given]:
    """The drawn graph, and the published ones that are here."""
    found = []
    for name in [data] if data else KNOWN:
        if name == DRAWN:
            found.append(drawn(poses, rng))
        elif (file := find(name)) is not None:
            found.append(published(name, file))
        else:
            note(
                f"pose_graphs: {name} is not here; --path, or the folder posegraphs of recordings "
                "below that named by PGM_DATA"
            )
    return found


def _solved(record: Record, given: Given, linearisers: list[str]) -> tuple[Solved, dict[str, Any]]:
    """Solve a graph from each start; tables and figures of it."""
    graph, name = given.graph, given.name
    ready = prepared(graph)
    made = ready.made
    record.note(f"{name}: {graph!r}")
    if given.about:
        record.note(given.about)
    record.note(_held(made))
    record.note(f"{ready.compiled._title}, declared and compiled in {ready.seconds:.2f} s.")
    if graph.scans is not None:
        record.note("Scans are not taken; the experiment killian finds the robot by them.")
    starts = {given.begin: (graph.poses, graph.landmarks), "the tree alone": made.reckoned()}
    if np.allclose(starts[given.begin][0], starts["the tree alone"][0]):
        del starts["the tree alone"]
    plain = {label: squared_errors(graph, *at) for label, at in starts.items()}
    solved: dict[str, dict[str, Solved]] = {label: {} for label in starts}
    for label, lineariser in progress(list(product(starts, linearisers)), name):
        solved[label][lineariser] = solve(
            ready, starts[label], LINEARISERS[lineariser], given.iterations
        )
    _table(record, given, made, plain, solved)
    best = min(
        (each for of in solved.values() for each in of.values()), key=lambda s: s.errors.sum()
    )
    at_first = "as the file has them" if given.truth is None else "by the odometry"
    alone = "by the tree of edges alone, " if "the tree alone" in starts else ""
    record.figure(
        figures.paths(made, starts, best.poses, best.landmarks, best.covs[:, :2, :2]),
        f"{name}_poses",
        f"Poses of {name} [m]: {at_first}, {alone}and at the optimum, with every edge that is not "
        "of the tree, and 95 % ellipses of some poses.",
    )
    record.figure(
        figures.errors(made, given.begin, plain[given.begin], best.errors),
        f"{name}_errors",
        f"Edges of {name} by their error rᵀΩr, at {given.begin} and at the optimum: the share "
        "that is larger, both axes logarithmic; dotted, of right noise in a graph without closures "
        "to fit.",
    )
    return (
        best,
        {
            "before": {label: float(each.sum()) for label, each in plain.items()},
            "due": _degrees(made),
            "seconds": ready.seconds,
            "solved": {
                label: {
                    lineariser: {
                        "error": float(each.errors.sum()),
                        "iterations": each.status.iterations,
                        "converged": bool(each.status.converged.all()),
                        "seconds": each.seconds,
                    }
                    for lineariser, each in of.items()
                }
                for label, of in solved.items()
            },
        },
    )


def _against_truth(
    record: Record,
    given: Given,
    best: Solved,
    share: float,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """How far the optimum is from the truth, and what false closures make of it."""
    found = {"right closures": _judged(given, best, best)}
    if share > 0.0:
        wrong = with_false(given.graph, share, rng)
        many = len(wrong.edges) - len(given.graph.edges)
        led = {"least squares": misled(given, wrong)}
        led |= {name: misled(given, wrong, noise) for name, noise in ROBUST.items()}
        for name, solved in led.items():
            found[name] = _judged(given, solved, best, many)
        record.figure(
            figures.misled(given, wrong, led, USED),
            f"{given.name}_false",
            f"Poses of {given.name} [m] at the optimum of its own edges, and of these with {many} "
            "false closures, which join places that have nothing to do with each other (orange, "
            f"those of a weight above {USED}), by the noise that closures are said to have; the "
            "truth below.",
        )
        record.note(f"{many} false closures are added, and every noise is told the same.")
    record.table(
        f"{given.name}: against the truth",
        (
            "closures",
            "RMSE [m]",
            "NEES / degrees",
            "moved",
            "false used",
            "right left out",
            "iterations",
            "settled",
        ),
        [
            (
                label,
                each["rmse"],
                each["nees"],
                each["moved"],
                "" if each["false_used"] is None else f"{each['false_used']:.0%}",
                "" if each["right_left_out"] is None else f"{each['right_left_out']:.1%}",
                each["iterations"],
                each["settled"],
            )
            for label, each in found.items()
        ],
        about="RMSE of the poses' places, and NEES of the poses for each degree of freedom, of "
        "which 1 is right; poses of one graph hang together, so that it is 1 over many graphs. "
        "Moved: how far the farthest pose is from the optimum of the right closures, in its "
        f"deviations there. Closures are used whose weight is above {USED}. All begin at the "
        "odometry.",
        best={"RMSE [m]": -np.inf, "NEES / degrees": 1.0},
    )
    return {"against_truth": found}


def misled(given: Given, wrong: PoseGraph, noise: pgm.RobustNoise | None = None) -> Solved:
    """Solve a graph with false closures, from the poses of the graph without."""
    iterations = given.iterations * (1 if noise is None else MORE)
    start = given.graph.poses, given.graph.landmarks
    return solve(prepared(wrong, noise), start, iterations=iterations)


def _judged(given: Given, solved: Solved, right: Solved, many: int = 0) -> dict[str, Any]:
    """Errors of the poses, the first of which is held, and which closures were used.

    `many` false closures are the last of the edges.
    """
    assert given.truth is not None
    truth = given.truth[1:]
    beliefs, due = solved.beliefs[1:], right.beliefs[1:]
    right_ones = len(given.graph.edges)
    left_out = solved.weights <= USED
    false, true = left_out[right_ones : right_ones + many], left_out[:right_ones]
    return {
        "rmse": float(consistency.rmse(beliefs, truth, PLANE)),
        "nees": float(consistency.nees(beliefs, truth).mean() / 3.0),
        "error": float(solved.errors[:right_ones].sum()),
        "moved": float(np.abs(consistency.error(beliefs, due.mean) / due.std).max()),
        "false_used": float(1.0 - false.mean()) if many else None,
        "right_left_out": float(true.mean()) if many else None,
        "iterations": int(solved.status.iterations),
        "settled": "yes" if solved.status.converged.all() else "no",
    }


def _degrees(made: PoseGraphNetwork) -> int:
    """The components that are told less those that are free."""
    free = 3 * (len(made.poses) - len(made.held)) + 2 * len(made.landmarks)
    return 3 * len(made.graph.edges) + 2 * len(made.graph.sightings) - free


def _held(made: PoseGraphNetwork) -> str:
    names = [str(name) for name in made.graph.names[list(made.held)].tolist()]
    who = f"The pose {names[0]} is held" if len(names) == 1 else f"{len(names)} poses are held"
    why = "as the file says" if made.graph.fixed.size else "the first, since the file holds none"
    sightings = len(made.graph.sightings)
    return (
        f"{who}, {why}. {len(made.graph.edges)} edges measure one pose from another"
        f"{f', and {sightings} are sightings of landmarks' if sightings else ''}."
    )


def _table(
    record: Record,
    given: Given,
    made: PoseGraphNetwork,
    plain: dict[str, Array],
    solved: dict[str, dict[str, Solved]],
) -> None:
    rows: list[tuple[Any, ...]] = [
        (label, "", f"{each.sum():.8g}", float(each.max()), "", "", "", "")
        for label, each in plain.items()
    ]
    rows += [
        (
            f"solved from {label}",
            lineariser,
            f"{each.errors.sum():.8g}",
            float(each.errors.max()),
            each.status.iterations,
            "yes" if each.status.converged.all() else "no",
            "" if each.status.digits is None else float(np.min(each.status.digits)),
            each.seconds,
        )
        for label, of in solved.items()
        for lineariser, each in of.items()
    ]
    known = f" The published optimum is {given.optimum}." if given.optimum else ""
    record.table(
        f"{given.name}: the error of the poses",
        ("poses", "lineariser", "χ²", "largest", "iterations", "converged", "digits", "seconds"),
        rows,
        about=f"χ² = Σ rᵀΩr over all edges, as g2o has it, of right noise {_degrees(made)} at the "
        "optimum, the components that are told less those that are free; the largest is that of "
        f"one edge.{known} Digits, where they had to be counted, are those of a mean that rounding "
        "leaves; seconds, as measured here, those of inference with all covariances. Taylor's "
        "optimum is the least error; sigma points expect it over their beliefs.",
        best={"χ²": -np.inf},
    )
