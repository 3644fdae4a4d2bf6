"""Text files of libRSF: ranges to modules, wheel speeds and true places, a line each."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pgm.arguments import public
from pgm.io import sources
from pgm.io.sources import Content, Source
from pgm.kernels.arrays import Array
from pgm.recordings.drives import motion
from pgm.recordings.drives.recording import PLACE, Recording
from pgm.recordings.drives.stream import Stream
from pgm.recordings.readers import files

INPUT, TRUTH = "Indoor_UWB_Input.txt", "Indoor_UWB_GT.txt"
_RANGE = "range2 t range variance x y id snr"
_WHEELS = "odom2diff t right left side wheelbase var1 var2 var3"
_POINT = "point2 t x y xx xy yx yy"
_KINDS = {due.split()[0]: due for due in (_RANGE, _WHEELS, _POINT)}


@public
def read_labyrinth(
    source: Source,
    truth: Source | None = None,
    *,
    swapped: bool = True,
    wheelbase: float = 0.157,
    skip: Sequence[str] = (),
) -> Recording:
    r"""Read a recording of libRSF's text format, as Labyrinth of TU Chemnitz (Pfeifer).

    The sensor is ``uwb``, range [m] with its variance; velocities are (v, omega) of the wheels,
    held until the next stamp. Places of the modules stand in the lines of their ranges.

    Parameters
    ----------
    source : str, Path or open file
        The folder of ``Indoor_UWB_Input.txt`` and ``Indoor_UWB_GT.txt``; or a file like the first.
    truth : str, Path or open file, optional
        A file of lines ``point2 t x y`` and a covariance; no headings. That of the folder without.
    swapped : bool, optional
        Whether the column called right is the left wheel's, as it is in Labyrinth.
    wheelbase : float, optional
        Metres between the wheels: twice the 0.0785 that Labyrinth's lines say, by its truth.
    skip : sequence of str, optional
        First words of other lines, such as ``("imu3",)``, which are left out; `dropped` tells.

    Raises
    ------
    FileError
        If a file cannot be read, or a line is not as above; it has file and line.

    Examples
    --------
    >>> import io
    >>> lines = ["range2 0.1 2.9 0.01 0 2 105 0", "odom2diff 0.1 0.2 0.4 0 0.0785 0 0 0"]
    >>> drive = pgm.recordings.read_labyrinth(io.StringIO("\n".join(lines)))
    >>> drive.velocities.values.round(3)
    array([[0.3  , 1.274]])
    """
    name = files.name(source)
    if isinstance(source, str | os.PathLike) and Path(source).is_dir():
        source, truth = Path(source) / INPUT, truth or Path(source) / TRUTH
    left = files.Skipped(skip)
    held = files.content(source)
    tables = _tables(held, ("range2", "odom2diff"), left)
    told = left.told("input")
    heard, wheels = tables["range2"], tables["odom2diff"]
    subjects = [int(number) for number in heard[:, 5]]
    places = dict(zip(subjects, heard[:, 3:5].tolist(), strict=True))
    for number, place in zip(subjects, heard[:, 3:5].tolist(), strict=True):
        if places[number] != place:
            raise held.origin.fault(
                f"the module {number} has two places, {place} and {places[number]}"
            )
    left, right = wheels[:, [1, 2] if swapped else [2, 1]].T
    speeds = motion.of_wheels(left, right, wheelbase)
    known = None
    if truth is not None:
        points = files.content(truth)
        behind = files.Skipped(skip)
        table = _tables(points, ("point2",), behind)["point2"]
        told += behind.told("truth")
        with files.told_of(points.origin):
            known = Stream(table[:, 0], table[:, 1:3], PLACE)
    with files.told_of(held.origin):
        return Recording(
            velocities=Stream(wheels[:, 0], speeds, ("v", "omega")) if len(wheels) else None,
            sightings={
                "uwb": Stream(
                    heard[:, 0],
                    heard[:, 1],
                    ("range",),
                    subject=subjects,
                    variances=heard[:, 2],
                )
            },
            landmarks=places,
            truth=known,
            name=name,
            dropped=told,
        )


def _tables(held: Content, kinds: tuple[str, ...], left: files.Skipped) -> dict[str, Array]:
    """The numbers of lines by their first word."""
    found: dict[str, list[list[float]]] = {kind: [] for kind in kinds}
    for line in left.others(sources.lines(held)):
        kind = line.words[0]
        if kind not in found:
            raise left.stranger(line, kinds)
        row = line.numbers(_KINDS[kind], 1)
        if kind == "range2":
            line.whole(line.words[6], "a module")
        found[kind].append(row)
    if not any(found.values()):
        raise held.origin.fault(f"no line of {' or '.join(kinds)}; is it a file of libRSF?")
    return {
        kind: np.array(rows).reshape(len(rows), len(_KINDS[kind].split()) - 1)
        for kind, rows in found.items()
    }
