"""Pose graphs in the formats of g2o and TORO, plain or zipped."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from pgm.arguments import public
from pgm.errors import FileError
from pgm.factors.arrays import covariance_fault
from pgm.io.dropped import Dropped
from pgm.io.sources import Content, Line, Source, lines
from pgm.kernels import quaternions
from pgm.kernels.arrays import Array, Integers
from pgm.recordings.drives import placing
from pgm.recordings.drives.pose_graph import Edges, PoseGraph
from pgm.recordings.drives.scans import Scans
from pgm.recordings.readers import files

_VERTEX = "{0} id east north heading"
_EDGE = "{0} from to forward left turn i11 i12 i13 i22 i23 i33"
_TORO = "{0} from to forward left turn i11 i12 i22 i33 i13 i23"
_ISAM = "{0} from to forward left turn r11 r12 r13 r22 r23 r33"
_POINT = "VERTEX_XY id east north"
_SIGHTING = "EDGE_SE2_XY from to forward left i11 i12 i22"
_SPATIAL = "VERTEX_SE3:QUAT id x y z qx qy qz qw"
_LASER = "ROBOTLASER1 type start field step most accuracy remission count"
# Behind the ranges: the laser's and the robot's pose, two speeds, three distances of a safety zone,
# and times and host, and how many remissions.
_BEHIND = 15
# Places of the upper triangle, rows and columns, in which the numbers of an edge stand.
_UPPER = (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)
# Which of the six numbers stands in each place of the symmetric matrix, row by row.
_PLACES = 0, 1, 2, 1, 3, 4, 2, 4, 5
_TORO_PLACES = 0, 1, 4, 1, 2, 5, 4, 5, 3
# Of an edge in space, the components in the plane: x, y, and the quaternion's z.
_PLANE = (0, 1, 5)
PLACED = "not in the file, composed along a spanning tree of its edges"
SIGHTED = "not in the file, placed by their first sightings"
# A measurement between vertices: its line, their numbers, the motion and its information.
_Measured = tuple[Line, int, int, list[float], Array]


@dataclass
class _Found:
    """The lines of a file so far."""

    planar: bool
    isam: bool
    poses: dict[int, list[float]] = field(default_factory=dict)
    points: dict[int, list[float]] = field(default_factory=dict)
    edges: list[_Measured] = field(default_factory=list)
    seen: list[_Measured] = field(default_factory=list)
    fixed: list[tuple[Line, int]] = field(default_factory=list)
    scans: dict[int, list[float]] = field(default_factory=dict)
    laser: list[float] = field(default_factory=list)
    last: int | None = None
    tilted: list[int] = field(default_factory=list)


@public
def read_pose_graph(
    path: Source, *, planar: bool = False, isam: bool = False, skip: Sequence[str] = ()
) -> PoseGraph:
    r"""Read a pose graph of g2o or TORO.

    Lines are ``VERTEX_SE2``, ``EDGE_SE2``, ``VERTEX_XY``, ``EDGE_SE2_XY``, ``FIX`` and, after
    each pose, ``ROBOTLASER1`` of g2o; ``VERTEX2`` and ``EDGE2`` of TORO. Parameters of g2o are
    skipped. Where a file has edges alone, poses are composed along a spanning tree of these, from
    the first pose, or the one that is fixed, at (0, 0, 0); so are landmarks without a vertex
    placed where they were first seen. `dropped` tells of all of this.

    Parameters
    ----------
    path : str, Path or open file
        Plain, gzipped, or a ``.zip`` of one such file.
    planar : bool, optional
        Whether ``VERTEX_SE3:QUAT`` and ``EDGE_SE3:QUAT`` are read as seen from above, without
        heights and tilts; the information is of x, y and the turn given all others.
    isam : bool, optional
        Whether ``EDGE2`` is iSAM's: its numbers are the upper triangle of a root R, row by row,
        of the information RᵀR. TORO's order is another.
    skip : sequence of str, optional
        First words of lines that are left out, such as ``("EQUIV", "BR")`` of TORO; `dropped`
        tells of them.

    Raises
    ------
    FileError
        If the file cannot be read, a line is none of these, an edge leads to no vertex, its
        information is no inverse of a covariance, or poses in space are met without `planar`; it
        has file and line.
    EvidenceError
        If `skip` has no words.

    References
    ----------
    R. Kümmerle, G. Grisetti, H. Strasdat, K. Konolige, W. Burgard: g2o, 2011.

    Examples
    --------
    >>> import io
    >>> from pgm.recordings import read_pose_graph
    >>> text = "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1 0 0 4 1 5 9 2 3\n"
    >>> read_pose_graph(io.StringIO(text)).edges.information[0]
    array([[4., 1., 2.],
           [1., 5., 3.],
           [2., 3., 9.]])
    """
    left = files.Skipped(skip)
    held = _content(path)
    found = _Found(planar, isam)
    for line in left.others(lines(held)):
        read = _KINDS.get(line.words[0])
        if read is not None:
            read(found, line)
        elif line.words[0].startswith("PARAMS_"):
            left.leave(line, "parameters")
        else:
            raise left.stranger(line, _KINDS)
    if not found.poses and not found.edges:
        raise held.origin.fault("no poses and no edges; is it a pose graph of g2o or TORO?")
    for measured in (found.edges, found.seen):
        _require_information(measured)
    return _graph(found, held, left.told("graph"))


def _graph(found: _Found, held: Content, told: list[Dropped]) -> PoseGraph:
    ends = {end for _, one, other, *_ in found.edges for end in (one, other)}
    poses = _rows(found.poses or ends | {one for _, one, *_ in found.seen})
    points = _rows(found.points or {other for _, _, other, *_ in found.seen})
    edges = _edges(found.edges, poses, poses, 3)
    sightings = _edges(found.seen, poses, points, 2)
    fixed = np.array([_row(line, number, poses) for line, number in found.fixed], dtype=int)
    if found.poses:
        places = np.array([found.poses[number] for number in poses])
    else:
        places = _placed(found, poses, edges, fixed)
        told.append(Dropped("poses", PLACED, np.arange(len(places)), kept=True))
    if found.points or not found.seen:
        marks = np.array([found.points[number] for number in points]).reshape(-1, 2)
    else:
        marks = placing.landmarks(places, sightings, len(points))
        told.append(Dropped("landmarks", SIGHTED, np.arange(len(marks)), kept=True))
    if found.tilted:
        told.append(Dropped("graph", "heights and tilts, lines from 1", np.array(found.tilted)))
    scans = None
    if found.scans:
        lost = [number for number in poses if number not in found.scans]
        if lost:
            raise held.origin.fault(f"the pose {lost[0]} has no scan, where others have")
        with files.told_of(held.origin):
            start, step, most = found.laser[1], found.laser[3], found.laser[4]
            table = np.array([found.scans[number] for number in poses])
            angles = start + step * np.arange(table.shape[1], dtype=np.float64)
            scans = Scans(np.arange(float(len(table))), table, angles, most)
    return PoseGraph(
        names=np.array(list(poses)),
        poses=places,
        edges=edges,
        landmark_names=np.array(list(points), dtype=int),
        landmarks=marks,
        sightings=sightings,
        fixed=fixed,
        scans=scans,
        dropped=tuple(told),
    )


def _placed(found: _Found, rows: dict[int, int], edges: Edges, fixed: Integers) -> Array:
    """Poses of a file that has edges alone; refuses those that edges do not lead to."""
    if np.unique(fixed).size > 1:
        line, number = next(each for each in found.fixed if rows[each[1]] != fixed[0])
        raise line.fault(
            f"a second vertex that is fixed, {number}, where no VERTEX_SE2 says at which pose; "
            "add these lines, or fix one"
        )
    root = int(fixed[0]) if fixed.size else 0
    places, reached = placing.poses(edges, len(rows), root)
    if not reached.all():
        names = list(rows)
        lost = names[int((~reached).argmax())]
        line = next(each[0] for each in (*found.edges, *found.seen) if lost in each[1:3])
        raise line.fault(
            f"the vertex {lost}, to which no edges lead from {names[root]}, and no VERTEX_SE2 says "
            "where poses are; add these lines, or read the parts one by one"
        )
    return places


def _require_information(measured: Sequence[_Measured]) -> None:
    """Refuse information matrices that are indefinite; singular ones are allowed."""
    if not measured or covariance_fault(np.array([each for *_, each in measured])) is None:
        return
    for line, *_, information in measured:
        if fault := covariance_fault(information):
            hint = ""
            if line.words[0] == "EDGE2":
                hint = (
                    "; TORO's order is i11 i12 i22 i33 i13 i23, and isam=True reads iSAM's, the "
                    "root r11 r12 r13 r22 r23 r33. Where lines have the information itself in the "
                    "latter order, call them EDGE_SE2"
                )
            raise line.fault(f"information that {fault}{hint}")


def _rows(numbers: Collection[int]) -> dict[int, int]:
    """The row of each vertex by its number, in increasing order."""
    return {number: row for row, number in enumerate(sorted(numbers))}


def _edges(
    rows: Sequence[_Measured],
    first: dict[int, int],
    second: dict[int, int],
    size: int,
) -> Edges:
    ends = [(_row(line, one, first), _row(line, two, second)) for line, one, two, _, _ in rows]
    pairs: Integers = np.array(ends, dtype=int).reshape(-1, 2)
    motions = np.array([motion for _, _, _, motion, _ in rows]).reshape(-1, size)
    information = np.array([each for *_, each in rows]).reshape(-1, size, size)
    return Edges(pairs[:, 0], pairs[:, 1], motions, information)


def _row(line: Line, number: int, rows: dict[int, int]) -> int:
    if number not in rows:
        raise line.fault(
            f"the vertex {number}, which the file does not have; add its line, or leave this one "
            "out"
        )
    return rows[number]


def _vertex(found: _Found, line: Line) -> None:
    pose = line.numbers(_VERTEX.format(line.words[0]), 1)[1:]
    _add(found.poses, line, pose)
    found.last = int(float(line.words[1]))


def _spatial(found: _Found, line: Line) -> None:
    _require_planar(found, line)
    x, y, _, *turn = line.numbers(_SPATIAL, 1)[1:]
    _add(found.poses, line, [x, y, _yaw(line, turn)])
    found.last = int(float(line.words[1]))


def _point(found: _Found, line: Line) -> None:
    _add(found.points, line, line.numbers(_POINT, 1)[1:])


def _add(to: dict[int, list[float]], line: Line, numbers: list[float]) -> None:
    number = line.whole(line.words[1], "a vertex")
    if number in to:
        raise line.fault(
            f"the vertex {number} for the second time; leave one of its lines out, or give this "
            "vertex, and its edges, a number of their own"
        )
    to[number] = numbers


def _edge(found: _Found, line: Line) -> None:
    toro = line.words[0] == "EDGE2"
    root = toro and found.isam
    due = _ISAM if root else _TORO if toro else _EDGE
    numbers = line.numbers(due.format(line.words[0]), 1)
    if root:
        upper = np.zeros((3, 3))
        upper[_UPPER] = numbers[5:]
        information = upper.T @ upper
    else:
        each = _TORO_PLACES if toro else _PLACES
        information = np.array([numbers[5 + k] for k in each]).reshape(3, 3)
    found.edges.append((line, *_ends(line), numbers[2:5], information))


def _spatial_edge(found: _Found, line: Line) -> None:
    _require_planar(found, line)
    due = "EDGE_SE3:QUAT from to x y z qx qy qz qw" + " i" * 21
    numbers = line.numbers(due, 1)
    whole = np.empty((6, 6))
    rows, columns = np.triu_indices(6)
    whole[rows, columns] = whole[columns, rows] = numbers[9:]
    scale = np.array([1.0, 1.0, 0.5])
    information = whole[np.ix_(_PLANE, _PLANE)] * scale * scale[:, None]
    motion = [*numbers[2:4], _yaw(line, numbers[5:9])]
    found.edges.append((line, *_ends(line), motion, information))


def _sighting(found: _Found, line: Line) -> None:
    numbers = line.numbers(_SIGHTING, 1)
    a, b, c = numbers[4:]
    found.seen.append((line, *_ends(line), numbers[2:4], np.array([[a, b], [b, c]])))


def _fix(found: _Found, line: Line) -> None:
    for word in line.words[1:]:
        found.fixed.append((line, line.whole(word, "a vertex")))


def _scan(found: _Found, line: Line) -> None:
    if found.last is None or found.last in found.scans:
        raise line.fault("a scan before its pose; move it behind the line of the pose")
    front = len(_LASER.split())
    if len(line.words) < front:
        raise line.fault(f"{len(line.words)} words; `{_LASER}` was due")
    head = line.finite(line.words[1:front], f"`{_LASER}`")
    step, most, many = head[3], head[4], head[-1]
    if many < 1 or many != int(many) or step <= 0.0 or most <= 0.0:
        raise line.fault(f"{head}; positive steps, ranges and counts were due")
    if found.laser and head != found.laser:
        raise line.fault(f"{head} for {_LASER}; {found.laser}, as before, was due")
    due = front + int(many) + _BEHIND
    if len(line.words) != due:
        raise line.fault(f"{len(line.words)} words; {due}, of {int(many)} ranges, were due")
    ranges = line.finite(line.words[front : front + int(many)], f"{int(many)} ranges")
    if min(ranges) < 0.0:
        raise line.fault(f"a range of {min(ranges):g} m; 0 or more was due")
    found.laser = head
    found.scans[found.last] = ranges


def _ends(line: Line) -> tuple[int, int]:
    return line.whole(line.words[1], "a vertex"), line.whole(line.words[2], "a vertex")


def _require_planar(found: _Found, line: Line) -> None:
    if not found.planar:
        raise line.fault(
            f"{line.words[0]}, which is in space; planar=True reads it as seen from above"
        )
    found.tilted.append(line.number)


def _yaw(line: Line, turn: Sequence[float]) -> float:
    """The yaw [rad], in [−π, π), of a rotation that a line gives as a quaternion qx qy qz qw.

    The quaternion is scaled to length one; one of length zero is refused.
    """
    unit = np.array(turn) / max(float(np.linalg.norm(turn)), 1e-300)
    if not np.isclose(np.linalg.norm(unit), 1.0):
        raise line.fault(f"{list(turn)}; a quaternion qx qy qz qw was due")
    return float(quaternions.angles(unit)[2])


_KINDS: dict[str, Callable[[_Found, Line], None]] = {
    "VERTEX_SE2": _vertex,
    "VERTEX2": _vertex,
    "EDGE_SE2": _edge,
    "EDGE2": _edge,
    "VERTEX_XY": _point,
    "EDGE_SE2_XY": _sighting,
    "FIX": _fix,
    "ROBOTLASER1": _scan,
    "VERTEX_SE3:QUAT": _spatial,
    "EDGE_SE3:QUAT": _spatial_edge,
}


def _content(path: Source) -> Content:
    """The text of a file, or of the one file in a .zip."""
    held = files.content(path)
    if isinstance(held.data, str) or not held.data.startswith(b"PK\x03\x04"):
        return held
    try:
        with zipfile.ZipFile(io.BytesIO(held.data)) as archive:
            # Of each file some machines put a shadow beside it, in a folder of this name.
            names = [name for name in archive.namelist() if not name.startswith("__MACOSX")]
            (name,) = (name for name in names if not name.endswith("/"))
            if archive.getinfo(name).file_size > files.LIMIT:
                raise held.origin.fault(f"it holds more than {files.LIMIT} bytes")
            return Content(archive.read(name), held.origin)
    except FileError:
        raise
    except Exception as error:  # of many kinds, as the damage is
        raise held.origin.fault(
            f"it cannot be read as a .zip of one file ({type(error).__name__}: {error}); fetch it "
            "again"
        ) from error
