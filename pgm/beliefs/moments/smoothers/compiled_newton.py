"""Gauss–Newton steps of a plan in machine code."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled.rows import places, row_of
from pgm.beliefs.moments.compiled.table import Table
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled, unknown
from pgm.beliefs.moments.passes.newton import Means, precision
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile.machine import Compiled
from pgm.kernels.arrays import Array, Mask, address, apply, block, independent, room
from pgm.kernels.machine.newton import steps as newton
from pgm.kernels.machine.newton.equations import Layout
from pgm.kernels.machine.newton.squares import is_small
from pgm.kernels.machine.sweeps import told
from pgm.linearisation.family import Family
from pgm.resources import in_threads
from pgm.schedules.iteration import Anchor, Point

# Rows that are linearised together.
_LANES = 8


class Newton:
    """A plan as a problem of Gauss–Newton steps, which keeps how it is linearised.

    It is `Uncompiled` where a noise is singular or only general kernels know a part of it; and so
    is a step that has no solution.
    """

    def __init__(self, plan: ChainPlan) -> None:
        why = unknown(plan)
        if why is not None:
            raise Uncompiled(why)
        for sensor in plan.robust:
            raise Uncompiled(f"{sensor.family.cpd!r} has robust noise")
        layout, steps = plan.layout, plan.steps
        width, states = layout.slice_size, np.arange(layout.slice_size)[layout.state_places]
        self.plan, self.pair = plan, layout.state_size + width
        self.mean, cov = MomentChain(plan, None).start().by_run
        self._slice = Layout(width)
        begin = np.zeros((1, plan.runs, self._slice.length))
        own = begin[0, :, : self._slice.across].reshape(plan.runs, width, -1)[..., :width]
        own[:] = np.eye(width)  # of controls at step 0, which are zero
        own[:, states[:, None], states] = _weight(block(cov, states, states))
        self.first = own
        self.right = begin[0, :, self._slice.right :][:, :width]
        self.room, self.turn = np.empty((2, 2, plan.runs, steps + 1, width)), 0
        self.active = np.ones((1, plan.runs, 1))
        self.table = table = _Table(plan)
        squares = [_measured(plan, sensor, table) for sensor in plan.read]
        squares += [_moved(plan, link, table) for link in plan.transition]
        along = [table.trajectory(each) for each in (self.room[0, 0], *self.room[0])]
        self.chain = told.Newton(
            size=width,
            rows=tuple(squares),
            active=Table.array(table, self.active),
            begin=Table.array(table, begin),
            reference=along[0],
            found=along[1],
            variance=along[2],
        )
        self.step = newton.made(self.chain)
        self._rooms: list[tuple[Array, Array]] = []

    def linearise(self, at: Point, active: Mask) -> None:
        """Linearise at the next solution, for the runs that are active."""
        self.at, self.active[0, :, 0] = at.mean, active

    def settled(self) -> bool:
        """There are no losses that change."""
        return True

    def solve(self, anchor: Anchor | None = None) -> Means:
        """Linearise, and solve; of runs that are not active there is the solution before."""
        plan, chain, table = self.plan, self.chain, self.table
        self.turn = 1 - self.turn
        found, rest = self.room[self.turn], self.active[0, :, 0] == 0.0
        self.right[:] = apply(self.first, self.mean - self.at[0])
        reference = np.ascontiguousarray(self.at.swapaxes(0, 1))
        trajectories = chain.reference, chain.found, chain.variance
        for array, due in zip(trajectories, (reference, *found), strict=True):
            table.put(array.place, due)
        ended = np.zeros((1, plan.runs))
        table.put(told.ENDED, ended)
        self._run(table.whole)
        plan.account.compiled += 1
        found[:, rest] = self.room[1 - self.turn][:, rest]
        found[1, :, 0, plan.layout.control_places] = 0.0
        if ended.any() or not np.isfinite(found.sum()):
            raise Uncompiled("its equations have no solution")
        means, variance = found.swapaxes(1, 2)
        return Means(means, variance, None, self.pair)

    def _run(self, table: Any) -> None:
        choice = self.plan.layout.compiled
        threads = choice.threads if isinstance(choice, Compiled) else 1
        size = self._slice.length * (self.plan.steps + 1)

        def work(first: int, last: int) -> None:
            rooms = self._rooms.pop() if self._rooms else (np.empty(self.step.work), np.empty(size))
            self.step.call(address(table), first, last, *map(address, rooms))
            self._rooms.append(rooms)

        in_threads(work, self.plan.runs, max(min(threads, self.plan.runs), 1))


class _Table(Table):
    """A table whose arrays of CPDs have rows in the place of runs, and runs in that of rows.

    `lanes` is how many rows of the CPD at hand are linearised together.
    """

    def __init__(self, plan: ChainPlan) -> None:
        super().__init__(plan, 1)

    def array(self, array: Array) -> told.Array:
        """An array (rows or 1, runs or 1, own axes), told."""
        return super().array(array.swapaxes(0, 1))

    def trajectory(self, array: Array) -> told.Array:
        """A trajectory (runs, steps, n), told."""
        self.lanes = 1
        return self.array(array)


def _measured(plan: ChainPlan, sensor: Sensor, table: _Table) -> told.Squares:
    """A sensor's residuals."""
    family, size = sensor.family, plan.layout.slice_size
    found = _squares(family, places(sensor.parents, size), (), table)
    found["noise"] = table.array(_weight(family.own_noise, sensor.taken))
    values = sensor.values
    if sensor.taken is not None:
        values = np.where(sensor.taken, values, np.nan)
    if sensor.bounds != list(range(plan.steps + 2)):
        found["bounds"] = table.at(np.array(sensor.bounds, dtype=np.int64))
        found["steps"] = table.at((family.step - plan.first).astype(np.int64))
    return told.Squares(
        **found,
        readings=table.array(values),
        moved=table.array(sensor.moved) if sensor.variable.angles else None,
        missing=sensor.taken is not None,
    )


def _moved(plan: ChainPlan, link: Link, table: _Table) -> told.Squares:
    """The residuals of a CPD of the transition."""
    layout, family = plan.layout, link.family
    width = layout.slice_size
    pair = np.array([*places(layout.state_places, width), *range(width, 2 * width)])
    parents, child = (tuple(pair[each].tolist()) for each in (link.parents, link.child))
    found = _squares(family, parents, child, table)
    if family.template is None:
        found["angles"] = ()  # of a line no angle is on another branch
    found["noise"] = table.array(_weight(family.own_noise))
    return told.Squares(**found)


def _squares(
    family: Family, parents: tuple[int, ...], child: tuple[int, ...], table: _Table
) -> dict[str, Any]:
    rows, runs, height, width = family.shape
    small = is_small(height, len(parents) + len(child))
    table.lanes = _LANES if small and rows >= _LANES else 1
    if family.template is not None:
        # As it is written: rows of numbers side by side, or matrix after matrix.
        make = room if small else _by_matrix
        family.matrix = make((rows, runs), (height, width))
        family.offset = make((rows, runs), (height,))
    found = row_of(family, parents, table, stored=False, keep=True)
    return {**found, "child": child, "lanes": table.lanes, "count": table.count(rows)}


def _by_matrix(lead: tuple[int, ...], own: tuple[int, ...]) -> Array:
    return np.empty((*lead, *own))


def _weight(noise: Array, taken: Mask | None = None) -> Array:
    """The inverse of a noise, zero where components are missing."""
    found = precision(noise if taken is None else independent(noise, taken))
    if found is None:
        raise Uncompiled("a noise is singular")
    return found if taken is None else found * (taken[..., None] & taken[..., None, :])
