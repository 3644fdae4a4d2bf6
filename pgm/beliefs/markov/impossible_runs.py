"""Runs of a chain whose measurements have probability zero: finding them, and NaN for beliefs.

Such a run is called *lost*, from the step t of its first impossible measurement on. A belief
*knows* the measurements that it is given. If it knows the impossible one, it is NaN: a filtered
belief from step t on, a fixed-lag one from step t less the lag on, a smoothed one at all steps. The
filtered beliefs before step t, and the predicted belief at step t, are not NaN.

The last step is T. Beliefs are (*states, *runs): an axis for each hidden variable of a slice, then
one of runs, or none where the user gave no axes of runs; [runs] is such an axis. Entries are
numbers, or logarithms where numbers may underflow.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from pgm.beliefs.markov.chain import TINY, StateChain, smallest
from pgm.beliefs.markov.marginals import Beliefs
from pgm.beliefs.markov.plan import TableSlices
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import LOG_SUM_PRODUCT, SUM_PRODUCT, Semiring
from pgm.posteriors.belief_kind import Kind


class Search(StateChain):
    """A forward sweep that leaves impossible measurements out, and notes the runs that have them.

    lost: The first step of each run, ([runs]), whose measurements have probability zero given those
        before; T + 1 of a run without such a step. It is complete after `run`.
    least: The smallest positive probability in the filtered beliefs, which are not kept; infinity
        where entries are logarithms.
    """

    slices: TableSlices

    def __init__(self, slices: TableSlices, semiring: Semiring = SUM_PRODUCT) -> None:
        super().__init__(slices, semiring)
        runs = (math.prod(slices.lead),) * self.batch
        self.lost: Integers = np.full(runs, slices.steps + 1)
        self.least = math.inf

    def contradicted(
        self, step: int, belief: Array, joint: Array, totals: Array
    ) -> tuple[Array, Array]:
        """Note which runs are lost at a step, and leave its measurements out in these.

        `joint` is the product of the predicted `belief` and the weights of the measurements,
        (*states, *runs), and `totals` are its sums over the states, (*runs), zero where the
        measurements are impossible. Returns the joint, in lost runs with the predicted belief in
        its place, and the sums over the states of what is returned.
        """
        lost = ~(totals > self.semiring.zero)
        self.lost = np.where(lost, np.minimum(self.lost, step), self.lost)
        joint = np.where(lost, belief, joint)
        return joint, self.total(joint)

    def keep(self, step: int, predicted: Array, known: Array, log_density: Array | float) -> None:
        """Note the smallest probability of the filtered belief `known`; no belief is kept."""
        self.least = min(self.least, smallest(known)) if self.semiring.linear else self.least


def first_lost(slices: TableSlices) -> Integers:
    """The first step of each run whose measurements are impossible, ([runs]); T + 1 without one.

    It is found in numbers, or with logarithms where numbers may have lost a state to underflow.
    """
    if slices.smallest >= TINY:
        with np.errstate(under="ignore"):
            search = Search(slices)
            search.run()
        if min(search.least, slices.smallest) >= TINY:
            return search.lost
    search = Search(slices.within(LOG_SUM_PRODUCT), LOG_SUM_PRODUCT)
    search.run()
    return search.lost


def blank(values: Array, lost: Integers | None, last: int) -> Array:
    """Values (..., [runs]), NaN in runs that are lost at the step `last` or before.

    `last` is the last step whose measurements the values know. `lost` ([runs]) is the step from
    which on each run is lost, T + 1 of one that is not; or None, where no run is lost.
    """
    if lost is None:
        return values
    return np.where(lost <= last, np.nan, values)


def blanked(beliefs: Beliefs, lost: Integers | None, kind: Kind, steps: int) -> Beliefs:
    """Beliefs of a kind by step, with NaN where they know an impossible measurement.

    `beliefs` has one of each step 0..T, (*states, [runs]). A belief is NaN in the runs that are
    lost at the last step whose measurements it knows, or before. `lost` ([runs]) is the step from
    which on each run is lost, T + 1 of one that is not; or None, where no run is lost. `steps` is
    the last step T.
    """
    if lost is None:
        return beliefs
    each: Iterable[Array] = (
        blank(belief, lost, kind.last(step, steps)) for step, belief in enumerate(beliefs)
    )
    if not isinstance(beliefs, np.ndarray):
        return list(each)
    found = np.empty(beliefs.shape)
    for row, belief in zip(found, each, strict=True):
        row[...] = belief
    return found
