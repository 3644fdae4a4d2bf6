"""Weights of the states by the measurements of a discrete sensor: p(z | x).

Weights are (*slice, [runs]), as a belief: an axis for each hidden variable of a step, of length one
if the weights do not depend on it, then one of runs, which is there only if the user gave axes of
runs. Their entries are numbers or logarithms, as a *semiring* has it. A *log-scale* is the
logarithm of a number by which weights have been divided, to keep them near one. *Soft evidence* are
weights w(z) of a sensor's states, in place of a state that was measured; readings have ln w(z).
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.beliefs.markov.input_tables import InputTables, smallest_entry
from pgm.beliefs.markov.sensor_weights import SensorWeights
from pgm.cpds import TableCPD
from pgm.elimination import Plan, TableAlgebra, eliminate, next_smallest
from pgm.evidence import Reading
from pgm.evidence.static import scaled
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import LOG_SUM_PRODUCT, SUM_PRODUCT, Semiring, exp

if TYPE_CHECKING:
    from pgm.beliefs.markov.plan import SlicePlan


class Weights(SensorWeights):
    """The likelihood weights of one table's measurements, on the axes of a belief.

    observed: The sensor's parents that evidence gives.
    soft: Whether the measurements are soft evidence, weights of the sensor's states.
    """

    cpd: TableCPD

    def __init__(self, plan: SlicePlan, reading: Reading, runs: int, batch: bool) -> None:
        super().__init__(plan, reading, runs, batch)
        self.observed = tuple(v for v in self.cpd.given if v not in plan.labels)
        self.called = InputTables(self.cpd, reading.inputs, reading.step)
        self.soft = reading.values.dtype.kind == "f"
        if self.soft:  # of any size; they are used with their largest one
            self._below, self._tops = scaled(reading.values)

    @cached_property
    def _columns(self) -> Array:
        """The table, (observed parents..., child, *slice): a measurement selects its weights."""
        return self._laid(self.cpd.table, 0)

    @cached_property
    def _log_columns(self) -> Array:
        """The logarithms of `_columns`."""
        with np.errstate(divide="ignore"):
            logs: Array = np.log(self._columns)
        return logs

    def _laid(self, table: Array, lead: int) -> Array:
        """A table (lead..., parents..., child) as (lead..., observed parents..., child, *slice).

        The hidden parents' axes go to those of the slice, whose other axes get length one. `lead`
        is the number of leading axes, which stay as they are.
        """
        axes = (*self.cpd.given, self.cpd.child)
        order = [lead + axes.index(v) for v in (*self.observed, self.cpd.child, *self.order)]
        turned = np.ascontiguousarray(table.transpose(*range(lead), *order))
        return turned.reshape(*turned.shape[: turned.ndim - len(self.order)], *self.shape)

    def row(self, row: int, semiring: Semiring = SUM_PRODUCT) -> Array | None:
        """The weights of the measurement at a row, (*slice, [runs]), as entries of the semiring.

        In runs that lack the measurement the weights are the semiring's one. The result is None if
        the measurement is missing in a single run, or in all runs that share it with the states of
        observed parents; soft evidence always has weights. It is divided by its largest weight,
        whose logarithm `log_scale` gives.
        """
        values, taken = self.reading.values[row], self.reading.taken[row]
        if self.cpd.function is None:
            columns = self._columns if semiring.linear or self.soft else self._log_columns
            places = [self.reading.inputs[v][row, :, 0] for v in self.observed]
        else:
            columns, places = self._called(row)
            columns = columns if semiring.linear or self.soft else semiring.entries(columns)
        if self.soft:
            return self._softened(row, columns, places, semiring)
        states = values[:, 0]
        if self.runs == 1 or (len(states) == 1 and all(len(p) == 1 for p in places)):
            if not (self.complete or taken[0, 0]):
                return None
            single: Array = columns[(*(p[0] for p in places), states[0])]
            return self._over_runs(single)
        found: Array = columns[(*places, states)]  # (runs, *slice)
        if not self.complete:
            shape = (-1, *(1,) * len(self.shape))
            found = np.where(taken[:, 0].reshape(shape), found, semiring.one)
        return np.moveaxis(found, 0, -1)

    def picked(self, part: range) -> tuple[Array, Array] | None:
        """The weights of some steps, (steps, *slice, [runs]), and log-scales, (steps, [runs]).

        `part` are the steps, consecutive ones. The largest weight of each step and run is one; a
        step without a measurement has ones. The weights are columns of the sensor's table, selected
        for all steps at once. The result is None where this is not possible: with observed parents,
        with soft evidence, with a table that is a function of inputs, or if a step has several
        measurements.
        """
        rows = self._rows(part)
        step = self.reading.step[rows.start : rows.stop] - part.start
        if self.observed or self.soft or self.cpd.function is not None or (np.diff(step) < 1).any():
            return None
        columns, logs = self._scaled_columns
        nothing = len(columns) - 1
        states = self.reading.values[rows.start : rows.stop, :, 0]
        if not self.complete:
            states = np.where(self.reading.taken[rows.start : rows.stop, :, 0], states, nothing)
        chosen = np.full((len(part), self.runs) if self.batch else len(part), nothing)
        chosen[step] = states if self.batch else states[:, 0]
        found = columns.take(chosen, axis=0)
        return (np.moveaxis(found, 1, -1) if self.batch else found), logs[chosen]

    @cached_property
    def _scaled_columns(self) -> tuple[Array, Array]:
        """The weights p(z | x) of each state z, (k + 1, *slice), and log-scales, (k + 1,).

        The sensor has k states, and no observed parents. The weights of a state are divided by the
        largest. The last entry is for a missing measurement: ones, with the log-scale 0.
        """
        top = self._columns.max(axis=tuple(range(1, self._columns.ndim)), keepdims=True)
        top = np.where(top > 0.0, top, 1.0)
        nothing = np.ones((1, *self._columns.shape[1:]))
        return np.concatenate([self._columns / top, nothing]), np.append(np.log(top), 0.0)

    def log_scale(self, row: int, semiring: Semiring = SUM_PRODUCT) -> Array | float:
        """The log-scale of a measurement's weights; 0 unless it is soft.

        Soft evidence is divided by its largest weight, so that this is the largest one's logarithm.
        The result is (runs or 1,), or one number where beliefs have no axis of runs.
        """
        if not self.soft:
            return 0.0
        logs: Array = self._tops[row]
        return logs if self.batch else float(logs[0])

    def _softened(self, row: int, columns: Array, places: Any, semiring: Semiring) -> Array:
        """Weights by soft evidence w at a row: Σ_z w(z) p(z | parents), (*slice, [runs]).

        columns: The sensor's table, as numbers, (other axes..., child, *slice). The other axes are
            those of observed parents, after one of runs if the table is a function of inputs.
        places: For each of the other axes the index that each run selects, (runs or 1,).
        """
        logs = self._below[row]
        # Sums over what was measured, also on the way of maxima over the states.
        numbers = SUM_PRODUCT if semiring.linear else LOG_SUM_PRODUCT
        values = exp(logs) if semiring.linear else logs
        own = numbers.entries(columns[tuple(places)] if places else columns[None])
        factors = [
            each[0] if len(each) == 1 else np.moveaxis(each, 0, -1) for each in (values, own)
        ]
        plan = self._sum
        found: Array = eliminate(plan, factors, TableAlgebra(numbers, plan.sizes, watched=False))
        return self._over_runs(found) if len(values) == len(own) == 1 else found

    @cached_property
    def _sum(self) -> Plan:
        """The sum Σ_z w(z) p(z | x) over a sensor's states: z has the label 0, x those after it."""
        sizes = dict(enumerate((self.cpd.child.size, *self.shape)))
        return next_smallest([(0,), tuple(sizes)], tuple(sizes)[1:], sizes)

    def _over_runs(self, single: Array) -> Array:
        """Weights (*slice) that all runs share, as (*slice, 1) if beliefs have an axis of runs."""
        return single[..., None] if self.batch else single

    def _called(self, row: int) -> tuple[Array, list[Any]]:
        """The table p(z | parents) that the function gives at a row, and indices into it.

        The table is (runs or 1, observed parents..., child, *slice). The indices are a list of
        arrays (runs or 1,), one for each axis before the child's: they select each run's entries.
        """
        tables = self.called.at(row)
        places = [self.reading.inputs[v][row, :, 0] for v in self.observed]
        return self._laid(tables, 1), [np.arange(len(tables)), *places]

    @property
    def smallest(self) -> float:
        """A lower bound, for any step, of a product of positive weights, one of each measurement.

        Where a function gives the table, only the rows called up to now count.
        """
        least = self.called.smallest if self.cpd.function is not None else self._least
        if self.soft:
            possible = self._below > -np.inf
            least *= float(exp(self._below.min(where=possible, initial=0.0)))
        counts = np.diff(self.starts)
        return float(least ** max(counts.max(initial=0), 0))

    @cached_property
    def _least(self) -> float:
        """The smallest positive entry of the table."""
        return smallest_entry(self._columns)
