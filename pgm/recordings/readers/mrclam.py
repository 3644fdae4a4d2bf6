"""The UTIAS data of several robots among barcoded landmarks: one robot's drive."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from pgm.arguments import public
from pgm.boundary import is_whole
from pgm.errors import EvidenceError
from pgm.io import sources
from pgm.io.dropped import Dropped
from pgm.io.sources import Content
from pgm.kernels.arrays import Array
from pgm.recordings.drives.recording import POSE, Recording
from pgm.recordings.drives.stream import Stream
from pgm.recordings.readers import files


@public
def read_mrclam(folder: str | os.PathLike[str], robot: int = 1) -> Recording:
    """Read one robot's drive of UTIAS MRCLAM (Leung, Halpern, Barfoot and Liu, 2011).

    The sensor is ``camera``, (range [m], bearing [rad]); velocities are (v, omega), held until the
    next stamp. Subjects 1 to 5 are the other robots, which have no place: ``drive.located()``
    leaves them out. Landmarks have covariances.

    Parameters
    ----------
    folder : str or Path
        It holds ``Barcodes.dat`` and ``Landmark_Groundtruth.dat``, and of the robot
        ``Robot1_Odometry.dat``, ``Robot1_Measurement.dat`` and ``Robot1_Groundtruth.dat``, which
        may be missing.
    robot : int, optional

    Notes
    -----
    The second column of measurements is the barcode, whatever the files' headings say. Readings of
    one that is nobody's are left out, as `dropped` tells.

    Raises
    ------
    FileError
        If a file cannot be read, or a line is not of as many finite numbers as it should be; it
        has file and line.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> texts = {
    ...     "Barcodes": "6 72", "Landmark_Groundtruth": "6 1.9 -5.6 0.001 0.002",
    ...     "Robot1_Odometry": "0.0 0.1 0.0", "Robot1_Measurement": "0.5 72 1.5 -0.2",
    ... }
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name, text in texts.items():
    ...         _ = pathlib.Path(folder, f"{name}.dat").write_text(text)
    ...     drive = pgm.recordings.read_mrclam(folder)
    >>> drive.sightings["camera"].subject
    array([6])
    """
    if not is_whole(robot) or robot < 1:
        raise EvidenceError(f"robot= is the number of a robot, from 1, not {robot!r}")
    where = files.folder(folder)
    owner = _barcodes(where)
    held = files.content(where / f"Robot{robot}_Measurement.dat")
    seen = sources.numbers(held, "time barcode range bearing")
    subjects = [owner.get(barcode) for barcode in seen[:, 1].tolist()]
    named = np.array([subject is not None for subject in subjects], dtype=bool)
    told = []
    if not named.all():
        told.append(Dropped("camera", "a barcode that is nobody's", np.flatnonzero(~named)))
    landmarks, covs = _landmarks(where)
    odometry = files.content(where / f"Robot{robot}_Odometry.dat")
    driven = sources.numbers(odometry, "time v omega")
    if not len(driven):
        raise odometry.origin.fault("no lines of time v omega; is it a file of MRCLAM?")
    truth, path = None, where / f"Robot{robot}_Groundtruth.dat"
    if path.exists():
        truth = _truth(files.content(path))
    with files.told_of(odometry.origin):
        velocities = Stream(driven[:, 0], driven[:, 1:], ("v", "omega"))
    with files.told_of(held.origin):
        return Recording(
            velocities=velocities,
            sightings={
                "camera": Stream(
                    seen[named, 0],
                    seen[named, 2:],
                    ("range", "bearing"),
                    subject=[subject for subject in subjects if subject is not None],
                )
            },
            landmarks=landmarks,
            landmark_cov=covs,
            truth=truth,
            name=f"{where.name} robot {robot}",
            dropped=told,
        )


def _barcodes(where: Path) -> dict[float, int]:
    """The subject of each barcode."""
    owner: dict[float, int] = {}
    held = files.content(where / "Barcodes.dat")
    for line in sources.lines(held):
        line.require("subject barcode")
        subject, barcode = (line.whole(word, "a number") for word in line.words)
        if barcode in owner:
            raise line.fault(f"the barcode {barcode} for the second time")
        owner[float(barcode)] = subject
    if not owner:
        raise held.origin.fault("no lines of subject barcode; is it a file of MRCLAM?")
    return owner


def _landmarks(where: Path) -> tuple[dict[int, Array], dict[int, Array]]:
    """Places and their covariances, by subject."""
    places: dict[int, Array] = {}
    covs: dict[int, Array] = {}
    for line in sources.lines(files.content(where / "Landmark_Groundtruth.dat")):
        _, *found = line.numbers("subject x y std_x std_y")
        subject = line.whole(line.words[0], "a subject")
        if subject in places:
            raise line.fault(f"the landmark {subject} for the second time")
        places[subject] = np.array(found[:2])
        with np.errstate(over="ignore"):  # an infinite one is refused below
            covs[subject] = np.diag(np.square(found[2:]))
    return places, covs


def _truth(held: Content) -> Stream:
    table = sources.numbers(held, "time x y heading")
    with files.told_of(held.origin):
        return Stream(table[:, 0], table[:, 1:], POSE)
