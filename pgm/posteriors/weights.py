"""The weights of measurements, by sensor or by factor, as results show them."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np

from pgm.display import Listing, Summary, count, few, number, titled
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


class FactorWeights(Weights):
    """The weights of the factors of a `MarkovNetwork`, (*runs) each: 1 for Gaussian noise.

    They are those of all `NonlinearGaussianFactor`s, and of CPDs with robust noise.
    """

    def __init__(self, found: Mapping[Any, Array]) -> None:
        super().__init__(found)

    def _asked(self, variable: Any) -> Any:
        return variable if isinstance(variable, Hashable) else None

    def _absent(self, variable: Any) -> str:
        return (
            f"there are no weights of {titled(variable)}; those of a Markov network are by factor, "
            "of a NonlinearGaussianFactor or of a CPD with robust noise, posterior.weights[factor]"
        )

    @property
    def _title(self) -> str:
        return f"{type(self).__name__}({count(len(self), 'factor')})"

    def _summary(self) -> Summary:
        """The factors by their weights, least first, and how many hardly counted."""
        least = np.array([weight.min() for weight in self.values()])
        order, factors = np.argsort(least, kind="stable").tolist(), list(self)
        rows = [
            None if k is None else [titled(factors[order[k]]), number(float(least[order[k]]), 3)]
            for k in few(len(order))
        ]
        hardly = f"{int((least < _HARDLY).sum())} of {least.size} below {_HARDLY}"
        return Summary(self._title, [hardly, Listing(("factor", "weight"), rows, names=1)])
