"""Plans of chains, as machine code is told of them: its key, and its table."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.compiled.functions import function_of, points_of
from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile.machine import GATE, MOST
from pgm.kernels.arrays import Array, Index
from pgm.kernels.machine import told
from pgm.kernels.machine.memory import Runs
from pgm.linearisation.family import Family

Integers64 = npt.NDArray[np.int64]


class Uncompiled(Exception):
    """A plan that machine code cannot sweep, and why."""


def address(array: npt.NDArray[Any]) -> int:
    """Where an array's memory begins."""
    found: int = array.__array_interface__["data"][0]
    return found


class Table:
    """A table that is filled, and the arrays that it tells of, which stay in memory as it does.

    `lanes` is how many runs are swept together.
    """

    def __init__(self, plan: ChainPlan, lanes: int) -> None:
        self.lanes = lanes
        self.numbers = [0] * told.FIRST
        self.numbers[told.LAST], self.numbers[told.RUNS] = plan.steps, plan.runs
        self._kept: list[object] = []

    def put(self, place: int, array: npt.NDArray[Any]) -> None:
        """Put the address of an array into the table."""
        self._kept.append(array)
        self.numbers[place] = address(array)

    def at(self, array: npt.NDArray[Any]) -> int:
        """The place in the table of the address of an array."""
        self.numbers.append(0)
        self.put(len(self.numbers) - 1, array)
        return len(self.numbers) - 1

    def array(self, array: Array) -> told.Array:
        """An array (rows or 1, runs or 1, own axes), told."""
        inner = [(k, n) for k, n in zip(array.strides[2:], array.shape[2:], strict=True) if n > 1]
        for (outer, _), (stride, size) in pairwise(inner):
            if outer != stride * size:
                return self.array(np.ascontiguousarray(array))
        down, across = (
            0 if n == 1 else k // 8 for k, n in zip(array.strides, array.shape[:2], strict=False)
        )
        cell = inner[-1][0] // 8 if inner else 1
        place = self.at(array)
        self.numbers += [down, across, cell]
        runs = Runs.BESIDE
        if self.lanes > 1 and across != 1:
            runs = Runs.APART if across else Runs.SAME
        return told.Array(place, array.shape[2:], runs, cell == 1)

    def count(self, number: int) -> int:
        """The place in the table of a number."""
        self.numbers.append(number)
        return len(self.numbers) - 1

    @property
    def whole(self) -> Integers64:
        """The table."""
        return np.array(self.numbers, dtype=np.int64)


def places(index: Index, size: int) -> tuple[int, ...]:
    """The places that an index says."""
    return tuple(np.arange(size)[index].tolist())


def unknown(plan: ChainPlan) -> str | None:
    """Why machine code does not know a plan, but for functions that are not linearised yet."""
    for sensor in plan.read:
        if sensor.robust:
            return f"{sensor.family.cpd!r} has robust noise"
        if sensor.gated is not None:
            return GATE
        if sensor.exact:
            return f"{sensor.family.cpd!r} has a singular noise"
        if sensor.grouped and max(np.diff(sensor.bounds)) > 1:
            return f"{sensor.family.cpd!r} has several sightings in a group"
    for family in plan.families:
        if max(family.cpd.child.dimension, family.shape[3]) > MOST:
            return f"{family.cpd!r} has more than {MOST} components"
    return None


def motion_of(
    plan: ChainPlan, link: Link, table: Table, *, stored: bool, keep: bool
) -> told.Motion:
    """A CPD of the transition."""
    layout, family = plan.layout, link.family
    size, turning = layout.state_size + layout.slice_size, ()
    if link.turning and not stored:
        own = places(link.parents, size)
        if any(before not in own for before in link.before.tolist()):
            raise Uncompiled(f"{family.cpd!r} turns an angle of which its function does not know")
        turning = tuple((new, before, own.index(before)) for new, before in link.turning)
    return told.Motion(
        **row_of(family, places(link.parents, size), table, stored=stored, keep=keep),
        bare=family.bare,
        unsure=not family.semidefinite,
        turning=turning,
    )


def sensor_of(
    plan: ChainPlan, sensor: Sensor, table: Table, *, stored: bool, keep: bool
) -> told.Sensor:
    """A sensor with its measurements."""
    family, size = sensor.family, plan.layout.slice_size
    values = sensor.moved if stored else sensor.values
    if sensor.taken is not None:
        values = np.where(sensor.taken, values, np.nan)
    single = sensor.bounds == list(range(plan.steps + 2))
    kept = keep and not stored and bool(sensor.variable.angles)
    return told.Sensor(
        **row_of(family, places(sensor.parents, size), table, stored=stored, keep=keep),
        readings=table.array(values),
        moved=table.array(sensor.moved) if kept else None,
        missing=sensor.taken is not None,
        bounds=None if single else table.at(np.array(sensor.bounds, dtype=np.int64)),
    )


def row_of(
    family: Family, parents: tuple[int, ...], table: Table, *, stored: bool, keep: bool
) -> dict[str, Any]:
    """What is told of a CPD of any kind; see `told.Row`."""
    found: dict[str, Any] = {"parents": parents, "height": family.shape[2]}
    if not stored:
        found["angles"] = tuple(np.flatnonzero(family.cpd.child.angle_mask).tolist())
    if stored or family.template is None:
        for name in ("matrix", "offset", "noise"):
            found[name] = table.array(getattr(family, name))
        return found
    answers, template = family.trace_whole(), family.template
    if isinstance(answers, str):
        raise Uncompiled(f"{family.cpd!r}: {answers}")
    rule = points_of(family)
    if isinstance(rule, str):
        raise Uncompiled(f"{family.cpd!r}: {rule}")
    inputs = [
        family.inputs[parent]
        for parent, place in zip(template.given, template.places, strict=True)
        if place is None
    ]
    found |= {"function": function_of(template, answers.trace), "points": rule}
    found["noise"], found["inputs"] = table.array(family.own_noise), _joined(inputs, table)
    if keep:
        found["matrix"], found["offset"] = table.array(family.matrix), table.array(family.offset)
        if rule is not None:
            family.keep_errors()
            found["kept"] = table.array(family.noise)
    return found


def _joined(inputs: Sequence[Array], table: Table) -> told.Array | None:
    """Inputs (rows, runs or 1, d), one after another."""
    if not inputs:
        return None
    if len(inputs) == 1:
        return table.array(inputs[0])
    lead = np.broadcast_shapes(*(values.shape[:2] for values in inputs))
    wide = [np.broadcast_to(values, (*lead, values.shape[2])) for values in inputs]
    return table.array(np.concatenate(wide, axis=-1))
