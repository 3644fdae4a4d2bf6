"""The Killian Court recording: poses, the laser scans taken there, and how poses go together.

A robot's drive of some two kilometres through the Infinite Corridor and around it, at MIT (Bosse,
Newman, Leonard, Soika, Feiten & Teller, An Atlas framework for scalable mapping, 2003), as a pose
graph in the g2o format. The poses are not the true ones: the drive was not surveyed. The package
rtb-data carries the file, zipped.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from experiments import packaged
from pgm.errors import FileError
from pgm.recordings import Edges, read_pose_graph

Array = npt.NDArray[np.float64]

MISSING = packaged.RTB_MISSING.format("the Killian Court recording")


@dataclass(frozen=True, eq=False)
class Log:
    """A recording; each pose has its scan.

    Attributes
    ----------
    poses : ndarray
        (N, 3): east [m], north [m], heading [rad, in −π..π], of the robot and of its laser.
    scans : ndarray
        (N, rays): ranges [m]; one at the largest, `most`, has seen nothing.
    angles : ndarray
        (rays,): of the rays from straight ahead, to the left [rad].
    most : float
        The largest range [m].
    edges : Edges
    """

    poses: Array
    scans: Array
    angles: Array
    most: float
    edges: Edges


def find() -> Path | None:
    """The zipped recording inside the package rtb-data; None where that is not installed."""
    return packaged.find(packaged.RTB, "data/killian.g2o.zip")


def load(path: Path | None = None) -> Log:
    """Read a recording.

    Parameters
    ----------
    path : Path, optional
        A .g2o file, or a .zip of one; that of rtb-data, if not given.

    Raises
    ------
    FileError
        If there is none, it cannot be read, or a line is not what it should be; it has file and
        line.
    """
    path = path or find()
    if path is None:
        raise FileError(MISSING)
    graph = read_pose_graph(path)
    scans = graph.scans
    if scans is None:
        raise FileError(f"{path}: no scans; is it the Killian Court recording?", path=str(path))
    return Log(graph.poses, scans.ranges, scans.angles, scans.most, graph.edges)
