"""A step of an online filter as a table of integers, by which machine code knows its arrays.

A *plan* lays out the CPDs and the evidence of a step. A *layout* is such a plan whose values stand
in arrays of fixed shapes. The *table* has the addresses and shapes of these arrays, as described in
`pgm.kernels.compiled.online`; at each step of the same *kind*, with the same variables given in
arrays of the same shapes, machine code copies what is given into them. The *general way* to make a
step is NumPy's, without machine code. A *trace* is a user's function recorded as a graph of scalar
operations, which machine code evaluates.
"""

from __future__ import annotations

from itertools import accumulate
from math import prod

import numpy as np

from pgm.beliefs.moments.compiled.numba_chain import Chain
from pgm.beliefs.moments.compiled.numba_table import Integers64, Uncompiled
from pgm.beliefs.moments.digits.close_points import families, largest
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.cpds import AffineCPD
from pgm.kernels.arrays import Array
from pgm.kernels.compiled import tables as t
from pgm.linearisation.family import Family
from pgm.posteriors.status import Status
from pgm.schedules.step_evidence import Values, places
from pgm.tracing import Judge
from pgm.variables import Variable

# Steps that are made both ways.
TRIALS = 5


class Layout:
    """A plan of one step, its values in arrays of fixed shapes that later steps fill anew.

    It is made from the `plan` and `values` of the first step of the kind, and from the `shapes` of
    the values' arrays. `step` is the table, valid while the layout is kept; None where machine code
    cannot make the step, for the reason `why`. `first` and `second` are the variables whose arrays
    a kernel takes as they come: an input alone, or a sensor and the parent given with its
    sightings; None where all values come in one row, one after another. `status` is that of a
    belief after the step. The `judge` compares the functions' traces with the functions; `trials`
    is how many more steps are made in the general way, too, before machine code is trusted.
    """

    step: Integers64 | None = None
    why: str = ""
    first: Variable | None = None
    second: Variable | None = None
    trials: int = TRIALS

    def __init__(
        self,
        plan: ChainPlan,
        values: Values,
        shapes: list[tuple[int, ...]],
        status: Status,
    ) -> None:
        self.status, self._where = status, places(values)
        self.judge = Judge()
        # As of `kernels.compiled.online`.
        self._parts: list[list[int]] = []
        self._shifts: list[list[int]] = []
        if len(values) == 1 and len(shapes) == 1 + bool(plan.sensors):
            self.first, self.second = next(iter(values)), [*self._where][-1][1]
        starts = [*accumulate(map(prod, shapes), initial=0)][:-1]
        self._order = list(range(len(shapes))) if self.first is not None else starts
        try:
            self.step = self._table(plan)
        except Uncompiled as error:
            self.why = str(error)

    def _table(self, plan: ChainPlan) -> Integers64:
        """The table: addresses and shapes of the step's arrays, as integers.

        An `Uncompiled` is raised, with the reason as its text, where there is none.
        """
        from pgm.kernels.compiled import sweeps as s

        if largest(families(plan)):
            raise Uncompiled("its sigma points lie close together, and lost digits are to be told")
        chain, layout = Chain(plan), plan.layout
        for family in plan.families:
            family.judge = self.judge
        chain.lay_out(False, False)
        self._rows = rows = chain.rows
        for family in plan.families:
            if family.compiled is not None and family.compiled.trace.cast:
                _require_followed(family)
        for link, row in zip(plan.transition, chain.links, strict=True):
            self._inputs(link.family, row, 1, None)
        for sensor, row in zip(plan.read, chain.sensors, strict=True):
            self._inputs(sensor.family, row, len(sensor.values), sensor.variable)
        if {order for order, *_ in self._parts} != set(self._order):
            raise Uncompiled("something that is given is read by no function")
        room = s.room(layout.slice_size, layout.state_size, rows.height, rows.points)
        step = [rows.at(chain.fields), rows.at(np.zeros(room)), self.first is None]
        for table in (self._parts, self._shifts):
            step += rows.at(np.array(table, dtype=np.int64)), len(table)
        return np.array(step, dtype=np.int64)

    def _inputs(self, family: Family, row: Integers64, count: int, sensor: Variable | None) -> None:
        """Make the arrays from which machine code reads a CPD's inputs and measurements.

        Their addresses and shapes are entered in `row`, the CPD's part of the table. `count` is the
        CPD's number of measurements and `sensor` its child; for a CPD of the transition they are 1
        and None. The offset of an affine CPD is computed from the inputs at each step. A noise that
        depends on inputs raises `Uncompiled`.
        """
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
        """Note that the array given at a place is copied to the rows of `target`, (count, d).

        The `place` of an array is its position among all that are given at a step (`places`). If
        the array is `shared`, its only row goes to all rows of the target; with `missing` its
        components may be NaN.
        """
        count, width = target.shape
        rows = 1 if shared else count
        told = self._rows.at(target), target.strides[0] // 8, count, missing
        self._parts.append([self._order[place], rows, width, *told])


def _require_followed(family: Family) -> None:
    """Refuse, by `Uncompiled`, a function that calls float() on its input or has no trace.

    Its branches may change later, and a trace has those that were taken when it was made. Jacobians
    may call float(): most do so by writing into np.zeros, which they return.
    """
    assert family.template is not None
    assert family.template.tracer is not None
    alone = family.template.tracer.traced()
    if isinstance(alone, str) or alone.cast:
        raise Uncompiled(
            f"{family.cpd!r}: its function makes floats of its input, by which it may decide "
            "otherwise in a later step: np.asarray(x) without a dtype, np.zeros_like in place of "
            "np.zeros"
        )
