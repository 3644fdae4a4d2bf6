"""A plan as a table for kernels of Numba's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled.numba_table import (
    Integers64,
    Rows,
    Uncompiled,
    address,
    link_row,
    sensor_row,
    unknown,
)
from pgm.beliefs.moments.compiled.sweep import stretches
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile.machine import Compiled
from pgm.kernels.arrays import Array
from pgm.kernels.compiled import tables as t
from pgm.resources import in_threads

_LINE = 64


class Chain:
    """A plan as a row of integers, the tables it tells of, and room to work in."""

    def __init__(self, plan: ChainPlan, *, rows: Rows | None = None) -> None:
        layout = plan.layout
        self.plan, self.rows = plan, rows or Rows(plan.runs >= t.RUNS)
        self.fields = np.zeros(t.FIELDS, dtype=np.int64)
        self.status = np.zeros(plan.runs, dtype=np.int64)
        self.out: Sequence[Array] = ()
        fields = self.fields
        fields[t.LAST], fields[t.SINGLE] = plan.steps, layout.single
        fields[t.FRONT], fields[t.WIDTH] = layout.state_size, layout.slice_size
        fields[t.STATES] = self.rows.places(layout.state_places, layout.slice_size)
        fields[t.STATUS], fields[t.RUN_COUNT] = address(self.status), plan.runs

    def lay_out(self, stored: bool, keep: bool) -> None:
        """Lay out the tables of CPDs, `stored` as the plan has them linearised.

        Others are linearised by the sweep, and to `keep` that puts it into the plan.
        """
        plan, rows = self.plan, self.rows
        why = unknown(plan)
        if why is not None:
            raise Uncompiled(why)
        read = plan.read
        links = np.zeros((len(plan.transition), t.COLUMNS), dtype=np.int64)
        sensors = np.zeros((len(read), t.COLUMNS), dtype=np.int64)
        kept = keep and not stored
        for link, row in zip(plan.transition, links, strict=True):
            link_row(plan, link, rows, row, stored=stored)
            if kept:
                _keep(link.family, row, rows)
        for sensor, row in zip(read, sensors, strict=True):
            sensor_row(plan, sensor, rows, row, stored=stored)
            if kept:
                _keep(sensor.family, row, rows)
            if kept and sensor.variable.angles:
                row[t.MOVED : t.MOVED + 4] = rows.told(sensor.moved, 1)
        self.links, self.sensors = links, sensors
        self.fields[t.LINKS], self.fields[t.LINK_COUNT] = rows.at(links), len(links)
        self.fields[t.SENSORS], self.fields[t.SENSOR_COUNT] = rows.at(sensors), len(sensors)

    def put(self, place: int, array: Array) -> None:
        """Lay out an array (steps, runs, ...)."""
        self.fields[place : place + 4] = self.rows.told(array, array.ndim - 2)

    def count(self, left: list[slice], why: str) -> None:
        """Note in the plan's account how a sweep went: the runs that it left, and why."""
        account, runs = self.plan.account, sum(each.stop - each.start for each in left)
        account.compiled += runs < self.plan.runs
        if runs:
            account.leave(why, runs)

    def run(self, kernel: Any) -> list[slice]:
        """Run a kernel on all runs; those that it leaves."""
        from pgm.kernels.compiled import sweeps as s
        from pgm.kernels.compiled.memory import ready

        plan, rows = self.plan, self.rows
        chain, choice = address(self.fields), plan.layout.compiled
        together = plan.runs >= t.RUNS
        lanes, kernel = (t.RUNS, kernel[1]) if together else (1, kernel[0])
        threads = choice.threads if isinstance(choice, Compiled) else 1
        threads = max(min(threads, plan.runs // lanes), 1)
        ready(kernel, "int64(int64,int64,int64,int64)")
        size = s.room(
            plan.layout.slice_size, plan.layout.state_size, rows.height, rows.points, lanes
        )

        def work(first: int, last: int) -> None:
            # Large pages of fresh memory are cleared once, each by one thread.
            for array in self.out if threads > 1 else ():
                begin, end = (runs * len(array) // plan.runs for runs in (first, last))
                array[begin:end, first:last:512] = 0.0
            room = np.empty(size + _LINE)
            kernel(chain, first, last, -(-address(room) // _LINE) * _LINE)  # a line of the cache

        in_threads(work, plan.runs, threads)
        return stretches(self.status != t.DONE)


def _keep(family: Any, row: Integers64, rows: Rows) -> None:
    """Tell where a CPD keeps how it is linearised."""
    if family.template is None:
        return
    row[t.MATRIX : t.MATRIX + 4] = rows.told(family.matrix, 2)
    row[t.OFFSET : t.OFFSET + 4] = rows.told(family.offset, 1)
    if row[t.KIND] == t.REGRESSION:
        family.keep_errors()
        row[t.KEPT_NOISE : t.KEPT_NOISE + 4] = rows.told(family.noise, 2)
