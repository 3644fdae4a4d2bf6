"""Advice when a user's function fails, or returns an array of the wrong shape."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from itertools import permutations
from typing import Any

import numpy as np

from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array

# Code for single numbers as a rule makes all of these mistakes, and fails of one at a time.
_OF_NUMBERS = (
    "it is called with arrays that have leading axes, so index components as a[..., i], take "
    "np.cos, np.hypot, ... in place of math.cos, math.hypot, and no float(...), and stack results "
    "by np.stack([...], axis=-1)"
)
# The mistakes that NumPy's and Python's errors give away, by words of these.
_MISTAKES = (
    (
        ("converted to Python scalars", "cannot convert the series", "must be real number"),
        _OF_NUMBERS,
    ),
    (
        ("truth value of an array",),
        "it is called with arrays: take np.where(condition, a, b) in place of if, and np.maximum "
        "in place of max",
    ),
    (
        ("out of bounds", "too many indices", "could not be broadcast"),
        _OF_NUMBERS,
    ),
    (
        ("values to unpack",),
        "it is called with arrays that have leading axes, so take components apart by "
        "np.moveaxis(a, -1, 0)",
    ),
    (
        ("inhomogeneous shape", "setting an array element with a sequence"),
        "it is called with arrays that have leading axes, so stack components by "
        "np.stack([...], axis=-1)",
    ),
    (
        ("matmul", "not aligned"),
        "it is called with arrays that have leading axes, so multiply by a matrix as a @ F.T",
    ),
)
# Of more arguments than so many not all orders are tried.
_MOST = 4


def mistake(error: Exception) -> str:
    """The likely mistake when a function fails on arrays with leading axes, and its remedy."""
    told = str(error)
    for words, advice in _MISTAKES:
        if any(word in told for word in words):
            return f"; {advice}"
    return ""


def order(parents: Scope) -> str:
    """In which order a function is given its arguments, and how many components each has."""
    if not parents:
        return ""
    names = ", ".join(map(repr, parents))
    sizes = [str(parent.dimension) for parent in parents]
    size = sizes[0] if len(sizes) == 1 else f"{', '.join(sizes[:-1])} and {sizes[-1]}"
    components = "component" if sizes == ["1"] else "components"
    return f"; it is called as function({names}), in the order of given, of {size} {components}"


def other_order(
    function: Callable[..., Any],
    arguments: Sequence[Array],
    parents: Scope,
    due: tuple[int, ...],
) -> str:
    """The order of its arguments in which a function does return the shape that is due, if any."""
    if not 1 < len(parents) == len(arguments) <= _MOST:
        return ""
    for places in permutations(range(len(parents))):
        if _returns(function, [arguments[k] for k in places], due):
            names = ", ".join(repr(parents[k]) for k in places)
            return (
                f"; function({names}) does return the shape that is due, but arguments come in "
                f"the order of given, ({', '.join(map(repr, parents))}): change either"
            )
    return ""


def _returns(
    function: Callable[..., Any], arguments: Sequence[Array], due: tuple[int, ...]
) -> bool:
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return bool(np.shape(function(*arguments)) == due)
    except Exception:
        return False
