"""Rows of evidence of any variable, checked: values, states, weights, and their steps."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats, as_wholes
from pgm.errors import EvidenceError
from pgm.evidence.degrees import in_degrees
from pgm.evidence.values import Constant, Soft, UnknownVariable, variables_left_open
from pgm.factors.axes import MISSING, as_indices
from pgm.factors.scope import Place, in_row, in_run, listed, unknown_name
from pgm.kernels.arrays import Array, Integers, Mask, is_finite
from pgm.kernels.semirings import LOG_SUM_PRODUCT
from pgm.resources import APIECE, in_threads
from pgm.variables import Discrete, Variable


def as_rows(variable: Variable, value: Any, axis: str | None) -> Array:
    """Evidence as an array (..., rows, d), or (..., d) where there is no axis of rows."""
    if isinstance(value, Soft):
        raise EvidenceError(
            f"soft evidence for {variable!r}, which is continuous; soft weights are for discrete "
            "variables, and an uncertain reading is evidence of a child: "
            f"LinearGaussianCPD(reading, given={{{variable.name}: 1.0}}, cov=...)",
            variable=variable,
        )
    if isinstance(value, UnknownVariable):
        raise variables_left_open(variable, value, "evidence")
    array = as_floats(
        value,
        f"evidence for {variable!r}",
        EvidenceError,
        labels=variable.components,
        missing=True,
        variable=variable,
    )
    if axis == "M" and array.shape == (0,):
        array = np.empty((0, variable.dimension))  # no measurements, written as []
    if axis is None and array.ndim == 0 and variable.dimension == 1:
        array = array[None]
    due = f"(..., {axis}, {variable.dimension})" if axis else f"(..., {variable.dimension})"
    if array.ndim < (2 if axis else 1) or array.shape[-1] != variable.dimension:
        raise EvidenceError(
            f"evidence for {variable!r} has shape {array.shape}; {due} was due, the last axis "
            f"its components ({listed(variable.components)}){_turned(variable, array, axis)}",
            variable=variable,
        )
    return array


def _turned(variable: Variable, array: Array, axis: str | None) -> str:
    """How an array of another shape becomes evidence, where its axes can only mean one thing."""
    size = variable.dimension
    if size == 1:
        return "; give a scalar its component axis, value[..., None]"
    if array.ndim < 2 or array.shape[-2] != size:
        return ""
    if array.shape[-1] == 1 and array.ndim > (2 if axis else 1):
        return "; of columns make rows, np.asarray(value)[..., 0]"
    return "; turn it round, np.swapaxes(value, -1, -2)"


def require_finite(
    variable: Variable,
    array: Array,
    step: Integers | None = None,
    advice: str = "finite numbers were due",
) -> Array:
    """Refuse NaN and infinity in evidence that must be complete, (..., rows, d)."""
    if is_finite(array):
        return array
    finite = np.isfinite(array)
    _refuse(
        variable,
        ~finite.all(axis=-1),
        step,
        "entries that are NaN, masked or infinite",
        advice,
    )
    return array


def taken_readings(
    variable: Variable, array: Array, step: Integers | None = None, threads: int = 1
) -> Mask | None:
    """The mask of components of a sensor's measurements taken, (..., rows, d); None for all.

    NaN is a component not taken; infinity is refused.
    """
    if array.size < APIECE and is_finite(array):
        return None
    finite = np.empty_like(array, dtype=bool)  # in memory as the array is

    def look(first: int, last: int) -> None:
        np.isfinite(array[first:last], finite[first:last])

    in_threads(look, len(array), min(threads, 1 + array.size // APIECE))
    if finite.all():
        return None
    _refuse(
        variable,
        np.isinf(array).any(axis=-1),
        step,
        "infinite entries",
        "a component not taken is NaN",
    )
    return ~np.isnan(array)


def _refuse(
    variable: Variable, bad: Mask | np.bool_, step: Integers | None, what: str, advice: str
) -> None:
    """Raise if any row, (..., rows), is bad, naming the step of the first."""
    if not bad.any():
        return
    first = None if step is None else int(step[np.nonzero(bad)[-1]].min())
    where = "" if first is None else f", first at step {first}"
    raise EvidenceError(
        f"evidence for {variable!r} has {what}{where}; {advice}", variable=variable, step=first
    )


def as_steps(
    variable: Variable, step: Any, count: int | None, last: int, runs: int = 1
) -> Integers:
    """The steps of sightings, (M,), in 0..last; each run has `count` of them."""
    if step is None:
        raise EvidenceError(
            f"sightings of {variable!r} have no steps; give step=, one for each measurement",
            variable=variable,
        )
    array = as_wholes(step, f"sightings of {variable!r}: step", EvidenceError, variable=variable)
    if array.ndim != 1:
        raise EvidenceError(
            f"sightings of {variable!r}: step must be a row of whole numbers, not of shape "
            f"{array.shape}",
            variable=variable,
        )
    if count is not None and array.shape != (count,):
        width = "" if isinstance(variable, Discrete) else f", {variable.dimension}"
        columns = (
            f"; the values of {runs} runs were given: if they are of one, take "
            f"np.reshape(values, (-1{width or ','}))"
        )
        raise EvidenceError(
            f"sightings of {variable!r}: {count} measurements with {array.shape[0]} steps; one "
            "step for each measurement was due" + columns * (runs == len(array) and count == 1),
            variable=variable,
        )
    outside = array[(array < 0) | (array > last)]
    if outside.size:
        raise EvidenceError(
            f"sightings of {variable!r}: step {outside[0]} is outside 0..{last}",
            variable=variable,
            step=int(outside[0]),
        )
    return array


def no_evidence_for(key: object, known: Collection[Variable]) -> EvidenceError:
    """The error of evidence whose key is none of the known variables."""
    return EvidenceError(
        f"evidence for {key!r}, {unknown_name(key, known)}",
        variable=key if isinstance(key, Variable) else None,
    )


def as_log_weights(variable: Discrete, value: Soft, where: Place = in_run) -> Array:
    """The logarithms of soft evidence's weights, (..., size), each row with one above −∞.

    A message has where the first bad ones are.
    """
    what = f"soft evidence for {variable!r}"
    states = f"({listed(variable.states)})"
    if isinstance(value.weights, Mapping):
        raise EvidenceError(
            f"{what}: the weights are a mapping; give them as a row, in the order of the states "
            f"{states}",
            variable=variable,
        )
    array = as_floats(
        value.weights,
        f"{what}: the weights, one for each of the states {states},",
        EvidenceError,
        labels=variable.states,
        variable=variable,
    ).copy()
    if array.shape[-1:] != (variable.size,):
        raise EvidenceError(
            f"{what}: the weights have shape {array.shape}; the last axis must hold one for each "
            f"of the states {states}",
            variable=variable,
        )
    zero, wrong = (-np.inf, "log-weights that are NaN or +∞") if value.log else (0.0, WRONG)
    bad = ~(np.isfinite(array) & (value.log | (array >= 0.0)) | (array == zero))
    if bad.any():
        raise EvidenceError(f"{what}: {wrong}{where(bad.any(axis=-1))}", variable=variable)
    if value.log and (np.abs(array[array > -np.inf]) > LARGEST).any():
        raise EvidenceError(
            f"{what}: log-weights of more than {LARGEST:g}, beside which float64 has no digits for "
            "any other number; take a common part off",
            variable=variable,
        )
    empty = (array == zero).all(axis=-1)
    if empty.any():
        raise EvidenceError(
            f"{what}: the {'log-weights are all −∞' if value.log else 'weights are all zero'}"
            f"{where(empty)}, which is impossible evidence; a state that is possible needs a "
            f"{'finite' if value.log else 'positive'} one, and equal ones say nothing",
            variable=variable,
        )
    return array if value.log else LOG_SUM_PRODUCT.entries(array)


# The largest log-weight, whatever its sign.
LARGEST = 1e100
WRONG = "weights that are negative, NaN or infinite"


def _state_rows(variable: Discrete, value: Any, axis: str | None) -> Rows:
    """Indices of states as (..., rows, 1), or logarithms of soft weights as (..., rows, size).

    Without an axis of rows they are (..., 1), or (..., size).
    """
    where = in_run if axis is None else in_row
    if isinstance(value, Soft):
        rows: Rows = as_log_weights(variable, value, where)
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
    """The mask of measured states, of the rows' shape; None if all were measured."""
    if rows.dtype.kind == "f":
        return None
    missing = rows == MISSING
    return ~missing if missing.any() else None


def unread(count: int) -> Rows:
    """The indices of measurements that are still to be drawn, (count, 1)."""
    return np.full((count, 1), MISSING)


# Numbers (..., d), indices of states (..., 1), or logarithms of their weights (..., size).
Rows = npt.NDArray[Any]
WHOLE = "only a sensor's measurement may be missing, or components of it, as NaN"


def constant_row(variable: Variable, value: Constant) -> Rows:
    """A constant's value, (..., d)."""
    return complete(variable, rows_of(variable, value.value, None))


def rows_of(variable: Variable, value: Any, axis: str | None) -> Rows:
    """Evidence as an array (..., rows, d), or (..., d) where there is no axis of rows.

    For a discrete variable d is one, the index of a state, or the number of its states, for the
    logarithms of weights.
    """
    if isinstance(variable, Discrete):
        return _state_rows(variable, value, axis)
    return as_rows(variable, value, axis)


def complete(variable: Variable, rows: Rows, step: Integers | None = None) -> Rows:
    """Refuse evidence of an input of which something is missing."""
    if isinstance(variable, Discrete):
        return _require_known(variable, rows, step)
    return require_finite(variable, rows, step, WHOLE)


def taken_of(variable: Variable, rows: Rows, step: Integers, threads: int) -> Mask | None:
    """The mask of components that were measured, (..., rows, d); None where every one was."""
    if isinstance(variable, Discrete):
        return _taken_states(rows)
    require_radians(variable, rows)
    return taken_readings(variable, rows, step, threads)


def require_radians(variable: Variable, rows: Array) -> None:
    """Refuse measurements of angles in degrees, as far as numbers tell.

    rows: (..., rows, d), in the order of time.
    """
    if odd := in_degrees(rows, variable.components, variable.angles):
        raise EvidenceError(f"measurements of {variable!r}: {odd}", variable=variable)
