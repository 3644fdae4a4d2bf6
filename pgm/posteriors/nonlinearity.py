"""How nonlinear CPDs are over the beliefs where they were linearised, as a posterior shows it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgm.display import Summary, number
from pgm.kernels.arrays import Array
from pgm.posteriors.by_sensor import EachSensor
from pgm.variables import Variable

# Above this no line at a belief is to be trusted. With the five sensors and three starts of the
# experiment `nonlinear_measurement`, beliefs of less are .02 nats off in the mean at the most, and
# all of .11 nats and above have more. Drives from a known start have more in up to 4 of 100.
WRONG = 0.5


class Nonlinearities(EachSensor[Array]):
    """By child of a nonlinear CPD, how nonlinear it is where it was linearised.

    The figures of a sensor are (*runs, M), of a state (*runs, T); see `Posterior.nonlinearity`.
    """

    _what = "nonlinearities"

    def __init__(self, found: Mapping[Variable, Array]) -> None:
        for figures in found.values():
            figures.flags.writeable = False
        super().__init__(found)

    def _absent(self, variable: Variable) -> str:
        return (
            f"there is no nonlinearity of {variable!r}; nonlinear CPDs were linearised of "
            f"{list(self)}"
        )

    @property
    def wrong(self) -> str:
        """Where a line is not to be trusted, in words such as "z at 12 of 60"; empty if nowhere."""
        told = []
        for variable, figures in self.items():
            known = ~np.isnan(figures)
            count = int((figures[known] > WRONG).sum())
            if count:
                told.append(f"{variable!r} at {count:,} of {int(known.sum()):,}")
        return ", ".join(told)

    def told(self, iterations: int) -> str:
        """A line on where no line is right, and what to try; empty if nowhere."""
        wrong = self.wrong
        return wrong and f"linearised where no line is right: {wrong}; {advice(iterations)}"

    def _summary(self) -> Summary:
        lines = []
        for variable, figures in self.items():
            known = figures[~np.isnan(figures)]
            if not known.size:
                lines.append(f"{variable!r}: nothing read")
                continue
            lines.append(
                f"{variable!r}: {number(known.min(), 3)} to {number(known.max(), 3)}, median "
                f"{number(float(np.median(known)), 3)}; {int((known > WRONG).sum())} of "
                f"{known.size} above {WRONG}"
            )
        return Summary(self._title, lines)


def advice(iterations: int) -> str:
    """The advice against a linearisation that is wrong after so many iterations."""
    return "try pgm.estimate" if iterations > 1 else "smooth with iterations=, or try pgm.estimate"
