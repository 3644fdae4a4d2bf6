"""The sweeps of a bound call forward and back, and what of their ends is in doubt."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.bound.call import Made
from pgm.beliefs.moments.bound.room import Room
from pgm.beliefs.moments.bound.tables import Tables
from pgm.beliefs.moments.compiled import sweep
from pgm.beliefs.moments.compiled.named_table import NamedTable
from pgm.beliefs.moments.digits.certificate import MODERATE
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels.arrays import Array, address
from pgm.kernels.machine.sweeps import chain as sweeps
from pgm.kernels.machine.sweeps import told

# What is looked at of all that a sweep forward tells.
_TOLD = sweeps.LEFT, sweeps.CLOSEST, sweeps.FAR, sweeps.LOST


class Went(NamedTuple):
    """How the sweeps of a call went; `closest` and `held` are as of `Forward`."""

    closest: float
    held: bool


class Passes:
    """The sweeps of a room's arrays, whose tables are added to those of a call.

    With `stored` linearisations the sweep forward takes those that the plan has.
    """

    def __init__(self, plan: ChainPlan, room: Room, tables: Tables, *, stored: bool) -> None:
        self._room, self._runs = room, plan.runs
        *_, moved, record, ahead = owners = tables.owners
        schedule, back, keep = room.sweeps
        lanes = sweep.lanes_of(plan)

        def add(table: NamedTable, ended: Array) -> int:
            table.numbers[told.ITERATIONS] = schedule.iterations
            table.numbers[told.ENDED] = address(ended)
            return tables.add(table)

        table = NamedTable(plan, lanes, owners, record)
        cpds = {"stored": stored, "keep": keep and not stored, "controlled": False}
        gate = None if stored else schedule.gate
        self._ahead = sweeps.made(sweep.told_ahead(plan, table, (), **cpds, gate=gate), lanes)
        self._first = add(table, record["ended"])
        if back:
            table = NamedTable(plan, lanes, owners, record)
            self._behind = sweeps.made(sweep.told_back(plan, table, ahead, moved, record), lanes)
            self._second = add(table, record["ended back"])

    def run(self, made: Made, table: int) -> Went | None:
        """Sweep the arrays of a call, whose numbers begin at an address.

        None where something is in doubt.
        """
        room, blocks, runs = self._room, made.blocks, self._runs
        self._ahead(table + 8 * self._first, 0, runs)
        ended = room.ended[0].numbers(blocks)
        left, closest, far, lost = (ended[k * runs : (k + 1) * runs] for k in _TOLD)
        least = min(closest)
        if any(left) or any(far) or not least * MODERATE > 1.0:
            return None
        if room.sweeps.back:
            self._behind(table + 8 * self._second, 0, runs)
            ended = room.ended[1].numbers(blocks)
            kept = ended[runs * sweeps.KEPT : runs * (sweeps.KEPT + 1)]
            if any(ended[:runs]) or not all(kept):
                return None
        elif not np.isfinite(blocks[1].sum() + blocks[2].sum()):
            return None
        return Went(least, not any(lost))
