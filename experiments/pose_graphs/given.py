"""Pose graphs to solve: published ones, a drawn one, and a file of the user's."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.pose_graphs.drawn import manhattan
from experiments.recordings.setting_file import located, plain_name
from experiments.recordings.settings import BESIDE, VARIABLE
from experiments.recordings.toml_table import TomlTable
from pgm.recordings import PoseGraph, read_pose_graph

Array = npt.NDArray[np.float64]

DRAWN = "drawn"
# The files of the published graphs, in the folder posegraphs of recorded data.
PUBLISHED = {"CSAIL": "CSAIL.g2o", "intel": "intel.g2o", "m3500": "m3500.g2o"}
ABOUT = {
    DRAWN: "A robot in the streets of a town, which recognises places; the truth is known.",
    "CSAIL": "MIT's CSAIL building, edges alone, as published with SE-Sync.",
    "intel": "The Intel research laboratory in Seattle.",
    "m3500": "Olson's Manhattan world of 3,500 poses.",
}
# The least χ² of g2o's residual that other solvers found.
OPTIMA = {"m3500": 3549.0368}
ITERATIONS = 50


@dataclass(frozen=True, eq=False)
class Given:
    """A pose graph, and what is known of it.

    Attributes
    ----------
    name : str
        In tables and names of figures.
    graph : PoseGraph
    about : str
    truth : ndarray or None
        The true poses, (N, 3).
    optimum : float or None
        The published one.
    iterations : int
        Linearisations at the most.
    """

    name: str
    graph: PoseGraph
    about: str = ""
    truth: Array | None = None
    optimum: float | None = None
    iterations: int = ITERATIONS

    @property
    def begin(self) -> str:
        """A name of the graph's own poses."""
        return "the file's poses" if self.truth is None else "the odometry"


def drawn(poses: int, rng: np.random.Generator) -> Given:
    """The graph of a drawn town."""
    graph, truth = manhattan(poses, rng)
    return Given(DRAWN, graph, ABOUT[DRAWN], truth)


def published(name: str, path: Path) -> Given:
    """A published graph, from its file."""
    return Given(name, read_pose_graph(path), ABOUT[name], optimum=OPTIMA.get(name))


def find(name: str) -> Path | None:
    """The file of a published graph; None where it is not here.

    It is looked for in ``posegraphs`` below the folder that the environment variable ``PGM_DATA``
    names, or else below ``../shared/data`` of the checkout.
    """
    path = Path(os.environ.get(VARIABLE) or BESIDE) / "posegraphs" / PUBLISHED[name]
    return path if path.is_file() else None


def own(path: Path | None, settings: Path | None) -> Given:
    """A graph of the user's, by its file or by settings in TOML that name it.

    Raises
    ------
    FileError
        If a setting is unknown, or the file cannot be read.
    """
    iterations, about = ITERATIONS, ""
    options: dict[str, Any] = {}
    if settings is not None:
        top = TomlTable.read(settings)
        path = located(top, path)
        about = top.text("about", "a sentence", "")
        name = top.text("name", "a name for tables and figures", plain_name(path.stem))
        reader, methods = top.table("reader"), top.table("methods")
        options = {
            "planar": reader.flag("planar", False),
            "isam": reader.flag("isam", False),
            "skip": reader.take("skip", "first words of lines", _are_words, []),
        }
        iterations = methods.whole("iterations", ITERATIONS)
        for table in (reader, methods, top):
            table.done()
    else:
        assert path is not None
        name = plain_name(path.name.split(".")[0])
    return Given(name, read_pose_graph(path, **options), about, iterations=iterations)


def _are_words(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(word, str) and word for word in value)
