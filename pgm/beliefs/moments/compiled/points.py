"""A chain linearised in machine code at beliefs over all its steps, and the costs of their means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pgm.beliefs.moments.compiled.plans import (
    Table,
    Uncompiled,
    motion_of,
    needed,
    places,
    require_affine_prior,
    sensor_of,
    unknown,
)
from pgm.beliefs.moments.compiled.sweep import FAR, lanes_of, run
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels.arrays import Array, vacant
from pgm.kernels.machine import sweeps, told
from pgm.schedules.iteration import Point


class Linearised:
    """A plan whose linearisations machine code finds and keeps.

    An `Uncompiled` says why it cannot.
    """

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
        left = run(self._plan, chain, self._table, ())[sweeps.LEFT] != 0.0
        if left.any():
            self._plan.account.leave(FAR, int(left.sum()))
        return not left.any()
