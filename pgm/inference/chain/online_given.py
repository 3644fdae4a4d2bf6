"""Inputs and readings of one robot at a step, as rows of plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np

from pgm.boundary import as_floats
from pgm.errors import EvidenceError
from pgm.evidence import Sightings
from pgm.immutable import set_writeable
from pgm.kernels.arrays import Array
from pgm.variables import Variable

_ARRAY, _FLOAT = np.ndarray, np.dtype(np.float64)
_SIGHTED, _GIVEN = -1, -2
# What tells values of one kind from those of another: of what, how many rows, how wide. Variables
# are told by identity, which is quicker than by value; whoever keeps a key has to keep them.
Key = tuple[Any, ...]


def ordinary(values: Mapping[Variable, Any]) -> tuple[Key, list[Array]] | None:
    """The kind of the values given, and their rows: (d,), or (M, d) of sightings, read-only.

    The rows of a sensor come before those of the parents given with it. None where values are
    missing, of an odd shape, or of many robots.
    """
    key: list[Any] = []
    rows: list[Array] = []
    for variable, value in values.items():
        if not isinstance(value, Sightings):
            row = _view(value, 1)
            if row is None or not isfinite(sum(row.tolist())):
                return None
            rows.append(row)
            key += id(variable), row.shape
            continue
        row = _view(value.values, 2)
        if row is None or value.step is not None or not _is_finite(row):
            return None
        rows.append(row)
        key += id(variable), _SIGHTED, row.shape
        for parent, each in value.given.items():
            row = _view(each, 2)
            if row is None or not _is_finite(row):
                return None
            rows.append(row)
            key += id(parent), _GIVEN, row.shape
    return tuple(key), rows


def _is_finite(row: Array) -> bool:
    return isfinite(sum((row if row.ndim == 1 else row.ravel()).tolist()))


def _view(value: Any, axes: int) -> Array | None:
    """A view that functions of users may see, (d,) or (M, d), of an array of floats or the like."""
    if type(value) is not _ARRAY or value.dtype is not _FLOAT:
        value = _numbers(value) if isinstance(value, _ARRAY | list | tuple) else None
    if value is None or value.ndim != axes:
        return None
    view: Array = value[0] if axes == 2 and len(value) == 1 else value.view()
    set_writeable(view, False)
    return view


def _numbers(value: Any) -> Array | None:
    try:
        return as_floats(value, "a value", EvidenceError)
    except EvidenceError:  # which the general way words
        return None


def places(values: Mapping[Variable, Any]) -> dict[tuple[Variable | None, Variable], int]:
    """The place of each variable's row, by the sensor with whose sightings it was given, if any."""
    found: dict[tuple[Variable | None, Variable], int] = {}
    for variable, value in values.items():
        found[None, variable] = len(found)
        if isinstance(value, Sightings):
            for parent in value.given:
                found[variable, parent] = len(found)
    return found
