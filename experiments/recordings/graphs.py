"""A pose graph: its error at the file's poses, by its tree alone, and at the optimum.

The network is static, poses of the whole drive in one tree of clusters (`models.pose_graphs`); it
is solved by linearising again at the beliefs, Gauss–Newton where that is Taylor's.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.record import Record, progress
from experiments.recordings import graph_figures
from experiments.recordings.methods import LINEARISERS
from experiments.recordings.setting_file import located, plain_name
from experiments.recordings.toml_table import TomlTable
from models.pose_graphs import PoseGraphNetwork, pose_graph_network, squared_errors
from pgm.recordings import read_pose_graph

Array = npt.NDArray[np.float64]

READER = "pose_graph"
ITERATIONS = 50
TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Solved:
    """Poses from one start by one lineariser.

    Attributes
    ----------
    poses, landmarks : ndarray
        (N, 3), (L, 2).
    covs : ndarray
        (N, 2, 2): of the poses' places.
    errors : ndarray
        Of each edge, then of each sighting.
    status : Status
    seconds : float
    """

    poses: Array
    landmarks: Array
    covs: Array
    errors: Array
    status: Any
    seconds: float


def run(
    out: Path | None,
    seed: int,
    path: Path | None,
    settings: Path | None,
    linearisers: list[str],
) -> None:
    """Solve a pose graph from the file's poses and from those of its tree."""
    planar = isam = False
    skip: list[str] = []
    iterations, about = ITERATIONS, ""
    if settings is not None:
        top = TomlTable.read(settings)
        path = located(top, path)
        about = top.text("about", "a sentence", "")
        name = top.text("name", "a name for tables and figures", plain_name(path.stem))
        reader, methods = top.table("reader"), top.table("methods")
        planar, isam = reader.flag("planar", False), reader.flag("isam", False)
        skip = reader.take("skip", "first words of lines", _are_words, [])
        iterations = methods.whole("iterations", ITERATIONS)
        for table in (reader, methods, top):
            table.done()
    elif path is None:
        raise pgm.EvidenceError("recordings pose_graph needs --path: a file of g2o or TORO")
    else:
        name = plain_name(path.name.split(".")[0])
    graph = read_pose_graph(path, planar=planar, isam=isam, skip=skip)
    made = pose_graph_network(graph)
    compiled = pgm.compile(made.network)
    record = Record(
        "recordings",
        out,
        seed=seed,
        data=[name],
        reader=READER,
        linearisers=linearisers,
        iterations=iterations,
        planar=planar,
    )
    record.note(repr(graph))
    if about:
        record.note(about)
    record.note(_held(made))
    record.note(compiled._title)
    if graph.scans is not None:
        record.note("Scans are not taken; the experiment killian finds the robot by them.")
    starts = {"the file's poses": (graph.poses, graph.landmarks), "the tree alone": made.reckoned()}
    plain = {label: squared_errors(graph, *at) for label, at in starts.items()}
    solved: dict[str, dict[str, Solved]] = {label: {} for label in starts}
    for label, lineariser in progress(list(product(starts, linearisers)), name):
        solved[label][lineariser] = solve(
            made, compiled, starts[label], LINEARISERS[lineariser], iterations
        )
    _tables(record, name, made, plain, solved)
    best = min(
        (each for of in solved.values() for each in of.values()), key=lambda s: s.errors.sum()
    )
    record.figure(
        graph_figures.paths(made, starts, best.poses, best.landmarks, best.covs),
        f"{name}_poses",
        f"Poses of {name} [m]: by the tree of edges alone, as the file has them, and at the "
        "optimum, with every edge that is not of the tree, and 95 % ellipses of some poses.",
    )
    record.figure(
        graph_figures.errors(made, plain["the file's poses"], best.errors),
        f"{name}_errors",
        f"Edges of {name} by their error rᵀΩr, at the file's poses and at the optimum: the share "
        "that is larger, both axes logarithmic; dotted, of right noise in a graph without closures "
        "to fit.",
    )
    record.summary(
        results={
            name: {
                "before": {label: float(each.sum()) for label, each in plain.items()},
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
            }
        }
    )


def solve(
    made: PoseGraphNetwork,
    compiled: pgm.ClusterGraph,
    start: tuple[Array, Array],
    lineariser: pgm.Lineariser,
    iterations: int = ITERATIONS,
) -> Solved:
    """Linearise at a start, and then at the beliefs until they stay."""
    begun = perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pgm.PrecisionWarning)  # the table has the digits
        posterior = pgm.infer(
            compiled,
            made.evidence,
            schedule=pgm.Calibration(iterations=iterations, tolerance=TOLERANCE),
            start=made.start(*start),
            lineariser=lineariser,
        )
    poses, landmarks = made.means(posterior)
    covs = made.covs(posterior)[0][:, :2, :2]
    errors = squared_errors(made.graph, poses, landmarks)
    return Solved(poses, landmarks, covs, errors, posterior.status, perf_counter() - begun)


def _are_words(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(word, str) and word for word in value)


def _held(made: PoseGraphNetwork) -> str:
    names = [str(name) for name in made.graph.names[list(made.held)].tolist()]
    who = f"The pose {names[0]} is held" if len(names) == 1 else f"{len(names)} poses are held"
    why = "as the file says" if made.graph.fixed.size else "the first, since the file holds none"
    sightings = len(made.graph.sightings)
    return (
        f"{who}, {why}. {len(made.graph.edges)} edges measure one pose from another"
        f"{f', and {sightings} are sightings of landmarks' if sightings else ''}."
    )


def _tables(
    record: Record,
    name: str,
    made: PoseGraphNetwork,
    plain: dict[str, Array],
    solved: dict[str, dict[str, Solved]],
) -> None:
    rows: list[tuple[Any, ...]] = [
        (label, "", float(each.sum()), float(each.max()), "", "", "", "")
        for label, each in plain.items()
    ]
    rows += [
        (
            f"solved from {label}",
            lineariser,
            float(each.errors.sum()),
            float(each.errors.max()),
            each.status.iterations,
            "yes" if each.status.converged.all() else "no",
            "" if each.status.digits is None else float(np.min(each.status.digits)),
            each.seconds,
        )
        for label, of in solved.items()
        for lineariser, each in of.items()
    ]
    free = 3 * (len(made.poses) - len(made.held)) + 2 * len(made.landmarks)
    told = 3 * len(made.graph.edges) + 2 * len(made.graph.sightings)
    record.table(
        f"{name}: the error of the poses",
        ("poses", "lineariser", "χ²", "largest", "iterations", "converged", "digits", "seconds"),
        rows,
        about=f"χ² = Σ rᵀΩr over all edges, as g2o has it, of right noise {told - free} at the "
        "optimum, the components that are told less those that are free; the largest is that of "
        "one edge. Digits, where they had to be counted, are those of a mean that rounding leaves. "
        "Taylor's optimum is the least error; sigma points expect it over their beliefs.",
        best={"χ²": -np.inf},
    )
