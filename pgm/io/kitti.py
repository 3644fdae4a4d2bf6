"""Trajectories of KITTI's odometry benchmark: twelve numbers a pose, and times beside them.

A line has the rows of the matrix [R t], R the turn from the body to the world, t its place.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError
from pgm.io import sources
from pgm.io.poses import Poses, in_order
from pgm.io.sources import LIMIT, Origin, Source
from pgm.io.stamped import as_stamps
from pgm.kernels.arrays import Array

FIELDS = "r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z"
# How far from a rotation a matrix may be, whose numbers may be printed to four decimals.
_TURN = 1e-3
# Axes of a camera, right, down and forward, as forward, left and up.
_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@public
def read_kitti(
    path: Source, times: Source | npt.ArrayLike, *, camera: bool, limit: int = LIMIT
) -> Poses:
    r"""Read a trajectory in the format of KITTI's odometry benchmark.

    Parameters
    ----------
    path : str, Path or open file
        File of the poses, gzipped or not.
    times : str, Path, open file or array_like
        The benchmark's ``times.txt``, a number a line, or (n,) seconds: the poses have none.
    camera : bool
        Whether poses are of a camera, whose axes are right, down and forward, as KITTI's own files
        are: they become forward, left and up, so that `Poses.planar` is seen from above. Without,
        they are taken as they are.
    limit : int, optional
        How many bytes a file may hold once unpacked, 64 MiB if not given.

    Returns
    -------
    Poses
        In order of time; `dropped` tells of poses that were not.

    Raises
    ------
    FileError
        If a file is malformed, a matrix is no rotation, or times are not as many as the poses.
    EvidenceError
        If times that are given as an array are none.
    OSError
        If a file cannot be opened.

    References
    ----------
    Geiger, Lenz and Urtasun, Are we ready for autonomous driving? The KITTI vision benchmark suite,
    2012.

    Examples
    --------
    >>> import io
    >>> ahead = io.StringIO("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 2.5\n")
    >>> read_kitti(ahead, [0.0, 0.1], camera=True).planar
    array([[0. , 0. , 0. ],
           [2.5, 0. , 0. ]])
    """
    from scipy.spatial.transform import Rotation

    _require_camera(camera)
    content = sources.read(path, limit)
    table = sources.numbers(content, FIELDS)
    if not len(table):
        raise content.origin.fault(f"it has no poses, lines of {FIELDS}; is it another file?")
    matrices = table.reshape(-1, 3, 4)
    turns, places = matrices[..., :3], matrices[..., 3]
    _require_rotations(turns, content.origin)
    if camera:
        turns, places = _CAMERA @ turns @ _CAMERA.T, places @ _CAMERA.T
    stamps = _times(times, len(table), content.origin, limit)
    order, told = in_order(stamps)
    quaternions = Rotation.from_matrix(turns).as_quat(canonical=True)
    return Poses(stamps[order], places[order], quaternions[order], dropped=told)


@public
def write_kitti(path: Source, poses: Poses, *, camera: bool, times: Source | None = None) -> None:
    """Write a trajectory in the format of KITTI's odometry benchmark, which evo reads, too.

    Parameters
    ----------
    path : str, Path or open file
        File of the poses; gzipped, if it ends in ``.gz``.
    poses : Poses
        Of a belief they are `Poses.of`. Their covariances have no place in the format.
    camera : bool
        Whether poses are written as a camera's, right, down and forward, as KITTI's own files are.
    times : str, Path or open file, optional
        File of the times, a number a line, which the poses themselves have no place for.

    Raises
    ------
    ModelError
        If poses are none.
    FileError
        If a target cannot be written.

    Examples
    --------
    >>> import io
    >>> here = pgm.Poses(np.zeros(1), np.array([[1.0, 2.0, 0.0]]), np.array([[0.0, 0, 0, 1]]))
    >>> file = io.StringIO()
    >>> write_kitti(file, here, camera=False)
    >>> print(file.getvalue(), end="")
    1.0 0.0 0.0 1.0 0.0 1.0 0.0 2.0 0.0 0.0 1.0 0.0
    """
    from scipy.spatial.transform import Rotation

    _require_camera(camera)
    if not isinstance(poses, Poses):
        raise ModelError(f"Poses were due, as Poses.of(belief, ...) makes, not {titled(poses)}")
    turns, places = Rotation.from_quat(np.array(poses.orientation)).as_matrix(), poses.position
    if camera:
        turns, places = _CAMERA.T @ turns @ _CAMERA, places @ _CAMERA
    rows = (np.concatenate([turns, places[..., None]], axis=-1) + 0.0).reshape(-1, 12).tolist()
    sources.write(path, "".join(" ".join(map(repr, row)) + "\n" for row in rows))
    if times is not None:
        sources.write(times, "".join(f"{stamp!r}\n" for stamp in poses.times.tolist()))


def _require_camera(camera: Any) -> None:
    if not isinstance(camera, bool):
        raise EvidenceError(
            "camera= is True where poses are of a camera (right, down, forward), as KITTI's own, "
            f"or False, not {camera!r}"
        )


def _require_rotations(turns: Array, origin: Origin) -> None:
    odd = np.abs(turns @ turns.swapaxes(-1, -2) - np.eye(3)).max(axis=(-1, -2)) > _TURN
    odd |= np.linalg.det(turns) < 0.0
    if odd.any():
        row = int(odd.argmax())
        raise origin.fault(
            f"pose {row}: its matrix {turns[row].round(4).tolist()} is no rotation; are the "
            f"numbers {FIELDS}?"
        )


def _times(times: Any, count: int, origin: Origin, limit: int) -> Array:
    """The times of so many poses."""
    if isinstance(times, str | os.PathLike) or callable(getattr(times, "read", None)):
        content = sources.read(times, limit)
        table = sources.numbers(content, "t")
        origin = content.origin
        try:
            found = as_stamps("t", table[:, 0])
        except EvidenceError as error:
            raise origin.fault(str(error)) from error
    else:
        found = as_stamps("times", times)
    if len(found) != count:
        raise origin.fault(f"there are {len(found)} times for {count} poses; one each was due")
    return found
