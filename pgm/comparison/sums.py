"""The sums of a study: statistics of each method over some runs, joined block by block."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from pgm.comparison.packed_tallies import joined as joined_tallies
from pgm.comparison.tally import Tally
from pgm.kernels.arrays import Integers
from pgm.variables import Variable

NONE: Integers = np.zeros(0, dtype=np.intp)


def far() -> np.errstate:
    """Let figures be infinite within this block.

    A cloud of draws that has collapsed is off by so many deviations that their square overflows.
    """
    return np.errstate(over="ignore", invalid="ignore")


class Sums(NamedTuple):
    """The statistics of a method over some runs.

    tallies: By the name of the statistic, and the state or the sensor.
    diverged, failed: Numbers of runs.
    unsettled: How many runs did not settle.
    worst: By state, the largest NEES of any step, and the number of its run; −∞ where no run has
        any, and empty where all failed.
    doubtful: Numbers of runs whose oracle is not to be trusted.
    """

    tallies: Mapping[tuple[str, Variable], Tally]
    runs: int
    diverged: Integers
    failed: Integers
    unsettled: int
    worst: Mapping[Variable, tuple[float, int]]
    doubtful: Integers = NONE

    @classmethod
    def of_failed(cls, run: int) -> Sums:
        """The sums of one run, in which the method ended in an error."""
        return cls({}, 0, NONE, np.array([run], dtype=np.intp), 0, {})

    def joined(self, other: Sums) -> Sums:
        """The statistics over these runs and the next."""
        with far():
            tallies = joined_tallies(self.tallies, other.tallies)
        return Sums(
            tallies,
            self.runs + other.runs,
            np.concatenate([self.diverged, other.diverged]),
            np.concatenate([self.failed, other.failed]),
            self.unsettled + other.unsettled,
            {
                state: max(self.worst.get(state, each), each, key=itemgetter(0))
                for state, each in (other.worst or self.worst).items()
            },
            np.concatenate([self.doubtful, other.doubtful]),
        )


def joined(blocks: Iterable[Mapping[str, Sums]]) -> dict[str, Sums]:
    """The sums of each method, joined in the order of the blocks, so that all digits are fixed."""
    found: dict[str, Sums] = {}
    for block in blocks:
        for name, part in block.items():
            found[name] = found[name].joined(part) if name in found else part
    return found
