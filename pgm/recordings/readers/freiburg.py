"""The Freiburg recording: odometry, and sightings of numbered landmarks after each motion."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from pgm.arguments import public
from pgm.io import sources
from pgm.recordings.drives.recording import Recording
from pgm.recordings.drives.stream import Stream
from pgm.recordings.readers import files

SENSOR, WORLD = "sensor_data.dat", "world.dat"


@public
def read_freiburg(folder: str | os.PathLike[str], *, skip: Sequence[str] = ()) -> Recording:
    r"""Read the recording of an exercise of the University of Freiburg.

    The sensor is ``landmark``, (range [m], bearing [rad]); odometry is (rot1, trans, rot2) since
    the step before. The stamp is the step, from 1, in which a landmark is seen after the motion.

    Parameters
    ----------
    folder : str or Path
        It holds ``sensor_data.dat``, lines of ``ODOMETRY rot1 trans rot2`` and
        ``SENSOR id range bearing``, and ``world.dat``, lines of ``id east north``.
    skip : sequence of str, optional
        First words of other lines of ``sensor_data.dat``, which are left out; `dropped` tells.

    Notes
    -----
    There are no times: steps stand for seconds. The drive starts at (0, 0, 0), without truth.

    Raises
    ------
    FileError
        If a file cannot be read, or a line is not as above; it has file and line.

    References
    ----------
    Introduction to Mobile Robotics, University of Freiburg, sheet 7, 2019.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as name:
    ...     folder = pathlib.Path(name)
    ...     _ = (folder / "world.dat").write_text("1 2 1\n")
    ...     _ = (folder / "sensor_data.dat").write_text("ODOMETRY 0.1 0.2 0\nSENSOR 1 2.1 0.35\n")
    ...     drive = pgm.recordings.read_freiburg(folder)
    >>> drive.sightings["landmark"].values
    array([[2.1 , 0.35]])
    """
    left = files.Skipped(skip)
    where = files.folder(folder)
    landmarks = _world(where)
    held = files.content(where / SENSOR)
    motions: list[list[float]] = []
    rows: list[list[float]] = []
    subjects: list[int] = []
    for line in left.others(sources.lines(held)):
        if line.words[0] == "ODOMETRY":
            motions.append(line.numbers("ODOMETRY rot1 trans rot2", 1))
        elif line.words[0] == "SENSOR":
            number, away, bearing = line.numbers("SENSOR id range bearing", 1)
            if number not in landmarks:
                raise line.fault(f"a landmark {line.words[1]} that {WORLD} does not have")
            if away < 0.0:
                raise line.fault(f"a range of {away:g} m; 0 or more was due")
            if not motions:
                raise line.fault("a sighting before the first ODOMETRY")
            rows.append([len(motions), away, bearing])
            subjects.append(int(number))
        else:
            raise left.stranger(line, ("ODOMETRY", "SENSOR"))
    if not motions:
        raise held.origin.fault("no line of ODOMETRY; is it a Freiburg recording?")
    seen = np.array(rows).reshape(-1, 3)
    stamps = np.arange(1.0, len(motions) + 1)
    with files.told_of(held.origin):
        return Recording(
            odometry=Stream(stamps, motions, ("rot1", "trans", "rot2"), begin=0.0),
            sightings={
                "landmark": Stream(seen[:, 0], seen[:, 1:], ("range", "bearing"), subject=subjects)
            },
            landmarks=landmarks,
            name=where.name,
            dropped=left.told(SENSOR),
        )


def _world(where: os.PathLike[str]) -> dict[int, tuple[float, float]]:
    """Landmarks by number."""
    held = files.content(files.folder(where) / WORLD)
    landmarks: dict[int, tuple[float, float]] = {}
    for line in sources.lines(held):
        _, east, north = line.numbers("id east north")
        number = line.whole(line.words[0], "a landmark")
        if number in landmarks:
            raise line.fault(
                f"the landmark {line.words[0]} for the second time; leave one of its lines out"
            )
        landmarks[number] = (east, north)
    if not landmarks:
        raise held.origin.fault("no landmarks; lines of id east north were due")
    return landmarks
