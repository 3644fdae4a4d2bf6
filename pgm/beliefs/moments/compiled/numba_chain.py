"""A plan as a table for kernels of Numba's."""

from __future__ import annotations

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
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels.compiled import tables as t


class Chain:
    """A plan as a row of integers, the tables it tells of, and room to work in."""

    def __init__(self, plan: ChainPlan) -> None:
        layout = plan.layout
        self.plan, self.rows = plan, Rows(plan.runs >= t.RUNS)
        self.fields = np.zeros(t.FIELDS, dtype=np.int64)
        self.status = np.zeros(plan.runs, dtype=np.int64)
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


def _keep(family: Any, row: Integers64, rows: Rows) -> None:
    """Tell where a CPD keeps how it is linearised."""
    if family.template is None:
        return
    row[t.MATRIX : t.MATRIX + 4] = rows.told(family.matrix, 2)
    row[t.OFFSET : t.OFFSET + 4] = rows.told(family.offset, 1)
    if row[t.KIND] == t.REGRESSION:
        family.keep_errors()
        row[t.KEPT_NOISE : t.KEPT_NOISE + 4] = rows.told(family.noise, 2)
