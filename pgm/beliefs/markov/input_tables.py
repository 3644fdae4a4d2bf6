"""Tables of CPDs that are functions of inputs, called at the inputs' values.

A *row* is the place of a step, or of a measurement, along the first axis of the inputs' values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pgm.cpds import TableCPD
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Discrete, Variable


def smallest_entry(table: Array) -> float:
    """The smallest positive entry of a table, 1 if there is none."""
    return float(table.min(where=table > 0.0, initial=1.0))


class InputTables:
    """The tables of a CPD that is a function of inputs, made row by row.

    inputs: The values of each input at all rows: of a vector (rows, runs or 1, d), of a discrete
        variable the indices of its states, (rows, runs or 1, 1).
    steps: The time step of each row, which errors name.
    smallest: The smallest positive entry of all tables returned up to now, at most 1.
    """

    def __init__(
        self, cpd: TableCPD, inputs: Mapping[Variable, Any], steps: Sequence[int] | Integers
    ) -> None:
        self.cpd, self.inputs, self.steps = cpd, inputs, steps
        self.smallest = 1.0

    def at(self, row: int) -> Array:
        """The tables p(child | parents) of a row, (runs or 1, parents' sizes..., child's size)."""
        values = {}
        for v in self.cpd.inputs:
            rows = self.inputs[v][row]
            values[v] = rows[:, 0] if isinstance(v, Discrete) else rows
        runs = max(len(rows) for rows in values.values())
        step = int(self.steps[row])
        if runs == 1:  # a single value, as a function of one robot takes it
            tables = self.cpd.at_inputs({v: a[0] for v, a in values.items()}, step=step)[None]
        else:
            wide = {v: np.broadcast_to(a, (runs, *a.shape[1:])) for v, a in values.items()}
            tables = self.cpd.at_inputs(wide, (runs,), step=step)
        self.smallest = min(self.smallest, smallest_entry(tables))
        return tables
