"""Rows of evidence of any variable: values of continuous ones, states of discrete ones."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from pgm.evidence import states
from pgm.evidence.arrays import as_rows, require_finite, taken_readings
from pgm.evidence.values import Constant
from pgm.kernels.arrays import Integers, Mask
from pgm.variables import Discrete, Variable

# Numbers (..., d), or indices of states (..., 1).
Rows = npt.NDArray[Any]
WHOLE = "only a sensor's measurement may be missing, or components of it, as NaN"


def constant_row(variable: Variable, value: Constant) -> Rows:
    """A constant's value, (..., d)."""
    return complete(variable, rows_of(variable, value.value, None))


def rows_of(variable: Variable, value: Any, axis: str | None) -> Rows:
    """Evidence as an array (..., rows, d), or (..., d) where there is no axis of rows.

    Of a discrete variable d is one, the index of a state, or as many weights as there are states.
    """
    if isinstance(variable, Discrete):
        return states.as_rows(variable, value, axis)
    return as_rows(variable, value, axis)


def complete(variable: Variable, rows: Rows, step: Integers | None = None) -> Rows:
    """Refuse evidence of an input of which something is missing."""
    if isinstance(variable, Discrete):
        return states.require_known(variable, rows, step)
    return require_finite(variable, rows, step, WHOLE)


def taken_of(variable: Variable, rows: Rows, step: Integers) -> Mask | None:
    """The mask of what was measured, (..., rows, d); None for all."""
    if isinstance(variable, Discrete):
        return states.taken(rows)
    return taken_readings(variable, rows, step)
