"""Gauss–Newton steps of a plan in machine code."""

from __future__ import annotations

import numpy as np

from pgm.beliefs.moments.compiled.numba_chain import Chain
from pgm.beliefs.moments.compiled.numba_table import Integers64, Rows, Uncompiled, address, at_least
from pgm.beliefs.moments.passes.newton import Means, precision
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels.arrays import Array, Integers, Mask, apply, block, independent, room
from pgm.kernels.compiled import tables as t
from pgm.linearisation.family import Family
from pgm.schedules.iteration import Anchor, Point


class Newton:
    """A plan as a problem of Gauss–Newton steps, which keeps how it is linearised.

    It is `Uncompiled` where a noise is singular or only general kernels know a part of it; and so
    is a step that has no solution.
    """

    def __init__(self, plan: ChainPlan) -> None:
        layout, steps = plan.layout, plan.steps
        width, states = layout.slice_size, np.arange(layout.slice_size)[layout.state_places]
        self.pair = layout.state_size + width
        self.chain = chain = Chain(plan, rows=Rows(together=True, least=t.RUNS))
        chain.lay_out(False, False)
        self.mean, cov = MomentChain(plan, None).start().by_run
        begin = np.zeros((plan.runs, 2 * width, _padded(width + 1)))
        self.first, self.right = begin[:, :width, :width], begin[:, :width, width]
        self.first[:] = np.eye(width)  # of controls at step 0, which are zero
        self.first[:, states[:, None], states] = _weight(block(cov, states, states))
        self._put(t.BEGIN, begin)
        # Room for each thread, by the share of runs that lie before its first.
        threads = getattr(layout.compiled, "threads", 1)
        self.equations = np.empty((threads + 1, steps + 2, begin[0].size))
        self._put(t.EQUATIONS, self.equations)
        chain.fields[t.THREADS] = threads
        here, later = np.arange(width), np.arange(width, 2 * width)
        pair, table = np.concatenate([states, later]), np.concatenate([chain.sensors, chain.links])
        for sensor, row in zip(plan.read, table, strict=False):
            if sensor.variable.angles:
                moved = at_least(sensor.moved, t.RUNS)
                sensor.moved = moved[: len(sensor.moved)]
                row[t.MOVED : t.MOVED + 4] = chain.rows.told(moved, 1)
            weight = _weight(sensor.family.own_noise, sensor.taken)
            self._tell(row, sensor.family, plan.first, here[sensor.parents], weight)
        for link, row in zip(plan.transition, table[len(plan.read) :], strict=True):
            row[t.STEPS] = chain.rows.at(np.minimum(np.arange(steps + 2), steps))
            places = np.concatenate([pair[link.parents], pair[link.child]])
            self._tell(row, link.family, plan.first + 1, places, _weight(link.family.own_noise))
        chain.fields[t.SENSORS], chain.fields[t.SENSOR_COUNT] = chain.rows.at(table), len(table)
        self.room, self.turn = np.empty((2, 2, plan.runs, steps + 1, width)), 0

    def _put(self, place: int, array: Array) -> None:
        """Tell an array (runs, ...), which is not kept."""
        self.chain.fields[[place, place + 2]] = address(array), array[0].size

    def _tell(
        self, row: Integers64, family: Family, first: int, places: Integers, weight: Array
    ) -> None:
        """Tell of a CPD what sweeps do not know, or know otherwise."""
        rows, width, count = self.chain.rows, self.chain.plan.layout.slice_size, family.step.size
        row[t.PARENTS], row[t.ROWS] = rows.at(places), max(count, t.RUNS)
        row[t.STEP] = rows.at(at_least(family.step - first, t.RUNS))
        row[t.TARGETS] = rows.at(_targets(places, width))
        row[t.NOISE : t.NOISE + 4] = rows.told(weight, 2)
        if family.template is not None:
            lead, own = (max(count, t.RUNS), family.shape[1]), family.shape[2:]
            matrix, offset = room(lead, own), room(lead, own[:1])
            family.matrix, family.offset = matrix[:count], offset[:count]
            row[t.MATRIX : t.MATRIX + 4] = rows.told(matrix, 2)
            row[t.OFFSET : t.OFFSET + 4] = rows.told(offset, 1)
        for place in (t.INPUTS, t.MATRIX, t.OFFSET, t.NOISE, t.READINGS, t.MOVED):
            row[place + 1], row[place + 2] = row[place + 2], row[place + 1]

    def linearise(self, at: Point, active: Mask) -> None:
        """Linearise at the next solution, for the runs that are active."""
        self.at, self.active = at.mean, active

    def settled(self) -> bool:
        """There are no losses that change."""
        return True

    def solve(self, anchor: Anchor | None = None) -> Means:
        """Linearise, and solve; of runs that are not active there is the solution before."""
        from pgm.kernels.compiled.newton import newton  # here, since Numba is slow to import

        chain = self.chain
        self.turn = 1 - self.turn
        found, rest = self.room[self.turn], ~self.active
        self.right[:] = apply(self.first, self.mean - self.at[0])
        reference = np.ascontiguousarray(self.at.swapaxes(0, 1))
        self._put(t.REFERENCE, reference)
        self._put(t.FOUND, found[0])
        self._put(t.VARIANCE, found[1])
        chain.status[:] = np.where(rest, t.IDLE, t.DONE)
        chain.run((newton, newton))
        chain.count([], "")
        found[:, rest] = self.room[1 - self.turn][:, rest]
        found[1, :, 0, chain.plan.layout.control_places] = 0.0
        if (chain.status == t.LEFT).any() or not np.isfinite(found.sum()):
            raise Uncompiled("its equations have no solution")
        means, variance = found.swapaxes(1, 2)
        return Means(means, variance, None, self.pair)


def _padded(columns: int) -> int:
    return -(-columns // 4) * 4


def _weight(noise: Array, taken: Mask | None = None) -> Array:
    """The inverse of a noise, zero where components are missing."""
    found = precision(noise if taken is None else independent(noise, taken))
    if found is None:
        raise Uncompiled("a noise is singular")
    return found if taken is None else found * (taken[..., None] & taken[..., None, :])


def _targets(places: Integers, width: int) -> Integers:
    """Where squares of components of a slice and the next, (n, n), and right sides behind go."""
    wide, count = _padded(width + 1), len(places)
    first, last = np.minimum.outer(places, places), np.maximum.outer(places, places)
    part = first // width + last // width
    square = (part * width + first % width) * wide + last % width
    right = (2 * (places // width) * width + places % width) * wide + width
    upper = np.flatnonzero(np.triu(np.ones((count, count))))
    found = np.concatenate([square.ravel()[upper], right])
    return np.stack([found, [*upper, *range(count**2, count * (count + 1))]], axis=-1)
