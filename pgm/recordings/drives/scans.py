"""Laser scans with their stamps."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, is_number
from pgm.display import NoArray, Shown, count
from pgm.errors import EvidenceError
from pgm.immutable import Immutable
from pgm.io.stamped import as_stamps, clock
from pgm.kernels.arrays import Array, Integers, Mask, frozen


@public
class Scans(Shown, NoArray, Immutable):
    """Scans of one laser: one range a ray, at each stamp.

    Parameters
    ----------
    stamps : array_like
        (n,), seconds, in order.
    ranges : array_like
        (n, rays), metres; `most` where nothing was met, NaN where nothing was measured.
    angles : array_like
        (rays,): of each ray from straight ahead, to the left, radians.
    most : float
        The largest range; larger ones are cut to it.

    Raises
    ------
    EvidenceError
        If shapes do not fit, stamps are out of order, or ranges are negative.

    Examples
    --------
    >>> from pgm.recordings import Scans
    >>> Scans([0.0, 0.1], [[1.0, 2.0], [9.0, 3.0]], [-0.5, 0.5], most=8.0).ranges
    array([[1., 2.],
           [8., 3.]])
    """

    stamps: Array
    ranges: Array
    angles: Array
    most: float

    _arrays: ClassVar[str] = ".stamps and .ranges"

    def __init__(
        self,
        stamps: npt.ArrayLike,
        ranges: npt.ArrayLike,
        angles: npt.ArrayLike,
        most: float,
    ) -> None:
        when = as_stamps("stamps", stamps)
        away = as_floats(ranges, "ranges", EvidenceError, missing=True)
        along = as_floats(angles, "angles", EvidenceError)
        if along.ndim != 1 or not np.isfinite(along).all() or away.shape != (when.size, along.size):
            raise EvidenceError(
                f"ranges have shape {away.shape}, with {when.size} stamps and {along.shape} angles;"
                " a row for each stamp and a column for each angle were due"
            )
        if not (is_number(most) and most > 0.0 and np.isfinite(most)):
            raise EvidenceError(f"most= is the largest range in metres, not {most!r}")
        if (away < 0.0).any():
            row = int(np.argwhere(away < 0.0)[0, 0])
            raise EvidenceError(f"ranges, row {row}: {away[row].min():g} m; 0 or more was due")
        if (back := np.diff(when) < 0.0).any():
            raise EvidenceError(
                f"stamps, row {int(back.argmax()) + 1}: before the row above; np.argsort(stamps) "
                "puts scans in order"
            )
        self._set(
            stamps=frozen(when),
            ranges=frozen(np.minimum(away, most)),
            angles=frozen(along.copy()),
            most=float(most),
        )

    def __len__(self) -> int:
        return self.stamps.size

    def take(self, rows: Integers | Mask | slice) -> Scans:
        """The scans at some indices or in a mask."""
        return Scans(self.stamps[rows], self.ranges[rows], self.angles, self.most)

    def between(self, first: float, last: float) -> Scans:
        """The scans from one time to another, both included."""
        return self.take((self.stamps >= first) & (self.stamps <= last))

    @property
    def _title(self) -> str:
        span = f", {clock(self.stamps[0])} to {clock(self.stamps[-1])}" if len(self) else ""
        return f"Scans({count(len(self), 'scan')} of {count(self.angles.size, 'ray')}{span})"
