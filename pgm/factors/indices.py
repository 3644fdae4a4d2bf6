"""States of a discrete variable, by name or by index, as indices."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.boundary import is_whole, masked_whole
from pgm.errors import EvidenceError, ModelError
from pgm.factors.runs import Place, in_run
from pgm.factors.scope import listed
from pgm.kernels.arrays import Integers, Mask
from pgm.variables import Discrete

# What stands for "not observed in this run".
MISSING = -1
# What stands, while names are looked up, for one that is no state's.
STRANGER = -2


class _Unfit(Exception):
    """A value that is no state, in words, and what one that may be missing can be besides."""


def as_indices(variable: Discrete, value: Any, where: Place = in_run) -> Integers:
    """Evidence, names or indices of states, as an array of indices (...); −1 is "not observed".

    A message tells where the first bad one is.
    """
    try:
        return _indices(variable, value, where)
    except _Unfit as fault:
        raise EvidenceError(
            f"evidence for {variable!r} {''.join(fault.args)}", variable=variable
        ) from None


def as_known(variable: Discrete, value: Any, what: str, **about: Any) -> Integers:
    """Names or indices of states, none of which is missing, as an array of indices (...)."""
    try:
        indices = _indices(variable, value, in_run)
        _refuse(variable, indices, indices == MISSING, in_run)
    except _Unfit as fault:
        raise ModelError(f"{what} {fault.args[0]}", variable=variable, **about) from None
    return indices


def _indices(variable: Discrete, value: Any, where: Place) -> Integers:
    if hasattr(value, "columns"):
        raise _malformed(variable, "a data frame, of which pgm.records makes evidence")
    value = masked_whole(value)
    if isinstance(value, np.ma.MaskedArray):
        masked = np.ma.getmaskarray(value)
        array = np.array(np.ma.getdata(value), dtype=object)
        array[masked] = MISSING
        return _indices(variable, array, where)
    try:
        array = np.asarray(value)
    except ValueError:
        raise _malformed(variable, "rows of unequal length") from None
    if array.dtype.kind == "U" and not isinstance(value, np.ndarray | str):
        array = np.asarray(value, dtype=object)  # numpy makes names of a list's numbers
    if array.size == 0:
        return np.zeros(array.shape, dtype=np.intp)
    if array.dtype.kind in "UTO":
        return _looked_up(variable, array, where)
    if array.dtype.kind not in "iu":
        raise _malformed(variable, f"{_words(array)} of type {array.dtype}")
    _refuse(variable, array, (array < MISSING) | (array >= variable.size), where)
    return array.astype(np.intp)


def _looked_up(variable: Discrete, array: Any, where: Place) -> Integers:
    """Indices of an array of names, among which may be Python's whole numbers."""
    place = {state: index for index, state in enumerate(variable.states)}
    found = [
        place.get(name, STRANGER) if isinstance(name, str) else _whole(variable, name)
        for name in array.ravel().tolist()
    ]
    indices = np.array(found, dtype=np.intp).reshape(array.shape)
    _refuse(variable, array, indices == STRANGER, where)
    return indices


def _whole(variable: Discrete, value: Any) -> int:
    if not is_whole(value):
        raise _malformed(variable, repr(value))
    return int(value) if MISSING <= value < variable.size else STRANGER


def _refuse(variable: Discrete, array: Any, bad: Mask, where: Place) -> None:
    """Raise if any entry is bad, naming the first."""
    if bad.any():
        first = array[bad].ravel()[0]
        shown = repr(str(first) if isinstance(first, str) else int(first))
        raise _Unfit(
            f"is {shown}{where(bad)}, which is none of its states ({listed(variable.states)}), 0 "
            f"to {variable.size - 1}",
            ", nor −1 for not observed",
        )


def _malformed(variable: Discrete, found: str) -> _Unfit:
    return _Unfit(
        f"must be names or indices of states, not {found}; its states are "
        f"({listed(variable.states)})",
        ", −1 is not observed, and weights of the states are pgm.soft(weights)",
    )


def _words(array: Any) -> str:
    return f"an array of shape {array.shape}" if array.ndim else "a value"
