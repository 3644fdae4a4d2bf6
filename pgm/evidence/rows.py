"""Rows of evidence of any variable: values of continuous ones, states of discrete ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.errors import EvidenceError
from pgm.evidence.arrays import as_rows, require_finite, taken_readings
from pgm.evidence.static import as_weights
from pgm.evidence.values import Constant, Soft
from pgm.factors.axes import MISSING, as_indices
from pgm.factors.runs import in_row, in_run
from pgm.factors.scope import listed
from pgm.kernels.arrays import Integers, Mask
from pgm.variables import Discrete, Variable


def _state_rows(variable: Discrete, value: Any, axis: str | None) -> Rows:
    """Indices of states as (..., rows, 1), or soft weights as (..., rows, size).

    Without an axis of rows they are (..., 1), or (..., size).
    """
    where = in_run if axis is None else in_row
    if isinstance(value, Soft):
        rows: Rows = as_weights(variable, value, where)
        due = f"(..., {axis}, {variable.size})"
    else:
        rows = as_indices(variable, value, where)[..., None]
        due = f"(..., {axis})"
    if axis == "M" and rows.shape == (0, 1):
        return rows  # no measurements, written as []
    if axis is not None and rows.ndim < 2:
        shape = rows.shape if isinstance(value, Soft) else rows.shape[:-1]
        raise EvidenceError(
            f"evidence for {variable!r} has shape {shape}; {due} was due, an entry a row: the "
            f"index or the name of a state ({listed(variable.states)}), −1 for not measured",
            variable=variable,
        )
    return rows


def due(variable: Variable) -> str:
    """The shape of plain evidence, for messages."""
    return "(..., T)" if isinstance(variable, Discrete) else "(..., T, d)"


def _require_known(variable: Discrete, rows: Rows, step: Integers | None) -> Rows:
    """Refuse an input that is missing somewhere, or of which there are but weights."""
    if rows.dtype.kind == "f":
        raise EvidenceError(
            f"soft evidence for {variable!r}, an input, whose state must be known; weights are for "
            "measurements",
            variable=variable,
        )
    missing = rows[..., 0] == MISSING
    if missing.any():
        first = None if step is None else int(step[np.nonzero(missing)[-1]].min())
        where = "" if first is None else f" at step {first}"
        raise EvidenceError(
            f"evidence for {variable!r} is missing{where} (−1); only a sensor's measurement may be",
            variable=variable,
            step=first,
        )
    return rows


def _taken_states(rows: Rows) -> Mask | None:
    """The mask of what was measured, of the rows' shape; None for all."""
    if rows.dtype.kind == "f":
        return None
    missing = rows == MISSING
    return ~missing if missing.any() else None


def unread(count: int) -> Rows:
    """The indices of measurements that are still to be drawn, (count, 1)."""
    return np.full((count, 1), MISSING)


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
        return _state_rows(variable, value, axis)
    return as_rows(variable, value, axis)


def complete(variable: Variable, rows: Rows, step: Integers | None = None) -> Rows:
    """Refuse evidence of an input of which something is missing."""
    if isinstance(variable, Discrete):
        return _require_known(variable, rows, step)
    return require_finite(variable, rows, step, WHOLE)


def taken_of(variable: Variable, rows: Rows, step: Integers) -> Mask | None:
    """The mask of what was measured, (..., rows, d); None for all."""
    if isinstance(variable, Discrete):
        return _taken_states(rows)
    return taken_readings(variable, rows, step)
