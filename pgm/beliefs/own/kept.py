"""Beliefs of a user's own family that nobody changes: arrays are read-only, containers copied.

The beliefs of all steps are kept, and one that a later step changed in place would show as what it
became.
"""

from __future__ import annotations

from copy import copy
from types import FunctionType, MethodType, ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.errors import ModelError

if TYPE_CHECKING:
    from pgm.beliefs.own.family import BeliefFamily

# Copies go so deep: what lies deeper, as the steps before in a belief that refers to them, is of
# beliefs that were kept before.
_DEPTH = 6
# Values that are shared, beside those of the package, which do not change.
_SHARED = (int, float, complex, str, bytes, np.generic, np.random.Generator, type(None))
_CODE = (type, ModuleType, FunctionType, MethodType)


def kept(family: BeliefFamily[Any], method: str, belief: Any) -> Any:
    """The belief that a family's method has returned, as it is kept: see `closed`.

    None, as of a method that returns nothing, and what cannot be copied are refused by a
    ModelError.
    """
    if belief is None:
        raise ModelError(f"{family!r}: {method} returned None; a belief was due")
    try:
        return closed(belief)
    except Exception as error:  # of any kind, by what the belief refers to
        raise ModelError(
            f"{family!r}: the belief that {method} returned cannot be copied, as those of all "
            f"steps are: {type(error).__name__}: {error}; make it of arrays and numbers"
        ) from error


def closed(value: Any, depth: int = _DEPTH) -> Any:
    """A value that nobody else changes: its arrays are read-only, and shared if they were before.

    Tuples, lists, mappings and objects are copied where they hold what can be changed. So a method
    that is handed another such copy may change it, and no other step is changed.
    """
    if type(value) is np.ndarray and value.dtype != object:
        return value if value.flags.owndata and not value.flags.writeable else _frozen(value.copy())
    if not depth or isinstance(value, _SHARED + _CODE):
        return value
    if isinstance(value, np.ndarray):
        return _other_array(value, depth)
    if isinstance(value, tuple):
        parts = [closed(each, depth - 1) for each in value]
        same = all(new is old for new, old in zip(parts, value, strict=True))
        if same and not hasattr(value, "__dict__"):
            return value
        return _with_attributes(tuple.__new__(type(value), parts), value, depth)
    if isinstance(value, list):
        found: Any = copy(value)
        found[:] = [closed(each, depth - 1) for each in value]
        return _with_attributes(found, value, depth)
    if isinstance(value, dict):
        found = copy(value)
        for key, each in value.items():
            found[key] = closed(each, depth - 1)
        return _with_attributes(found, value, depth)
    if isinstance(value, set | bytearray):
        return copy(value)
    if type(value).__module__.startswith("pgm.") or not _attributes(value):
        return value
    return _with_attributes(copy(value), value, depth)


def _frozen(array: Any) -> Any:
    array.flags.writeable = False
    return array


def _other_array(value: Any, depth: int) -> Any:
    """A read-only copy of an array of objects, or of a subclass of arrays with its attributes."""
    found = value.copy()
    if value.dtype == object:
        for place in np.ndindex(value.shape):
            found[place] = closed(value[place], depth - 1)
    _with_attributes(found, value, depth)
    return _frozen(found)


def _attributes(value: Any) -> dict[str, Any]:
    """The attributes of an object's own, in slots or not."""
    slots: list[str] = []
    for kind in type(value).__mro__:
        own = vars(kind).get("__slots__", ())
        slots += [own] if isinstance(own, str) else own
    found = {name: getattr(value, name) for name in slots if hasattr(value, name)}
    return found | getattr(value, "__dict__", {})


def _with_attributes(found: Any, value: Any, depth: int) -> Any:
    """A copy, with the attributes of the value closed."""
    for name, each in _attributes(value).items():
        if name not in ("__dict__", "__weakref__"):
            object.__setattr__(found, name, closed(each, depth - 1))
    return found
