"""Barfoot's data of a robot among seventeen posts: one ``.mat`` file."""

from __future__ import annotations

import numpy as np

from pgm.arguments import public
from pgm.io.dropped import Dropped
from pgm.io.sources import Origin, Source
from pgm.kernels.arrays import Array
from pgm.recordings.drives.recording import POSE, Recording
from pgm.recordings.drives.stream import Stream
from pgm.recordings.readers import files
from pgm.recordings.readers.matlab import matlab

COLUMNS = ("t", "x_true", "y_true", "th_true", "v", "om")
TABLES = {**dict.fromkeys((*COLUMNS, "r", "b")), "l": 2}
VARIANCES = ("r_var", "b_var", "v_var", "om_var")
VALID, OFFSET = "true_valid", "d"


@public
def read_barfoot(path: Source) -> Recording:
    """Read the localisation data of a course of T. D. Barfoot (AER1513, University of Toronto).

    The sensor is ``laser``, (range [m], bearing [rad]), with variances, `mounts` ahead of the
    centre by ``d``. Landmarks are numbered from 1, as the columns of r and b are.

    Parameters
    ----------
    path : str, Path or open file
        A ``.mat`` file of t, x_true, y_true, th_true, l, r, b, v, om; and of d, r_var, b_var,
        v_var, om_var and true_valid, where they are there.

    Notes
    -----
    A landmark that was not seen has a range and bearing of 0. Row k of v and om is held from
    t[k − 1] on, as in the course's motion model, and the first one is left out; so is truth where
    true_valid is 0.

    Raises
    ------
    FileError
        If it is no such file.

    Examples
    --------
    >>> import io
    >>> import scipy.io
    >>> file, zero = io.BytesIO(), np.zeros((3, 1))
    >>> scipy.io.savemat(file, dict(
    ...     t=[[0.0], [0.1], [0.2]], x_true=zero, y_true=zero, th_true=zero, l=[[2.0, 0.0]], d=0.2,
    ...     r=[[0.0], [1.8], [0.0]], b=zero, v=[[0.0], [0.1], [0.2]], om=zero,
    ... ))
    >>> drive = pgm.recordings.read_barfoot(io.BytesIO(file.getvalue()))
    >>> drive.sightings["laser"].stamps, drive.velocities["v"]
    (array([0.1]), array([0.1, 0.2, 0.2]))
    """
    kind = "a recording of Barfoot's"
    found, origin = matlab(path, kind, TABLES, (*VARIANCES, VALID, OFFSET))
    places = found["l"]
    steps, marks = found["t"].size, len(places)
    for key in ("r", "b"):
        if found[key].shape != (steps, marks):
            raise origin.fault(
                f"the table {key} has shape {found[key].shape}; ({steps}, {marks}), for the times "
                "and the landmarks, was due"
            )
    t, *columns, v, om = (_column(found[key], key, steps, origin) for key in COLUMNS)
    if steps < 2:
        raise origin.fault(f"the table t has {steps} times; two or more were due")
    spread = {key: _number(found[key], key, origin) for key in (*VARIANCES, OFFSET) if key in found}
    valid = np.ones(steps, dtype=bool)
    if VALID in found:
        valid = _column(found[VALID], VALID, steps, origin) != 0.0
    step, mark = np.nonzero((found["r"] != 0.0) | (found["b"] != 0.0))
    told = [Dropped("velocities", "before the first state", np.array([0]))]
    if not valid.all():
        told.append(Dropped("truth", "not valid, the file says", np.flatnonzero(~valid)))
    seen = np.column_stack([found["r"][step, mark], found["b"][step, mark]])
    driven = np.column_stack([v, om])[np.append(np.arange(1, steps), -1)]
    with files.told_of(origin):
        return Recording(
            velocities=Stream(
                t, driven, ("v", "omega"), variances=_variances(spread, t, "v", "om")
            ),
            sightings={
                "laser": Stream(
                    t[step],
                    seen,
                    ("range", "bearing"),
                    subject=(mark + 1).tolist(),
                    variances=_variances(spread, seen, "r", "b"),
                )
            },
            landmarks=dict(enumerate(places, start=1)),
            truth=Stream(t[valid], np.column_stack(columns)[valid], POSE),
            mounts={"laser": (spread[OFFSET], 0.0, 0.0)} if OFFSET in spread else None,
            name=files.name(path),
            dropped=told,
        )


def _column(table: Array, key: str, rows: int, origin: Origin) -> Array:
    if table.size != rows or max(table.shape) != rows:
        raise origin.fault(f"the table {key} has shape {table.shape}; ({rows}, 1) was due")
    return table.ravel()


def _number(table: Array, key: str, origin: Origin) -> float:
    if table.size != 1:
        raise origin.fault(f"the table {key} has shape {table.shape}; one number was due")
    return float(table.ravel()[0])


def _variances(spread: dict[str, float], rows: Array, *names: str) -> Array | None:
    """The variances of each row, if every component has one."""
    keys = [f"{name}_var" for name in names]
    if any(key not in spread for key in keys):
        return None
    return np.tile([spread[key] for key in keys], (len(rows), 1))
