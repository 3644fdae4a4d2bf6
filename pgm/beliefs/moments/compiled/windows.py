"""The windows of a lag in machine code, which leave what those of the general kernels leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.beliefs.moments.compiled.gates import decided, undecided
from pgm.beliefs.moments.compiled.judged import judge
from pgm.beliefs.moments.compiled.rows import motion_of, needed, places
from pgm.beliefs.moments.compiled.sensors import sensor_of
from pgm.beliefs.moments.compiled.sweep import (
    FAR,
    Swept,
    begun,
    count,
    is_used,
    lanes_of,
    made,
    run,
    settings,
    stretches,
)
from pgm.beliefs.moments.compiled.table import Table
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled, require_affine_prior, unknown
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile.machine import CONTROL, LONG
from pgm.kernels.arrays import Array, stacked
from pgm.kernels.machine.sweeps import chain as sweeps
from pgm.kernels.machine.sweeps import told
from pgm.kernels.machine.sweeps.extent import is_long
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.schedule import FixedLag

Moments = tuple[Array, Array]
# How much longer a step takes than that of a filter, as code takes longer to be made.
_TIMES = 8
# Why a flat prior leaves machine code.
_FLAT = "a flat prior takes twice the digits"


@dataclass(frozen=True, eq=False)
class Room:
    """The arrays that windows fill, (T+1, runs, ...), as of `fixed_lag`."""

    predicted: Moments
    known: Moments
    density: Array
    smoothed: Moments
    newest: Moments
    log_evidence: Array


def slide(plan: ChainPlan, schedule: FixedLag, room: Room) -> Swept | None:
    """Slide a window along a plan; None if it is not compiled.

    The plan keeps the last linearisation of each CPD.
    """
    if not is_used(plan, _TIMES):
        return None
    table = Table(plan, lanes_of(plan))
    try:
        ahead = _ahead(plan, schedule, room, table)
    except Uncompiled as error:
        plan.account.leave(str(error))
        return None
    if is_long(ahead, table.lanes):
        plan.account.leave(LONG)
        return None
    layout, lag = plan.layout, min(schedule.lag, plan.steps)
    record = np.zeros((schedule.iterations + 1, plan.runs))
    table.numbers[told.ITERATIONS], table.numbers[told.LAG] = schedule.iterations, lag
    table.put(told.SETTINGS, settings(schedule))
    table.put(told.RESIDUALS, record)

    def windowed(rows: int, *own: int) -> told.Array:
        return table.array(stacked((rows, plan.runs), own))

    size, pair = layout.slice_size, layout.state_size + layout.slice_size
    spread, joint = needed(ahead.motions, ahead.sensors, len(ahead.states))
    owns = [(size,), (size, size), (pair, pair)][: 1 + spread + joint]
    told_, arrays = table.array, room
    chain = told.Windows(
        ahead=ahead,
        predicted=(told_(arrays.predicted[0]), told_(arrays.predicted[1])),
        known=ahead.known,
        density=ahead.density,
        smoothed=(told_(arrays.smoothed[0]), told_(arrays.smoothed[1])),
        newest=(told_(arrays.newest[0]), told_(arrays.newest[1])),
        log_evidence=told_(arrays.log_evidence),
        point=tuple(windowed(lag + 1, *own) for own in owns),
        joint=windowed(lag + 1, pair, pair) if joint else None,
    )
    ended = run(plan, made(plan, chain), table.whole, table.arrays, ())
    decided(plan, table.record)
    left = stretches(ended[sweeps.LEFT] != 0.0)
    count(plan, left, FAR)
    done = ended[sweeps.LEFT] == 0.0
    for moments in (room.known, room.smoothed):
        judge(plan, moments, room.predicted, done, again=True)
    longest = int(record[-2].max(initial=0.0))
    return Swept(left, list(record[:longest]), record[-1] == 0.0, 0.0)


def _ahead(plan: ChainPlan, schedule: FixedLag, room: Room, table: Table) -> told.Forward:
    """The plan as each of its steps is linearised first."""
    why = unknown(plan)
    if isinstance(schedule.damping, LevenbergMarquardt):
        raise Uncompiled(CONTROL)
    if why is not None:
        raise Uncompiled(why)
    require_affine_prior(plan)
    for link in plan.prior:
        if np.isinf(link.family.own_noise).any():
            raise Uncompiled(_FLAT)
    table.record |= undecided(plan, schedule.gate, stored=False)
    motions = [motion_of(plan, link, table, stored=False, keep=True) for link in plan.transition]
    sensors = [
        sensor_of(plan, sensor, table, stored=False, keep=True, gate=schedule.gate)
        for sensor in plan.read
    ]
    layout, begin = plan.layout, begun(plan, schedule.first, keep=True)
    return told.Forward(
        size=layout.slice_size,
        states=places(layout.state_places, layout.slice_size),
        single=bool(layout.single),
        motions=tuple(motions),
        sensors=tuple(sensors),
        begin=(table.array(begin[0]), table.array(begin[1])),
        predicted=(),
        known=(table.array(room.known[0]), table.array(room.known[1])),
        density=table.array(room.density),
        iterated=False,
    )
