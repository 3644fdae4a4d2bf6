"""Scopes: which variables, in which order, share one stacked vector."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from pgm.errors import ModelError
from pgm.kernels.arrays import Array, Index, Mask, as_index
from pgm.variables import Variable

Scope = tuple[Variable, ...]

# How many of many items a message lists.
MOST = 8


def as_scope(scope: Variable | Iterable[Variable], what: str = "a scope") -> Scope:
    """A variable or several, as a tuple; refuses what is no variable, and repeats."""
    if isinstance(scope, Variable | str) or not isinstance(scope, Iterable):
        scope = (scope,)
    result = tuple(scope)
    for variable in result:
        if not isinstance(variable, Variable):
            raise ModelError(f"{what} holds variables, not {variable!r}; give the variable itself")
    if len(set(result)) < len(result):
        twice = next(v for v in result if result.count(v) > 1)
        raise ModelError(f"{what} holds {twice!r} twice; name each variable once", variable=twice)
    return result


def names(scope: Iterable[Variable]) -> str:
    """The variables' names, for messages."""
    return "(" + ", ".join(map(repr, scope)) + ")"


def listed(items: Iterable[object], most: int = MOST) -> str:
    """The first few of some items, for messages that must not grow with the network."""
    found = tuple(items)
    shown = ", ".join(map(repr, found[:most]))
    return shown if len(found) <= most else f"{shown}, ... ({len(found)} in all)"


def dimension(scope: Iterable[Variable]) -> int:
    """Number of components of the stacked vector."""
    return sum(variable.dimension for variable in scope)


def angle_mask(scope: Sequence[Variable]) -> Mask:
    """Which components of the stacked vector are angles."""
    if not scope:
        return np.zeros(0, dtype=bool)
    return np.concatenate([variable.angle_mask for variable in scope])


def positions(scope: Sequence[Variable], wanted: Iterable[Variable]) -> Index:
    """Where the components of some variables stand in the stacked vector of a scope."""
    starts = dict(zip(scope, np.cumsum([0, *(v.dimension for v in scope)]), strict=False))
    places: list[int] = []
    for variable in wanted:
        if variable not in starts:
            raise ModelError(
                f"{variable!r} is not in the scope ({listed(scope)})", variable=variable
            )
        places.extend(range(starts[variable], starts[variable] + variable.dimension))
    return as_index(places)


def as_value(variable: Variable, value: object, what: str = "value") -> Array:
    """A value of a variable as an array (..., dimension); a scalar may be a Python number."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ModelError(
            f"{variable!r}: the {what} must be numbers, not {value!r}", variable=variable
        ) from None
    if array.ndim == 0 and variable.dimension == 1:
        array = array[None]
    if array.ndim == 0 or array.shape[-1] != variable.dimension:
        raise ModelError(
            f"{variable!r}: the {what} has shape {array.shape}; its last axis must hold the "
            f"{variable.dimension} components ({listed(variable.components)})",
            variable=variable,
        )
    if not np.isfinite(array).all():
        raise ModelError(
            f"{variable!r}: the {what} has entries that are NaN or infinite", variable=variable
        )
    return array
