"""Plans of chains as tables of integers, for sweeps in machine code."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.compiled.numba_functions import compiled
from pgm.beliefs.moments.compiled.plans import Uncompiled
from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile.machine import GATE, MOST, rule_told
from pgm.kernels import along_runs
from pgm.kernels.arrays import Array, Index
from pgm.kernels.compiled import tables as t
from pgm.linearisation.family import Family
from pgm.linearisers import Taylor
from pgm.linearisers.points import Points
from pgm.linearisers.regression import StatisticalRegression

Integers64 = npt.NDArray[np.int64]


def address(array: npt.NDArray[Any]) -> int:
    """Where an array's memory begins."""
    found: int = array.__array_interface__["data"][0]
    return found


class Rows:
    """The arrays of a table, which have to stay in memory as long as it does.

    `together` says whether functions are of packs.
    """

    def __init__(self, together: bool = False) -> None:
        self.kept: list[object] = []
        self.points, self.height, self.together = 0, 1, together

    def at(self, array: npt.NDArray[Any]) -> int:
        """The address of an array, which is kept."""
        self.kept.append(array)
        return address(array)

    def told(self, array: Array, own: int) -> tuple[int, int, int, int]:
        """The address of an array (rows or 1, runs or 1, own axes), and its strides, in floats."""
        inner = [(k, n) for k, n in zip(array.strides[2:], array.shape[2:], strict=True) if n > 1]
        for (outer, _), (stride, size) in pairwise(inner):
            if outer != stride * size:
                return self.told(np.ascontiguousarray(array), own)
        down, across = (
            0 if n == 1 else k // 8 for k, n in zip(array.strides, array.shape[:2], strict=False)
        )
        return self.at(array), down, across, inner[-1][0] // 8 if inner else 0

    def places(self, index: Index, size: int) -> int:
        """The address of the places that an index says."""
        return self.at(np.arange(size)[index].astype(np.int64))


def bits(mask: Sequence[int] | Integers64) -> int:
    """Places as the bits of a number."""
    return sum(1 << int(k) for k in mask)


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


def link_row(plan: ChainPlan, link: Link, rows: Rows, table: Integers64, *, stored: bool) -> None:
    """Lay out a CPD of the transition."""
    layout, family = plan.layout, link.family
    _family(plan, family, link.parents, layout.state_size + layout.slice_size, rows, table, stored)
    table[t.CHILD] = link.child.start
    table[t.BARE] = bits(family.bare)
    table[t.UNSURE] = not family.semidefinite
    if stored or not link.turning:
        return
    size = layout.state_size + layout.slice_size
    own = np.arange(size)[link.parents].tolist()
    if any(before not in own for before in link.before.tolist()):
        raise Uncompiled(f"{family.cpd!r} turns an angle of which its function does not know")
    turning = [(new, before, own.index(before)) for new, before in link.turning]
    table[t.TURNS] = len(turning)
    table[t.TURNING] = rows.at(np.array(turning, dtype=np.int64))


def sensor_row(
    plan: ChainPlan, sensor: Sensor, rows: Rows, table: Integers64, *, stored: bool
) -> None:
    """Lay out a sensor with its measurements."""
    family = sensor.family
    _family(plan, family, sensor.parents, plan.layout.slice_size, rows, table, stored)
    table[t.WHOLE] = sensor.whole
    table[t.STEPS] = rows.at(np.array(sensor.bounds, dtype=np.int64))
    values = sensor.moved if stored else sensor.values
    if sensor.taken is not None:
        values = np.where(sensor.taken, values, np.nan)
    table[t.READINGS : t.READINGS + 4] = rows.told(values, 1)
    noise, sharp = family.own_noise, np.zeros(1)
    # An error that may be indefinite makes no sum of squares of a difference.
    if noise.shape[:2] == (1, 1) and family.semidefinite:
        sharp = along_runs.sharpness(noise[0].transpose(1, 2, 0))
    table[t.SHARP] = rows.at(sharp)


def _family(
    plan: ChainPlan,
    family: Family,
    parents: Index,
    size: int,
    rows: Rows,
    table: Integers64,
    stored: bool,
) -> None:
    _, _, height, width = family.shape
    table[t.SIZE], table[t.HEIGHT] = width, height
    table[t.PARENTS] = rows.places(parents, size)
    rows.height = max(rows.height, height, width)
    if stored or family.template is None:
        table[t.KIND] = t.AFFINE
        for place, array, own in (
            (t.MATRIX, family.matrix, 2),
            (t.OFFSET, family.offset, 1),
            (t.NOISE, family.noise, 2),
        ):
            table[place : place + 4] = rows.told(array, own)
    else:
        _function(plan, family, rows, table)
        table[t.NOISE : t.NOISE + 4] = rows.told(family.own_noise, 2)
    if not stored:
        table[t.ANGLES] = bits(np.flatnonzero(family.cpd.child.angle_mask))


def _function(plan: ChainPlan, family: Family, rows: Rows, table: Integers64) -> None:
    template, rule = family.template, family.lineariser
    assert template is not None
    known, together = template.compiled, rows.together
    alone, answers = bool(family.hidden) and type(rule) is not Taylor, family.trace_whole()
    if isinstance(answers, str):
        raise Uncompiled(f"{family.cpd!r}: {answers}")
    before = known.get(together)
    functions = compiled(template, answers.trace, before, alone=alone, together=together)
    known[together] = functions
    rows.kept.append(functions)
    table[t.VALUE], table[t.FUNCTION] = functions.value, functions.slope
    inputs = [
        family.inputs[parent]
        for parent, place in zip(template.given, template.places, strict=True)
        if place is None
    ]
    if inputs:
        lead = np.broadcast_shapes(*(values.shape[:2] for values in inputs))
        wide = [np.broadcast_to(values, (*lead, values.shape[2])) for values in inputs]
        # Functions take components that lie next to each other; NumPy joins arrays as they lie.
        joined = np.ascontiguousarray(np.concatenate(wide, axis=-1) if len(wide) > 1 else wide[0])
        table[t.INPUTS : t.INPUTS + 4] = rows.told(joined, 1)
    table[t.KIND] = t.TAYLOR
    if not family.hidden or type(rule) is Taylor:
        return
    why = rule_told(rule, template)
    if why is not None:
        raise Uncompiled(f"{family.cpd!r}: {why}")
    assert isinstance(rule, StatisticalRegression)
    points = rule.points(template.size, template.child.name, 0)
    table[t.KIND] = t.REGRESSION
    table[t.COUNT], table[t.CENTRED] = len(points.points), points.centred
    table[t.POINTS], table[t.LEAST] = _points(points, template.variances, rows)


def _points(points: Points, variances: Sequence[float], rows: Rows) -> tuple[int, int]:
    fit, count = points.fit, len(points.points)
    rows.points = max(rows.points, count)
    signs = np.ones(count) if fit.signs is None else fit.signs
    numbers = np.concatenate([points.points.ravel(), fit.rows.ravel(), signs])
    return rows.at(numbers), rows.at(np.array([*variances, points.fitted_rounding]))
