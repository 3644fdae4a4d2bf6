"""Weights of the states of a hidden Markov chain by the measurements of one sensor: p(z | x).

Weights are (*slice, [runs]), as a belief: an axis for each hidden variable of a step, of length one
if the weights do not depend on it, then one of runs, which is there only if the user gave axes of
runs. Their entries are numbers or logarithms, as a *semiring* has it. A *log-scale* is the
logarithm of a number by which weights have been divided, to keep them near one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from pgm.errors import EvidenceError
from pgm.evidence import Reading
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import SUM_PRODUCT, Semiring

if TYPE_CHECKING:
    from pgm.beliefs.markov.plan import SlicePlan


class SensorWeights(ABC):
    """The likelihood weights p(z | x) of one sensor's measurements, on the axes of a belief.

    A *row* is the place of a measurement among the sensor's, which are sorted by step.

    runs: How many runs there are.
    batch: Whether beliefs have an axis of runs.
    order: The sensor's hidden parents, in the order of the slice.
    shape: The shape of the weights without runs: an axis for each variable of the slice, of length
        one for a variable that is no parent.
    complete: Whether no measurement is missing in any run.
    advice: What to do about a measurement of probability zero.
    """

    advice: ClassVar[str] = (
        "Leave it out; or, if it can happen, replace the zeros that forbid it in the CPDs' tables "
        "by small probabilities"
    )

    def __init__(self, plan: SlicePlan, reading: Reading, runs: int, batch: bool) -> None:
        self.reading, self.runs, self.batch = reading, runs, batch
        self.cpd: Any = reading.cpd
        hidden = [v for v in self.cpd.given if v in plan.labels]
        self.order = [v for v in plan.slice if v in hidden]
        self.shape = tuple(v.size if v in hidden else 1 for v in plan.slice)
        late = [v for v in hidden if v not in plan.states]
        if late and reading.step.size and reading.step[0] == 0:
            raise EvidenceError(
                f"a measurement of {self.cpd.child!r} at step 0, but its parent {late[0]!r} is a "
                "control, which there is from step 1 on",
                variable=self.cpd.child,
                cpd=self.cpd,
                step=0,
            )
        self.complete = bool(reading.taken.all())
        self.starts = np.searchsorted(reading.step, np.arange(_last(reading) + 2)).tolist()

    def at(self, step: int) -> range:
        """The rows of the measurements of a step."""
        if step + 1 >= len(self.starts):
            return range(0)
        return range(self.starts[step], self.starts[step + 1])

    @abstractmethod
    def row(self, row: int, semiring: Semiring = SUM_PRODUCT) -> Array | None:
        """The weights of the measurement at a row, (*slice, [runs]), as entries of the semiring.

        In runs that lack the measurement the weights are the semiring's one. The result may be None
        if all runs lack it. What they have been divided by `log_scale` tells.
        """

    @abstractmethod
    def log_scale(self, row: int, semiring: Semiring = SUM_PRODUCT) -> Array | float:
        """The log-scale of a row's weights, (runs or 1,), or one number without axes of runs."""

    @abstractmethod
    def picked(self, part: range) -> tuple[Array, Array] | None:
        """The weights of some steps, (steps, *slice, [runs]), and log-scales, (steps, [runs]).

        `part` are the steps, consecutive ones. The largest weight of each step and run is one; a
        step without a measurement has ones. None where they are not to be had for all steps at
        once, as with several measurements at a step.
        """

    @property
    @abstractmethod
    def smallest(self) -> float:
        """A lower bound, for any step, of a product of positive weights, one a measurement."""

    def _rows(self, part: range) -> range:
        """The rows of the measurements at some consecutive steps."""
        last = len(self.starts) - 1
        return range(self.starts[min(part.start, last)], self.starts[min(part.stop, last)])

    def multiply(self, found: Array, scales: Array, part: range) -> None:
        """Multiply the weights `found` of some steps by those of this sensor, in place.

        `found` (steps, *slice, [runs]) and `scales` (steps, [runs]) are the weights and log-scales
        by other sensors; this sensor's log-scales are added to `scales`. `part` are the steps,
        consecutive ones.
        """
        picked = self.picked(part)
        if picked is not None:
            found *= picked[0]
            scales += picked[1]
            return
        rows = self._rows(part)
        steps = self.reading.step[rows.start : rows.stop] - part.start
        for step, row in zip(steps.tolist(), rows, strict=True):
            weights = self.row(row)
            if weights is not None:
                found[step] *= weights
                scales[step] += self.log_scale(row)


def _last(reading: Reading) -> int:
    """The last step at which there is a measurement; −1 if there is none."""
    return int(reading.step[-1]) if reading.step.size else -1
