"""Checks of evidence: what it is of, and the arrays that it is made of."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from pgm.boundary import as_floats, as_wholes
from pgm.errors import EvidenceError
from pgm.evidence.values import Soft
from pgm.factors.scope import listed, unknown_name
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Variable


def as_rows(variable: Variable, value: Any, axis: str | None) -> Array:
    """Evidence as an array (..., rows, d), or (..., d) where there is no axis of rows."""
    if isinstance(value, Soft):
        raise EvidenceError(
            f"soft evidence for {variable!r}, which is continuous; soft weights are for discrete "
            "variables, and an uncertain reading is evidence of a child: "
            f"LinearGaussianCPD(reading, given={{{variable.name}: 1.0}}, cov=...)",
            variable=variable,
        )
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
    hint = "; give a scalar its component axis, value[..., None]" if variable.dimension == 1 else ""
    due = f"(..., {axis}, {variable.dimension})" if axis else f"(..., {variable.dimension})"
    if array.ndim < (2 if axis else 1) or array.shape[-1] != variable.dimension:
        raise EvidenceError(
            f"evidence for {variable!r} has shape {array.shape}; {due} was due, the last axis "
            f"its components ({listed(variable.components)}){hint}",
            variable=variable,
        )
    return array


def require_finite(
    variable: Variable,
    array: Array,
    step: Integers | None = None,
    advice: str = "finite numbers were due",
) -> Array:
    """Refuse NaN and infinity in evidence that must be complete, (..., rows, d)."""
    finite = np.isfinite(array)
    if finite.all():
        return array
    _refuse(
        variable,
        ~finite.all(axis=-1),
        step,
        "entries that are NaN, masked or infinite",
        advice,
    )
    return array


def taken_readings(variable: Variable, array: Array, step: Integers | None = None) -> Mask | None:
    """The mask of components of a sensor's measurements taken, (..., rows, d); None for all.

    NaN is a component not taken; infinity is refused.
    """
    if np.isfinite(array).all():
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


def as_steps(variable: Variable, step: Any, count: int | None, last: int) -> Integers:
    """The steps of sightings, (M,), in 0..last."""
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
        raise EvidenceError(
            f"sightings of {variable!r}: {count} measurements with {array.shape[0]} steps; one "
            "step for each measurement was due",
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
