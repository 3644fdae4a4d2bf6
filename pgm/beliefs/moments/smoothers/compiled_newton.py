"""Gauss–Newton steps of a plan in machine code."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled.named_table import NamedTable
from pgm.beliefs.moments.compiled.rows import places, row_of
from pgm.beliefs.moments.compiled.table import Integers64, Table
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled, unknown
from pgm.beliefs.moments.passes.backward import Beliefs
from pgm.beliefs.moments.passes.newton import Means, precision
from pgm.beliefs.moments.steps.account import Account
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile.machine import Compiled
from pgm.factors.scope import dimension
from pgm.kernels import moments
from pgm.kernels.arrays import Array, Mask, address, apply, block, independent, room, variances
from pgm.kernels.machine.newton import problem
from pgm.kernels.machine.newton import steps as newton
from pgm.kernels.machine.newton.equations import Layout
from pgm.kernels.machine.newton.squares import is_small
from pgm.kernels.machine.sweeps import told
from pgm.linearisation.family import Family
from pgm.resources import in_threads
from pgm.schedules.iteration import Anchor, Point

# Rows that are linearised together.
_LANES = 8
# The parts of a standard deviation to which means and standard deviations of normal equations are
# those of passes, where the equations have digits enough.
_CLOSE, _ALIKE = 1e-7, 3e-9


class Equations:
    """The Gauss–Newton step of a plan, written: its code, and the table that the code reads.

    It is `Uncompiled` where a noise is singular or only general kernels know a part of it. Linear
    CPDs apart, the plan gets new arrays for linearisations, unless it `has_lines` where they are to
    lie. `owners` are those of the arrays that vary.
    """

    def __init__(
        self, plan: ChainPlan, owners: Sequence[Any] | None = None, *, has_lines: bool = False
    ) -> None:
        why = unknown(plan)
        if why is not None:
            raise Uncompiled(why)
        for sensor in plan.robust:
            raise Uncompiled(f"{sensor.family.cpd!r} has robust noise")
        layout = plan.layout
        width, states = layout.slice_size, np.arange(layout.slice_size)[layout.state_places]
        self.steps, self.runs, self.width = plan.steps, plan.runs, width
        self.controls, self.pair = layout.control_places, layout.state_size + width
        choice = layout.compiled
        threads = choice.threads if isinstance(choice, Compiled) else 1
        self.threads = max(min(threads, plan.runs), 1)
        self.mean, cov = MomentChain(plan, None).start().by_run
        self.slice = Layout(width)
        self.begin = np.zeros((1, plan.runs, self.slice.length))
        self.first = self.begin[0, :, : self.slice.across].reshape(plan.runs, width, -1)
        self.first = self.first[..., :width]
        self.first[:] = np.eye(width)  # of controls at step 0, which are zero
        self.first[:, states[:, None], states] = _weight(block(cov, states, states))
        if owners is None:
            owners = [*(link.family for link in plan.transition)]
            owners += [each for sensor in plan.read for each in (sensor.family, sensor)]
        self.table = table = _Table(plan, owners)
        if not has_lines:
            for family, components in _squared(plan):
                _give_lines(family, components)
        squares = [_measured(plan, sensor, table) for sensor in plan.read]
        squares += [_moved(plan, link, table) for link in plan.transition]
        along = np.empty((3, plan.runs, plan.steps + 1, width))
        trajectories = [table.trajectory(each) for each in along]
        self.chain = problem.Newton(
            size=width,
            rows=tuple(squares),
            active=Table.array(table, np.ones((1, plan.runs, 1))),
            begin=Table.array(table, self.begin),
            reference=trajectories[0],
            found=trajectories[1],
            variance=trajectories[2],
        )
        self.step = newton.made(self.chain)


class Newton:
    """A plan as a problem of Gauss–Newton steps, which keeps how it is linearised.

    The `numbers` are those of the table of its equations, with addresses of the plan's arrays; the
    account counts the steps. A step that has no solution is `Uncompiled`.
    """

    def __init__(self, equations: Equations, numbers: Integers64, account: Account) -> None:
        self._equations, self._numbers, self._account = equations, numbers, account
        own, runs = equations, equations.runs
        begin = own.begin.copy()
        self._right = begin[0, :, own.slice.right :][:, : own.width]
        self._room, self._turn = np.empty((2, 2, runs, own.steps + 1, own.width)), 0
        self._active, self._ended = np.ones((1, runs, 1)), np.zeros((1, runs))
        self._rooms: list[tuple[Array, Array]] = []
        self._begin = begin  # which owns what the code reads
        for place, array in (
            (own.chain.begin.place, begin),
            (own.chain.active.place, self._active),
            (told.ENDED, self._ended),
        ):
            numbers[place] = address(array)

    def start(self, mean: Array, cov: Array) -> Means:
        """Smoothed means and covariances as a solution, from which to go on."""
        return Means(mean, variances(cov), None, self._equations.pair)

    def linearise(self, at: Point, active: Mask) -> None:
        """Linearise at the next solution, for the runs that are active."""
        self.at, self._active[0, :, 0] = at.mean, active

    def settled(self) -> bool:
        """There are no losses that change."""
        return True

    def solve(self, anchor: Anchor | None = None) -> Means:
        """Linearise, and solve; of runs that are not active there is the solution before."""
        own = self._equations
        self._turn = 1 - self._turn
        found, rest = self._room[self._turn], self._active[0, :, 0] == 0.0
        self._right[:] = apply(own.first, own.mean - self.at[0])
        reference = np.ascontiguousarray(self.at.swapaxes(0, 1))
        trajectories = own.chain.reference, own.chain.found, own.chain.variance
        for array, due in zip(trajectories, (reference, *found), strict=True):
            self._numbers[array.place] = address(due)
        self._ended[:] = 0.0
        in_threads(self._work, own.runs, own.threads)
        self._account.compiled += 1
        if rest.any():
            found[:, rest] = self._room[1 - self._turn][:, rest]
        found[1, :, 0, own.controls] = 0.0
        if self._ended.any() or not np.isfinite(found.sum()):
            raise Uncompiled("its equations have no solution")
        means, variance = found.swapaxes(1, 2)
        return Means(means, variance, None, own.pair)

    def _work(self, first: int, last: int) -> None:
        """Solve for the runs from one to another."""
        own = self._equations
        size = own.slice.length * (own.steps + 1)
        rooms = self._rooms.pop() if self._rooms else (np.empty(own.step.work), np.empty(size))
        own.step.call(address(self._numbers), first, last, *map(address, rooms))
        self._rooms.append(rooms)


def agree(last: Means, found: Beliefs, std: Array) -> bool:
    """Whether a step's solution is that of passes, of these beliefs and standard deviations."""
    off = moments.marginal_error(last.means, found.mean, std)
    spread = moments.marginal_error(last.point.std, std, std)
    return bool(off.max() <= _CLOSE and spread.max() <= _ALIKE)


class _Table(NamedTable):
    """A table whose arrays of CPDs have rows in the place of runs, and runs in that of rows.

    `lanes` is how many rows of the CPD at hand are linearised together.
    """

    def __init__(self, plan: ChainPlan, owners: Sequence[Any]) -> None:
        super().__init__(plan, 1, owners)

    def array(self, array: Array) -> told.Array:
        """An array (rows or 1, runs or 1, own axes), told."""
        return super().array(array.swapaxes(0, 1))

    def trajectory(self, array: Array) -> told.Array:
        """A trajectory (runs, steps, n), told."""
        self.lanes = 1
        return self.array(array)


def _measured(plan: ChainPlan, sensor: Sensor, table: _Table) -> problem.Squares:
    """A sensor's residuals."""
    family, size = sensor.family, plan.layout.slice_size
    found = _squares(family, places(sensor.parents, size), (), table)
    if sensor.taken is None and not family.noisy:
        found["noise"] = table.array(_weight(family.own_noise))
    else:
        found["noise"] = table.of(sensor, lambda own: _weight(own.family.own_noise, own.taken))
    if sensor.bounds != list(range(plan.steps + 2)):
        found["bounds"] = table.at(np.array(sensor.bounds, dtype=np.int64))
        found["steps"] = table.at((family.step - plan.first).astype(np.int64))
    return problem.Squares(
        **found,
        readings=table.of(sensor, attrgetter("marked")),
        moved=table.of(sensor, attrgetter("moved")) if sensor.variable.angles else None,
        missing=sensor.taken is not None,
    )


def _moved(plan: ChainPlan, link: Link, table: _Table) -> problem.Squares:
    """The residuals of a CPD of the transition."""
    layout, family = plan.layout, link.family
    width = layout.slice_size
    pair = np.array([*places(layout.state_places, width), *range(width, 2 * width)])
    parents, child = (tuple(pair[each].tolist()) for each in (link.parents, link.child))
    found = _squares(family, parents, child, table)
    if family.template is None:
        found["angles"] = ()  # of a line no angle is on another branch
    if family.noisy:
        found["noise"] = table.of(family, lambda own: _weight(own.own_noise))
    else:
        found["noise"] = table.array(_weight(family.own_noise))
    return problem.Squares(**found)


def _squared(plan: ChainPlan) -> Iterator[tuple[Family, int]]:
    """The families that are squared, with how many components their residuals are of."""
    for sensor in plan.read:
        yield sensor.family, dimension(sensor.family.hidden)
    for link in plan.transition:
        yield link.family, dimension(link.family.hidden) + link.family.shape[2]


def _give_lines(family: Family, components: int) -> None:
    """Give a family that is not linear arrays for its linearisations, as they are written."""
    rows, runs, height, width = family.shape
    if family.template is None:
        return
    # Rows of numbers side by side, or matrix after matrix.
    make = room if is_small(height, components) else _by_matrix
    family.matrix = make((rows, runs), (height, width))
    family.offset = make((rows, runs), (height,))


def _squares(
    family: Family, parents: tuple[int, ...], child: tuple[int, ...], table: _Table
) -> dict[str, Any]:
    rows, _, height, _ = family.shape
    small = is_small(height, len(parents) + len(child))
    table.lanes = _LANES if small and rows >= _LANES else 1
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
