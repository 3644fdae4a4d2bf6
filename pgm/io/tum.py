"""Trajectories to and from files in the format of the TUM RGB-D benchmark.

A line is a pose, eight numbers apart by single spaces: ``t x y z qx qy qz qw``, seconds, metres and
a unit quaternion; a line that begins with ``#`` is a comment.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_tuple, is_unordered
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError
from pgm.factors import Gaussian
from pgm.factors.scope import listed
from pgm.io import covariances, sources
from pgm.io.poses import Poses
from pgm.io.sources import LIMIT, Origin, Source
from pgm.io.stamped import as_stamps, clock
from pgm.io.words import Line, number
from pgm.io.words import lines as text_lines
from pgm.kernels import quaternions
from pgm.kernels.arrays import Array

HEADING = "# timestamp tx ty tz qx qy qz qw"
FIELDS = 8
# How far from one the length of a quaternion may be, whose numbers may be printed to four decimals.
UNIT = 1e-3
ROUNDING = 1e-14


def write_tum(
    path: Source,
    belief: Any,
    *,
    times: npt.ArrayLike,
    position: Sequence[str],
    heading: str | None,
    pitch: str | None = None,
    roll: str | None = None,
    covariance: Source | None = None,
) -> None:
    """Write the means of a trajectory in the format of TUM, and its covariances beside them.

    Numbers are written with all their digits, so that they are read back as the same doubles.
    Angles become a quaternion of the turn R_z(heading) R_y(pitch) R_x(roll), and come back in
    [−π, π), to rounding. Other tools, such as evo, read the file as it is.

    Parameters
    ----------
    path : str, Path or open file
        Of the poses; gzipped, if it ends in ``.gz``.
    belief : Gaussian, GridBelief or ParticleBelief
        Of one run, over time: ``posterior[x]``.
    times : array_like
        (n,): of each of its steps, seconds, increasing; `Timeline` has them as ``times``.
    position : sequence of str
        Two components, east and north, where the height is zero, or three.
    heading : str or None
        The angle about the upward axis, from the first component of the position towards the
        second; None for a body without orientation, whose quaternion is that of no turn.
    pitch, roll : str, optional
        The other angles; zero without.
    covariance : str, Path or open file, optional
        Of the covariances: a table of comma-separated values with a line of names, ``t`` and the
        upper triangle, ``east*east``, ``east*north``, ..., of the components named above, position,
        roll, pitch and heading, in their units.

    Raises
    ------
    ModelError
        If the belief is none or of several runs, or a component is not there, is named twice or,
        of an angle, was not declared as one; or if one of them has an infinite variance.
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
    gaussian = _trajectory(belief)
    names = [*_position(position), *(name for name in (roll, pitch, heading) if name is not None)]
    places = _places(gaussian, names)
    for name in (roll, pitch, heading):
        if name is not None and not gaussian.angles[gaussian.components.index(name)]:
            raise ModelError(
                f"{name!r} of {gaussian._title} is no angle; declare it as one, in radians: "
                f"pgm.Variable(..., angles=({name!r},))"
            )
    stamps = _increasing(times, len(gaussian.mean))
    xyz, angles = np.zeros((len(stamps), 3)), np.zeros((len(stamps), 3))
    columns = dict(zip(names, gaussian.mean[:, places].T, strict=True))
    for k, name in enumerate(position):
        xyz[:, k] = columns[name]
    for k, angle in enumerate((roll, pitch, heading)):
        if angle is not None:
            angles[:, k] = columns[angle]
    cov = gaussian.cov[:, places][:, :, places]
    if not np.isfinite(cov).all():
        step = int(np.argwhere(~np.isfinite(cov))[0, 0])
        raise ModelError(
            f"{gaussian._title} has an infinite variance in row {step}: its mean there means "
            "nothing; write the steps from which on it is known, belief[k:]"
        )
    rows = np.column_stack([stamps, xyz, quaternions.of_angles(angles)]).tolist()
    sources.write(path, "\n".join([HEADING, *(" ".join(map(repr, row)) for row in rows), ""]))
    if covariance is not None:
        covariances.write(covariance, stamps, names, cov)


def read_tum(path: Source, covariance: Source | None = None, *, limit: int = LIMIT) -> Poses:
    r"""Read a trajectory in the format of TUM, and its covariances.

    Parameters
    ----------
    path : str, Path or open file
        Of the poses; gzipped or not. Numbers may be apart by any spaces and tabs, blank lines and
        comments are skipped. Quaternions may be as far from unit length as four decimals leave
        them, and are made to have it.
    covariance : str, Path or open file, optional
        Of the covariances that `write_tum` has written beside it.
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
        If a file is malformed, times are not finite or do not increase, or the covariances are not
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
    require_increasing(table[:, 0], lines, origin)
    length = np.linalg.norm(table[:, 4:], axis=1)
    if (far := np.abs(length - 1.0) > UNIT).any():
        row = int(far.argmax())
        raise origin.fault(
            f"qx qy qz qw have the length {length[row]:.6g}, and were to be a unit quaternion; "
            "are they the last four numbers, w last?",
            lines[row],
        )
    # A length that is one but for rounding is left as it is, so that numbers stay what they were.
    length[np.abs(length - 1.0) < ROUNDING] = 1.0
    poses = table[:, 0], table[:, 1:4], table[:, 4:] / length[:, None]
    if covariance is None:
        return Poses(*poses)
    return Poses(*poses, *covariances.read(covariance, poses[0], limit))


def require_increasing(times: Array, lines: Sequence[int], origin: Origin) -> None:
    """Refuse times of a file that do not increase from line to line."""
    if (late := np.diff(times) <= 0.0).any():
        row = int(late.argmax()) + 1
        raise origin.fault(
            f"t = {clock(times[row])} does not come after {clock(times[row - 1])} of line "
            f"{lines[row - 1]}; "
            "sort the lines by t, and leave out repeated ones",
            lines[row],
        )


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


def _trajectory(belief: Any) -> Gaussian:
    gaussian = belief.gaussian() if hasattr(belief, "gaussian") else belief
    if not isinstance(gaussian, Gaussian):
        raise ModelError(f"a belief over time, like posterior[x], was due, not {titled(belief)}")
    if gaussian.mean.ndim != 2:
        axes = gaussian.mean.shape[:-1]
        raise ModelError(
            f"{gaussian._title} has the leading axes {axes}; a file holds one run over its steps: "
            "pick it with belief.run(0)"
        )
    return gaussian


def _position(position: Any) -> tuple[str, ...]:
    names = as_tuple(position)
    if names is None or len(names) not in (2, 3) or is_unordered(position):
        raise ModelError(
            f"position= names two components or three, like ('east', 'north'); found {position!r}"
        )
    return names


def _places(gaussian: Gaussian, names: Sequence[str]) -> list[int]:
    known = gaussian.components
    for name in names:
        if name not in known:
            raise ModelError(f"{gaussian._title} has no component {name!r}; it has {listed(known)}")
        if names.count(name) > 1:
            raise ModelError(f"the component {name!r} is named twice, of {listed(names)}")
    return [known.index(name) for name in names]


def _increasing(times: npt.ArrayLike, count: int) -> Array:
    """The times of so many rows, seconds, increasing."""
    stamps = as_stamps("times", times)
    if stamps.size != count:
        raise EvidenceError(f"times= has {stamps.size} of them, and the belief {count} steps")
    if (late := np.diff(stamps) <= 0.0).any():
        row = int(late.argmax()) + 1
        raise EvidenceError(
            f"times= do not increase: {clock(stamps[row])} in row {row} does not come after "
            f"{clock(stamps[row - 1])}"
        )
    return stamps
