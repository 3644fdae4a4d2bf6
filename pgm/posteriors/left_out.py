"""The beliefs of readings given all readings but their own, by sensor."""

from __future__ import annotations

from typing import Any

from pgm.display import Summary
from pgm.errors import Unanswered
from pgm.posteriors.belief_kind import SMOOTHED, Kind
from pgm.posteriors.by_sensor import EachSensor


class LeftOut(EachSensor[Any]):
    """A mapping of the variables of sensors to the beliefs of their readings, each left out.

    A belief is what a measurement of the sensor has: a `Gaussian` or a `Table`, one row a reading.
    """

    _what = "readings"

    def _summary(self) -> Summary:
        return Summary(self._title, [f"{v!r}: {found._title}" for v, found in self.items()])


def require_all(kind: Kind) -> None:
    """Refuse beliefs of readings given all others, of a posterior that does not know all."""
    if kind != SMOOTHED:
        raise Unanswered(
            f"left_out knows all readings but one, and this posterior is {kind}: take pgm.smooth; "
            "posterior.predicted[z] has what the readings before each tell of it"
        )
