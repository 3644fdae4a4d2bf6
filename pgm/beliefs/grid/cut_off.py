"""Beliefs cut off by windows of active cells, and how much of a belief may be lost thereby.

A belief is carried in a window of cells, which leaves out, along each axis, a share of the
probability below 10⁻¹⁵; and the kernels that move a belief end at 8.5 standard deviations.
Probability beyond is lost, and no later measurement brings it back, however much likelier the
states there have become. The estimates here say when that may matter.

The *bounds* are where the user's grid begins and ends along an axis. An *end* of an axis is the
first or the last cell in use there: a belief is cut off beyond it, unless it is at the bounds.
Marginals are (cells,), one for each axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pgm.beliefs.grid.lattice import Axis
from pgm.kernels.arrays import Array, Integers, Mask

# The share of a belief, along an axis, that may stand outside the window of active cells.
TINY = 1e-15
# An edge with more than this was not cut: the belief ends there.
_TAIL = 1e-13
# So much likelier the last cells at a bound have to become to speak for what is beyond.
_REMARKABLE = 30.0
# Evidence that is less likely than its best by this is compared with that of all cells.
_DOUBT = 20.0


class Cut(NamedTuple):
    """The belief, of all steps, of which the largest share may have been cut off.

    share: The estimated share of the belief that was cut off.
    step: The step of the belief.
    """

    share: float
    step: int


class Tails(NamedTuple):
    """Running estimates, for one run, of the shares of a belief cut off at the ends of the axes.

    At each step `predicted` gives the estimates for the predicted belief; if anything was measured,
    `measured` then gives those for the belief after the measurements. The share cut off beyond an
    end is assumed to grow, with each measurement, by the same factor as the share in the last cells
    within. If the model is true, the product of these factors is a martingale: a share of ε becomes
    one of 10⁻³ with a probability of 10³ε at the most (Ville's inequality). The share that leaves
    the bounds at a step is assumed to grow likewise, but through the measurements of that step
    alone, and counts only where they make the last cells more than 30 times likelier.

    axes: The axes of the lattice.
    share: The shares of the belief estimated to be cut off at the ends of each axis, (axes, 2).
    cells: The indices of the first and the last cell in use along each axis, (axes, 2).
    open: Whether the axis goes on beyond that cell, so that something may be cut off, (axes, 2).
    left: The shares of the belief that have left the bounds at the step, (axes, 2); zero at ends
        that are not at the bounds.
    before: The marginals' shares in the first and the last cell in use, before the measurements of
        the step, (axes, 2).
    after: The shares in the same cells given the step's measurements, (axes, 2); equal to `before`
        until they are taken in.
    """

    axes: tuple[Axis, ...]
    share: Array
    cells: Integers
    open: Mask
    left: Array
    before: Array
    after: Array

    @classmethod
    def begun(cls, axes: Sequence[Axis]) -> Tails:
        """The tails before any step: a share of 10⁻¹⁵ at each end of each axis."""
        ends = len(axes), 2
        none, one = np.zeros(ends), np.ones(ends)
        cells, closed = np.zeros(ends, dtype=np.intp), np.zeros(ends, dtype=bool)
        return cls(tuple(axes), np.full(ends, TINY), cells, closed, none, one, one)

    def at(self, marginals: Sequence[Array], left: float) -> Tails:
        """The tails of a prior, or of an online belief, before the measurements of its step.

        The shares cut off stay as they are. The cells in use, and the belief's shares in the first
        and the last of them, are found anew.

        marginals: The belief's marginals (cells,), one for each axis.
        left: The share of the belief that has left the bounds at its step.
        """
        cells, beyond, gone = self.cells.copy(), self.open.copy(), np.zeros_like(self.left)
        for k, (axis, marginal) in enumerate(zip(self.axes, marginals, strict=True)):
            (used,) = np.nonzero(marginal > TINY / axis.cells * marginal.sum())
            gap = 0
            if axis.angle and used.size:  # the cells in use begin after the widest gap
                gap = (int(np.diff(used, append=used[0] + axis.cells).argmax()) + 1) % used.size
            if used.size:
                cells[k] = used[gap], used[gap - 1]
            if axis.angle:
                beyond[k] = 0 < used.size < axis.cells
            else:
                beyond[k] = cells[k, 0] > 0, cells[k, 1] + 1 < axis.cells
            gone[k] = 0.0 if axis.angle else np.where(beyond[k], 0.0, left)
        waiting = self._replace(cells=cells, open=beyond, left=gone)
        shares = waiting._at(marginals)
        return waiting._replace(before=shares, after=shares)

    def predicted(self, marginals: Sequence[Array], left: float) -> Tails:
        """The tails of a step's predicted belief, before the measurements of the step.

        Where the cell at an end has a share above 10⁻¹³, the belief was not cut there but ends, as
        at a wall; if motion has made that share smaller, the share cut off falls in proportion.

        marginals: The belief's marginals (cells,), one for each axis.
        left: The share of the belief that has left the bounds at its step.
        """
        found = self.at(marginals, left)
        fallen = np.minimum(found.before / np.maximum(self.after, 1e-300), 1.0)
        kept = np.where(found.before > _TAIL, self.share * fallen, self.share)
        return found._replace(share=np.maximum(kept, TINY))

    def measured(self, marginals: Sequence[Array]) -> tuple[Tails, float]:
        """A pair: the tails given the measurements of the step, and the largest share now missing.

        The share that is missing at an end of an axis is that of the belief estimated to be cut off
        there or to have left the bounds; the largest is taken over the ends of all axes.

        marginals: Those (cells,) of the belief given the measurements, one for each axis.
        """
        after = self._at(marginals)
        gain = after / np.maximum(self.before, 1e-300)
        share = np.minimum(self.share * gain, 1.0)
        beyond = np.where(gain > _REMARKABLE, np.minimum(self.left * gain, 1.0), 0.0)
        most = max(float(share.max(initial=0.0, where=self.open)), float(beyond.max()))
        return self._replace(share=share, after=after), most

    def _at(self, marginals: Sequence[Array]) -> Array:
        """The marginals' shares in the first and the last cell in use of each axis, (axes, 2)."""
        return np.array(
            [
                each[cells] / max(float(each.sum()), 1e-300)
                for each, cells in zip(marginals, self.cells, strict=True)
            ]
        )


def doubtful(log_density: float, ceiling: float, components: int) -> bool:
    """Whether measurements are so unlikely that the part cut off might explain them better.

    They are if `log_density` < `ceiling` − max(b/2 − √(2b), 0) − 20, b being the number of
    `components`. If the model is true, half the sum of the squares of b whitened residuals has the
    mean b/2 and the standard deviation √(b/2); b/2 − √(2b) is two deviations below the mean.

    log_density: ln p(measurements of a step | those before).
    ceiling: The logarithm of the density of residuals that are all zero.
    components: How many numbers were measured, b.
    """
    usual = max(0.5 * components - math.sqrt(2.0 * components), 0.0)
    return log_density < ceiling - usual - _DOUBT


def bound(log_density: float, best: float) -> float:
    """An upper bound on the share that a step's measurements give to states cut off before them.

    These states had a share of 10⁻¹⁵, and may explain the measurements as well as the best cell
    does. The bound is thus 10⁻¹⁵ exp(`best` − `log_density`), and 1 at the most.

    log_density: ln p(measurements | those before), under the belief without what was cut off.
    best: The largest log-density of the measurements at any cell.
    """
    return math.exp(min(math.log(TINY) + best - log_density, 0.0))
