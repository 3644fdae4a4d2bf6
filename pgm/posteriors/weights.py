"""The weights of measurements, by sensor, as results show them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgm.display import Summary, number
from pgm.kernels.arrays import Array
from pgm.posteriors.by_sensor import EachSensor
from pgm.variables import Variable

# Below this share of a Gaussian's information a sighting is counted as one hardly used.
_HARDLY = 0.1


class Weights(EachSensor[Array]):
    """The weights of each sensor: 1 for Gaussian noise, NaN where nothing was read.

    Of a dynamic network they are (*runs, M), one for each of M measurements; of a network without
    time, where a sensor has one, (*runs).
    """

    _what = "weights"

    def __init__(self, found: Mapping[Variable, Array]) -> None:
        for weight in found.values():
            weight.flags.writeable = False
        super().__init__(found)

    def _summary(self) -> Summary:
        """By sensor: the range and median of the weights, and how many sightings hardly counted."""
        lines = []
        for variable, weight in self.items():
            seen = weight[~np.isnan(weight)]
            if not seen.size:
                lines.append(f"{variable!r}: nothing read")
                continue
            if weight.size == 1:
                lines.append(f"{variable!r}: {number(float(seen[0]))}")
                continue
            few = int((seen < _HARDLY).sum())
            lines.append(
                f"{variable!r}: {number(seen.min())} to {number(seen.max())}, median "
                f"{number(float(np.median(seen)))}; {few} of {seen.size} below {_HARDLY}"
            )
        return Summary(self._title, lines)
