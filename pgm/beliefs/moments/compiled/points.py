"""A chain linearised in machine code at beliefs over all steps, and the costs of their means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pgm.beliefs.moments.compiled.rows import motion_of, needed, places
from pgm.beliefs.moments.compiled.sensors import sensor_of
from pgm.beliefs.moments.compiled.sweep import FAR, lanes_of, made, run
from pgm.beliefs.moments.compiled.table import Table
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled, require_affine_prior, unknown
from pgm.beliefs.moments.steps import cost
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels.arrays import Array, Mask, vacant
from pgm.kernels.machine.sweeps import chain as sweeps
from pgm.kernels.machine.sweeps import told
from pgm.schedules.iteration import Point


class Linearised:
    """A plan whose linearisations machine code finds, and keeps in the plan's arrays.

    An `Uncompiled` says why it cannot. What it is not sure of is left to NumPy.
    """

    def __init__(self, plan: ChainPlan) -> None:
        self._plan = plan
        self._bound: _Bound | None = _Bound(plan)
        self._known: Point | None = None

    def linearise(self, at: Point, active: Mask | None) -> bool:
        """Linearise at a point, and weigh robust sightings there; False where that is not sure.

        Runs that are not `active` (runs,) keep their linearisations; None means all.
        """
        if active is not None and self._known is not None:
            at = _where(active, at, self._known)
        self._known = at
        return self._there.linearise(at)

    def cost(self, at: Point) -> Array | None:
        """The cost of a trajectory, the means of a point, (runs,); None where it is not sure."""
        found = self._there.cost(at)
        return None if found is None else found + cost.prior(self._plan, at)

    def rebind(self) -> None:
        """Note that the plan has other arrays than it had, or takes other measurements."""
        self._bound = None

    @property
    def _there(self) -> _Bound:
        if self._bound is None:
            self._bound = _Bound(self._plan)
        return self._bound


class _Bound:
    """Machine code, bound to the arrays that a plan has."""

    def __init__(self, plan: ChainPlan) -> None:
        why = unknown(plan)
        if why is not None:
            raise Uncompiled(why)
        require_affine_prior(plan)
        self._plan, self._table = plan, Table(plan, lanes_of(plan))
        layout, table = plan.layout, self._table
        cpds = {"stored": False, "keep": True}
        motions = tuple(motion_of(plan, link, table, **cpds) for link in plan.transition)
        sensors = tuple(sensor_of(plan, sensor, table, **cpds) for sensor in plan.read)
        spread, joint = needed(motions, sensors, layout.state_size)
        size, pair = layout.slice_size, layout.state_size + layout.slice_size
        owns = [(size,), (size, size), (pair, pair)][: 1 + spread + joint]
        steps = plan.steps + 1
        self._point = [vacant((steps - (k == 2), plan.runs), own) for k, own in enumerate(owns)]
        self._cost = np.zeros((1, plan.runs))
        self._linearise = told.Linearised(
            states=places(layout.state_places, size),
            motions=motions,
            sensors=sensors,
            point=tuple(map(table.array, self._point)),
        )
        self._costs = replace(self._linearise, cost=table.array(self._cost))

    def linearise(self, at: Point) -> bool:
        """Linearise at a point; whether all of it is right, so far as can be told."""
        return self._run(self._linearise, at)

    def cost(self, at: Point) -> Array | None:
        """The cost of a point, (runs,), without the prior's; None where that is not sure."""
        return self._cost[0].copy() if self._run(self._costs, at) else None

    def _run(self, chain: told.Linearised, at: Point) -> bool:
        for mine, its in zip(self._point, (at.mean, at.cov, at.joint), strict=False):
            mine[...] = its
        sweep, table = made(self._plan, chain), self._table
        left = run(self._plan, sweep, table.whole, table.arrays, ())[sweeps.LEFT] != 0.0
        if left.any():
            self._plan.account.leave(FAR, int(left.sum()))
        return not left.any()


def _where(active: Mask, one: Point, other: Point) -> Point:
    """One point in active runs, and another in the others."""

    def chosen(a: Array, b: Array) -> Array:
        return np.where(active.reshape(-1, *(1,) * (a.ndim - 2)), a, b)

    joint = one.joint
    if joint is not None and other.joint is not None:
        joint = chosen(joint, other.joint)
    return Point(chosen(one.mean, other.mean), chosen(one.cov, other.cov), joint)
