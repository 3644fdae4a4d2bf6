"""The Killian Court recording: poses, the laser scans taken there, and how poses go together.

A robot's drive of some two kilometres through the Infinite Corridor and around it, at MIT (Bosse,
Newman, Leonard, Soika, Feiten & Teller, An Atlas framework for scalable mapping, 2003), as a pose
graph in the g2o format. The poses are not the true ones: the drive was not surveyed. The package
rtb-data carries the file, zipped.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from experiments import packaged
from pgm.errors import FileError

Array = npt.NDArray[np.float64]

MISSING = packaged.RTB_MISSING.format("the Killian Court recording")
# Words of a line, the first of which is its kind.
_VERTEX = "VERTEX_SE2 id east north heading"
_EDGE = "EDGE_SE2 from to ahead left turn i11 i12 i13 i22 i23 i33"
_LASER = "ROBOTLASER1 type start field step max accuracy remission count"
# Behind the ranges: how many remissions, the laser's and the robot's pose, two speeds, three
# distances of a safety zone, and times and host.
_BEHIND = 15


@dataclass(frozen=True, eq=False)
class Edges:
    """Motions from pose to pose: odometry, and places met again.

    Attributes
    ----------
    first, second : ndarray of int
        (E,): numbers of the poses.
    motions : ndarray
        (E, 3): the second pose seen from the first, ahead [m], to the left [m], turned [rad].
    information : ndarray
        (E, 3, 3): inverse covariances of the motions.
    """

    first: npt.NDArray[np.int_]
    second: npt.NDArray[np.int_]
    motions: Array
    information: Array


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
    poses: list[list[float]] = []
    scans: list[list[float]] = []
    edges: list[list[float]] = []
    setting: list[float] = []
    for line, words in _lines(path):
        if words[0] == "VERTEX_SE2":
            if len(scans) < len(poses):
                raise _refused(path, line, f"a pose where the scan of {len(poses) - 1} was due")
            number, *pose = _numbers(path, line, words, _VERTEX)
            if number != len(poses):
                raise _refused(path, line, f"the pose {words[1]}; {len(poses)} was due")
            poses.append(pose)
        elif words[0] == "ROBOTLASER1":
            if len(scans) == len(poses):
                raise _refused(path, line, "a scan before its pose")
            found, ranges = _scan(path, line, words)
            if setting and found != setting:
                raise _refused(path, line, f"{found} for {_LASER}; {setting}, as before, was due")
            setting = found
            scans.append(ranges)
        elif words[0] == "EDGE_SE2":
            edges.append(_edge(path, line, words, len(poses)))
        else:
            raise _refused(path, line, f"{words[0]!r}; VERTEX_SE2, ROBOTLASER1 or EDGE_SE2 was due")
    if not scans:
        raise FileError(f"{path}: no scans; is it the Killian Court recording?", path=str(path))
    if len(scans) < len(poses):
        raise FileError(f"{path}: ends before the scan of {len(poses) - 1}", path=str(path))
    _, start, _, step, most, *_ = setting
    table: Array = np.array(scans)
    angles = start + step * np.arange(table.shape[1], dtype=np.float64)
    return Log(np.array(poses), np.minimum(table, most), angles, most, _as_edges(edges))


def _scan(path: Path, line: int, words: Sequence[str]) -> tuple[list[float], list[float]]:
    """The settings of a scan, and its ranges."""
    front = len(_LASER.split())
    head = _numbers(path, line, words[:front], _LASER)
    step, most, count = head[3], head[4], head[-1]
    if count < 1 or count != int(count) or step <= 0.0 or most <= 0.0:
        raise _refused(path, line, f"{head}; positive steps, ranges and counts were due")
    due = front + int(count) + _BEHIND
    if len(words) != due:
        raise _refused(path, line, f"{len(words)} words; {due}, of {int(count)} ranges, were due")
    ranges = _finite(path, line, words[front : front + int(count)], f"{int(count)} ranges")
    if min(ranges) < 0.0:
        raise _refused(path, line, f"a range of {min(ranges):g} m; 0 or more was due")
    return head, ranges


def _edge(path: Path, line: int, words: Sequence[str], poses: int) -> list[float]:
    """The numbers of an edge between poses that are known."""
    edge = _numbers(path, line, words, _EDGE)
    for number in edge[:2]:
        if number not in range(poses):
            raise _refused(path, line, f"an edge to {number:g} where there are {poses} poses")
    return edge


def _as_edges(edges: list[list[float]]) -> Edges:
    table = np.array(edges).reshape(-1, 11)
    first, second = table[:, :2].astype(int).T
    information = np.empty((len(table), 3, 3))
    rows, columns = np.triu_indices(3)
    information[:, rows, columns] = information[:, columns, rows] = table[:, 5:]
    return Edges(first, second, table[:, 2:5], information)


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """The words of each line that has any and is no comment, with its number from 1."""
    for number, line in enumerate(_text(path).splitlines(), start=1):
        if (words := line.split()) and not words[0].startswith("#"):
            yield number, words


def _text(path: Path) -> str:
    """The text of a file, or of the one .g2o file in a .zip."""
    try:
        if path.suffix != ".zip":
            return path.read_text(encoding="utf-8")
        with zipfile.ZipFile(path) as archive:
            # Of each file some machines put a shadow beside it, in a folder of this name.
            names = [name for name in archive.namelist() if not name.startswith("__MACOSX")]
            (name,) = (name for name in names if name.endswith(".g2o"))
            return archive.read(name).decode("utf-8")
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise FileError(
            f"{path} cannot be read as one .g2o file ({type(error).__name__}: {error}); fetch it "
            "again",
            path=str(path),
        ) from error


def _numbers(path: Path, line: int, words: Sequence[str], due: str) -> list[float]:
    """The numbers of a line behind its kind, as many as are due."""
    if len(words) != len(due.split()):
        raise _refused(path, line, f"{len(words)} words; `{due}` was due")
    return _finite(path, line, words[1:], f"`{due}`")


def _finite(path: Path, line: int, words: Sequence[str], due: str) -> list[float]:
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = [np.nan]
    if not np.isfinite(found).all():
        shown = " ".join(words[:12]) + (" ..." if len(words) > 12 else "")
        raise _refused(path, line, f"{shown!r}; {due}, in finite numbers, was due")
    return found


def _refused(path: Path, line: int, found: str) -> FileError:
    return FileError(f"{path}, line {line}: found {found}", path=str(path), line=line)
