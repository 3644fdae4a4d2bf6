"""Trajectories to and from files in the format of the TUM RGB-D benchmark.

A line is a pose, eight numbers apart by single spaces: ``t x y z qx qy qz qw``, seconds, metres and
a unit quaternion; a line that begins with ``#`` is a comment.
"""

import csv
import io
import math
from collections.abc import Sequence
from itertools import combinations_with_replacement
from types import EllipsisType
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.errors import ModelError
from pgm.factors.arrays import covariance_fault
from pgm.io import sources
from pgm.io.poses import Poses, made
from pgm.io.sources import LIMIT, Line, Origin, Source, number
from pgm.io.sources import lines as text_lines
from pgm.kernels.arrays import Array

JOINED = "*"


def write_covariances(target: Source, times: Array, names: Sequence[str], cov: Array) -> None:
    """Write covariances (n, k, k) of components by name, with all their digits."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(_header(names))
    upper = cov[:, *np.triu_indices(len(names))]
    table.writerows(np.column_stack([times, upper]).tolist())
    sources.write(target, text.getvalue())


def read_covariances(source: Source, times: Array, limit: int) -> tuple[tuple[str, ...], Array]:
    """The names of the components, and their covariances (n, k, k) at the times of the poses."""
    content = sources.read(source, limit)
    origin = content.origin
    reader = csv.reader(io.StringIO(content.text(), newline=""))
    try:
        header = next(reader, [])
        names = _names(header, origin)
        lines, rows = [], []
        for row in filter(None, reader):
            if len(row) != len(header):
                raise origin.fault(
                    f"it has {len(row)} numbers, where the first line names {len(header)} columns",
                    reader.line_num,
                )
            rows.append([number(word, reader.line_num, origin) for word in row])
            lines.append(reader.line_num)
    except csv.Error as error:
        raise origin.fault(f"it is no table of values: {error}", reader.line_num) from None
    table = np.array(rows).reshape(len(rows), len(header))
    _require_times(table[:, 0], times, lines, origin)
    cov = np.empty((len(rows), len(names), len(names)))
    i, j = np.triu_indices(len(names))
    cov[:, i, j] = cov[:, j, i] = table[:, 1:]
    if covariance_fault(cov):
        for line, matrix in zip(lines, cov, strict=True):
            if fault := covariance_fault(matrix):
                raise origin.fault(f"the covariance of {', '.join(names)} {fault}", line)
    return names, cov


def _header(names: Sequence[str]) -> list[str]:
    pairs = combinations_with_replacement(names, 2)
    return ["t", *(f"{one}{JOINED}{other}" for one, other in pairs)]


def _names(header: Sequence[str], origin: Origin) -> tuple[str, ...]:
    count = (math.isqrt(8 * len(header) - 7) - 1) // 2 if header else 0
    first = header[1][: (len(header[1]) - 1) // 2] if count else ""
    names = tuple(column[len(first) + 1 :] for column in header[1 : count + 1])
    if not count or list(header) != _header(names):
        raise origin.fault(
            "the first line is to name the columns, t and the upper triangle of the covariance, "
            f"as t,east*east,east*north,north*north; found {','.join(header)!r}",
            1,
        )
    return names


def _require_times(own: Array, times: Array, lines: Sequence[int], origin: Origin) -> None:
    if len(own) != len(times):
        raise origin.fault(
            f"it has {len(own)} covariances, where the poses are {len(times)}; are the files of "
            "one trajectory?"
        )
    if (other := own != times).any():
        row = int(other.argmax())
        raise origin.fault(
            f"t = {float(own[row])!r}, where the pose is of t = {float(times[row])!r}; are the "
            "files of one trajectory?",
            lines[row],
        )


HEADING = "# timestamp tx ty tz qx qy qz qw"
FIELDS = 8


@public
def write_tum(
    path: Source,
    belief: Any,
    *,
    times: npt.ArrayLike | None = None,
    position: Sequence[str] = (),
    heading: str | EllipsisType | None = ...,
    pitch: str | None = None,
    roll: str | None = None,
    covariance: Source | None = None,
) -> None:
    """Write the means of a trajectory in the format of TUM, and its covariances beside them.

    Numbers are written with all their digits, so that they are read back as the same doubles.
    Angles become a quaternion of the turn R_z(heading) R_y(pitch) R_x(roll), and come back in
    [−π, π), to rounding. Other tools, such as evo, read the file as it is. Positions whose variable
    has another unit of length are written in metres, means and covariances; without a unit they are
    taken to be in metres.

    Parameters
    ----------
    path : str, Path or open file
        File of the poses; gzipped, if it ends in ``.gz``.
    belief : Gaussian, GridBelief, ParticleBelief or Poses
        The belief of one run, over time: ``posterior[x]``. Poses have all that is asked for below
        of a belief.
    times : array_like
        (n,): of each of its steps, seconds, increasing; `Timeline` has them as ``times``.
    position : sequence of str
        Two components, east and north, where the height is zero, or three.
    heading : str or None
        To be given of a belief. The angle about the upward axis, from the first component of the
        position towards the second; None for a body without orientation, whose quaternion is that
        of no turn.
    pitch, roll : str, optional
        The other angles; zero without.
    covariance : str, Path or open file, optional
        File of the covariances: a table of comma-separated values with a line of names, ``t`` and
        the upper triangle, ``east*east``, ``east*north``, ..., of the components named above,
        position, roll, pitch and heading.

    Raises
    ------
    ModelError
        If the belief is none, or of several runs, or nothing says its times and components; if a
        component is not there, is named twice or, of an angle, was not declared as one; if a
        position is in no unit of length; if one of them has an infinite variance; or if Poses are
        given with arguments that say these.
    EvidenceError
        If times are not finite, do not increase, or are not as many as there are steps.
    FileError
        If a target cannot be written.

    References
    ----------
    Sturm, Engelhard, Endres, Burgard and Cremers, A benchmark for the evaluation of RGB-D SLAM
    systems, 2012.

    Examples
    --------
    >>> import io
    >>> x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
    >>> path = pgm.Gaussian(x, [[0, 0, 0], [1, 0.5, np.pi / 2]], cov=0.01, steps=[0, 1])
    >>> file = io.StringIO()
    >>> write_tum(file, path, times=[10.0, 10.5], position=("east", "north"), heading="heading")
    >>> print(file.getvalue(), end="")
    # timestamp tx ty tz qx qy qz qw
    10.0 0.0 0.0 0.0 0.0 0.0 0.0 1.0
    10.5 1.0 0.5 0.0 0.0 0.0 0.7071067811865475 0.7071067811865476
    """
    if covariance is not None and sources.same(path, covariance):
        raise ModelError(
            f"covariance= is the file of the poses, {covariance!r}; they need one of their own"
        )
    said = [times is not None, bool(position), heading is not ..., pitch or roll]
    if isinstance(belief, Poses):
        if any(said):
            raise ModelError("Poses have times, places and angles of their own; name none of them")
        found = belief
    else:
        if times is None or not position or heading is ...:
            raise ModelError(
                "of a belief, times=, position= and heading= say what is written; heading=None is "
                "of a body without orientation"
            )
        found = Poses.of(
            belief, times=times, position=position, heading=heading, pitch=pitch, roll=roll
        )
    if covariance is not None and found.cov is None:
        raise ModelError(f"{found._title} has no covariances to write; leave covariance= out")
    rows = np.column_stack([found.times, found.position, found.orientation]).tolist()
    sources.write(path, "\n".join([HEADING, *(" ".join(map(repr, row)) for row in rows), ""]))
    if covariance is not None and found.cov is not None:
        write_covariances(covariance, found.times, found.components, found.cov)


@public
def read_tum(path: Source, covariance: Source | None = None, *, limit: int = LIMIT) -> Poses:
    r"""Read a trajectory in the format of TUM, and its covariances.

    Parameters
    ----------
    path : str, Path or open file
        File of the poses; gzipped or not. Numbers may be apart by any spaces and tabs, blank lines
        and comments are skipped. Quaternions may be as far from unit length as four decimals leave
        them, and are made to have it. Poses that go back in time are put in order, and of several
        at one time the first is taken; `dropped` tells of both.
    covariance : str, Path or open file, optional
        File of the covariances that `write_tum` has written beside it.
    limit : int, optional
        How many bytes a file may hold once unpacked, 64 MiB if not given.

    Returns
    -------
    Poses
        ``pgm.Gaussian(x, poses.planar, poses.cov, steps=range(len(poses.times)))`` is the belief
        again, of a robot in the plane.

    Raises
    ------
    FileError
        If a file is malformed, times are not finite or no seconds, or the covariances are not
        those of the poses; the message names the line, what was found, what to do.
    OSError
        If a file cannot be opened.

    Examples
    --------
    >>> import io
    >>> read_tum(io.StringIO("0.0 1 2 0 0 0 0 1\n0.5 1 3 0 0 0 1 0\n")).planar.round(6)
    array([[ 1.      ,  2.      ,  0.      ],
           [ 1.      ,  3.      , -3.141593]])
    """
    content = sources.read(path, limit)
    origin = content.origin
    lines, rows = [], []
    for line in text_lines(content):
        rows.append(_pose(line))
        lines.append(line.number)
    if not rows:
        raise origin.fault("it has no poses, lines of t x y z qx qy qz qw; is it another file?")
    table = np.array(rows)
    names: tuple[str, ...] = ()
    cov = None
    if covariance is not None:
        names, cov = read_covariances(covariance, table[:, 0], limit)
    return made(table, lines, origin, "are they the last four numbers, w last?", names, cov)


def _pose(line: Line) -> list[float]:
    words = line.words
    if len(words) != FIELDS:
        hint = "; are they apart by spaces, and not by commas?" if "," in words[0] else ""
        raise line.origin.fault(
            f"it has {len(words)} numbers, where t x y z qx qy qz qw, {FIELDS} of them, were due"
            f"{hint}",
            line.number,
        )
    return [number(word, line.number, line.origin) for word in words]
