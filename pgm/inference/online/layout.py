"""A step of an online filter as a table of integers, whose inputs go where its chain reads them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import accumulate
from math import prod
from typing import Any

import numpy as np

from pgm.cpds import AffineCPD
from pgm.inference.chain.compiled.table import (
    Integers64,
    Rows,
    Uncompiled,
    link_row,
    require_compiled,
    sensor_row,
)
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.family import Family
from pgm.inference.online.step_evidence import places
from pgm.kernels.arrays import Array
from pgm.kernels.compiled import tables as t
from pgm.variables import Variable

Shapes = tuple[tuple[int, ...], ...]


class Layout:
    """A plan of one step, of a transition or of measurements, for values in arrays of these shapes.

    `packed` says whether a kernel gets them in one row; `step` is the address of it all, which the
    layout keeps.
    """

    def __init__(
        self,
        plan: ChainPlan,
        values: Mapping[Variable, Any],
        shapes: Shapes,
        *,
        packed: bool,
    ) -> None:
        from pgm.kernels.compiled import online as o

        self._rows, self._where = Rows(), places(values)
        starts = [*accumulate(map(prod, shapes), initial=0)][:-1]
        self._order = starts if packed else list(range(len(shapes)))
        self._parts: list[list[int]] = []
        self._shifts: list[list[int]] = []
        require_compiled(plan)
        step = np.zeros(o.STEP, dtype=np.int64)
        step[o.CHAIN], step[o.MEMORY] = self._chain(plan)
        if {part[o.ORDER] for part in self._parts} != set(self._order):
            raise Uncompiled("something that is given is read by no function")
        step[o.PACKED] = packed
        for table, place in ((self._parts, o.PARTS), (self._shifts, o.SHIFTS)):
            step[place] = self._rows.at(np.array(table, dtype=np.int64))
            step[place + 1] = len(table)
        self.step = self._rows.at(step)

    def _chain(self, plan: ChainPlan) -> tuple[int, int]:
        """The addresses of the chain and of room to work in."""
        from pgm.kernels.compiled import sweeps as s

        rows, layout = self._rows, plan.layout
        fields = np.zeros(t.FIELDS, dtype=np.int64)
        fields[t.SINGLE], fields[t.LAST] = layout.single, plan.steps
        fields[t.FRONT], fields[t.WIDTH] = layout.state_size, layout.slice_size
        fields[t.STATES] = rows.places(layout.state_places, layout.slice_size)
        links = plan.transition if plan.steps else []
        table = np.zeros((len(links), t.COLUMNS), dtype=np.int64)
        for link, row in zip(links, table, strict=True):
            link_row(plan, link, rows, row, stored=False)
            self._inputs(link.family, row, 1, None)
        fields[t.LINKS], fields[t.LINK_COUNT] = rows.at(table), len(table)
        table = np.zeros((len(plan.read), t.COLUMNS), dtype=np.int64)
        for sensor, row in zip(plan.read, table, strict=True):
            sensor_row(plan, sensor, rows, row, stored=False)
            self._inputs(sensor.family, row, len(sensor.values), sensor.variable)
        fields[t.SENSORS], fields[t.SENSOR_COUNT] = rows.at(table), len(table)
        room = s.room(layout.slice_size, layout.state_size, rows.height, rows.points)
        return rows.at(fields), rows.at(np.zeros(room))

    def _inputs(self, family: Family, row: Integers64, count: int, sensor: Variable | None) -> None:
        """Where a CPD reads its inputs, and measurements, in arrays of its own."""
        if family.noisy:
            raise Uncompiled(f"{family.cpd!r} has a noise that depends on inputs")
        cpd, end = family.cpd, 0
        parents = [parent for parent in cpd.given if parent in family.inputs]
        known = np.zeros((count, sum(parent.dimension for parent in parents)))
        row[t.INPUTS : t.INPUTS + 4] = self._rows.told(known[:, None], 1)
        for parent in parents:
            begin, end = end, end + parent.dimension
            own = sensor is not None and (sensor, parent) in self._where
            place = self._where[sensor if own else None, parent]
            self._part(place, known[:, begin:end], shared=not own)
        if isinstance(cpd, AffineCPD) and parents:
            shift = np.zeros((count, cpd.child.dimension))
            row[t.OFFSET : t.OFFSET + 4] = self._rows.told(shift[:, None], 1)
            matrix = np.concatenate([cpd.matrices[parent] for parent in parents], axis=1)
            parts = shift, np.ascontiguousarray(cpd.offset), matrix, known
            self._shifts.append([*map(self._rows.at, parts), *matrix.shape, count])
        if sensor is not None:
            values = np.zeros((count, sensor.dimension))
            row[t.READINGS : t.READINGS + 4] = self._rows.told(values[:, None], 1)
            self._part(self._where[None, sensor], values, shared=False, missing=True)

    def _part(self, place: int, target: Array, *, shared: bool, missing: bool = False) -> None:
        """An array that is given, and the rows that it goes to."""
        count, width = target.shape
        rows = 1 if shared else count
        told = self._rows.at(target), target.strides[0] // 8, count, missing
        self._parts.append([self._order[place], rows, width, *told])
