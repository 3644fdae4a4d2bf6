"""The Plaza recordings: a lawn mower with odometry that hears its distance to beacons."""

from __future__ import annotations

import numpy as np

from pgm.arguments import public
from pgm.io.sources import Source
from pgm.kernels.arrays import Array
from pgm.recordings.drives.recording import POSE, Recording
from pgm.recordings.drives.stream import Stream
from pgm.recordings.readers import files
from pgm.recordings.readers.matlab import matlab

# Of each table: true poses, odometry, ranges heard, and places of beacons, by time or number.
COLUMNS = {"GT": 4, "DR": 3, "TD": 4, "TL": 3}


@public
def read_plaza(path: Source) -> Recording:
    """Read a Plaza recording, a ``.mat`` file of Djugash, Hamner and Roth (2009).

    The sensor is ``radio``, range [m]; odometry is (distance, turn) since the stamp before.

    Nothing is mended of what the guide's page about recordings tells of Plaza1 and Plaza2.

    Parameters
    ----------
    path : str, Path or open file
        As ``gtsam.findExampleDataFile("Plaza1_.mat")``.

    Raises
    ------
    FileError
        If it is no such file.

    Examples
    --------
    >>> import io
    >>> import scipy.io
    >>> file = io.BytesIO()
    >>> poses = [[0.0, 0, 0, 0], [1.0, 2, 0, 0]]
    >>> heard = [[0.5, 2, 7, 3.9]]
    >>> scipy.io.savemat(file, dict(GT=poses, DR=[[1.0, 2, 0]], TD=heard, TL=[[7.0, 5, 0]]))
    >>> pgm.recordings.read_plaza(io.BytesIO(file.getvalue())).sightings["radio"]
    Stream(1 row of range, 0.5 s to 0.5 s)
      stamp  range  subject
        0.5    3.9        7
    """
    tables, origin = matlab(path, "a Plaza recording", COLUMNS)
    truth, moved, heard, where = tables["GT"], tables["DR"], tables["TD"], tables["TL"]
    for key, numbers in (("TL", where[:, 0]), ("TD", heard[:, 2])):
        if (numbers != np.round(numbers)).any() or (np.abs(numbers) > 2**53).any():
            raise origin.fault(f"the table {key} has beacons that are no whole numbers")
    if len(np.unique(where[:, 0])) < len(where):
        raise origin.fault("the table TL has a beacon twice")
    if not len(truth):
        raise origin.fault("the table GT has no rows")
    with files.told_of(origin):
        return Recording(
            odometry=Stream(moved[:, 0], moved[:, 1:], ("distance", "turn"), begin=truth[0, 0]),
            sightings={
                "radio": Stream(heard[:, 0], heard[:, 3], ("range",), subject=_whole(heard[:, 2]))
            },
            landmarks={int(number): (east, north) for number, east, north in where},
            truth=Stream(truth[:, 0], truth[:, 1:], POSE),
            name=files.name(path),
        )


def _whole(numbers: Array) -> list[int]:
    found: list[int] = numbers.astype(int).tolist()
    return found
