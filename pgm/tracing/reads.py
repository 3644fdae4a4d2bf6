"""What a function reads beside its arguments, and whether all of it is as it was.

A trace is what a function did once. The function does the same as long as its code is the same, and
so is what this reads: cells of closures, defaults, globals. Where these are numbers, small arrays,
functions of NumPy, and other functions of this kind, nothing changes unseen. Of a function that
reads anything else, such as a list, an attribute, or a module of one's own, nothing is claimed.
"""

from __future__ import annotations

import builtins
import dis
from collections.abc import Callable, Iterator
from functools import partial
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

# Kinds of objects that cannot change, and hold no others.
_FIXED = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))
# Modules whose functions are taken to stay as they are.
_LIBRARIES = frozenset({"numpy", "math", "pgm"})
_BUILTINS = frozenset(
    {
        *(abs, all, any, bool, divmod, enumerate, float, int, isinstance, len, list, map, max),
        *(min, pow, range, reversed, round, slice, sum, tuple, zip),
    }
)
# Arrays of so many numbers at most are compared.
_LARGEST = 256
# What is found under a name that is no global, and in an empty cell.
_NOTHING = object()


class _Unknown(Exception):
    """Something that may change unseen."""


class Reads:
    """What a function reads, as it is now; see `reads_of`."""

    def __init__(self, function: Callable[..., Any]) -> None:
        # All that was looked at, which keeps it: no other object takes its place.
        self._seen: dict[int, object] = {}
        # Where something is looked up, and what was found there.
        self._functions: list[tuple[FunctionType, tuple[object, ...]]] = []
        self._cells: list[tuple[Any, object]] = []
        self._names: list[tuple[dict[str, Any], str, object]] = []
        self._arrays: list[tuple[Any, tuple[object, ...]]] = []
        self._add(function)

    def stand(self) -> bool:
        """Whether all is as it was: the same objects, and arrays of the same numbers."""
        for function, parts in self._functions:
            if any(a is not b for a, b in zip(_parts(function), parts, strict=True)):
                return False
        return (
            all(_held(cell) is value for cell, value in self._cells)
            and all(names.get(name, _NOTHING) is value for names, name, value in self._names)
            and all(_numbers(array) == numbers for array, numbers in self._arrays)
        )

    def _add(self, value: Any) -> None:
        if id(value) in self._seen:
            return
        self._seen[id(value)] = value
        kind = type(value)
        number = isinstance(value, np.number | np.bool_) and _root(kind) == "numpy"
        if kind in _FIXED or number or _is_of_library(value):
            return
        if kind in (tuple, frozenset):
            for each in value:
                self._add(each)
        elif kind is partial and not value.keywords:
            self._add(value.func)
            self._add(value.args)
        elif kind is np.ndarray and value.size <= _LARGEST and value.dtype.kind in "biuf":
            self._arrays.append((value, _numbers(value)))
        elif kind is FunctionType:
            self._add_function(value)
        else:
            raise _Unknown

    def _add_function(self, function: FunctionType) -> None:
        parts = _parts(function)
        self._functions.append((function, parts))
        if function.__kwdefaults__ or function.__dict__:
            raise _Unknown
        self._add(function.__defaults__)
        for cell in function.__closure__ or ():
            value = _held(cell)
            self._cells.append((cell, value))
            if value is not _NOTHING:
                self._add(value)
        for name in _globals_of(function.__code__):
            value = function.__globals__.get(name, _NOTHING)
            self._names.append((function.__globals__, name, value))
            if value is _NOTHING:
                value = vars(builtins).get(name, _NOTHING)
                self._names.append((vars(builtins), name, value))
            self._add(value)


def reads_of(function: Callable[..., Any]) -> Reads | None:
    """What a function reads; None where something of it may change unseen."""
    try:
        return Reads(function)
    except _Unknown:
        return None


def _parts(function: FunctionType) -> tuple[object, ...]:
    """The parts of a function that others may take the place of."""
    own = function.__dict__ or None, function.__kwdefaults__ or None
    return function.__code__, function.__defaults__, *own


def _held(cell: Any) -> object:
    try:
        return cell.cell_contents
    except ValueError:  # of an empty one
        return _NOTHING


def _numbers(array: Any) -> tuple[object, ...]:
    return array.shape, array.dtype, array.tobytes()


def _is_of_library(value: Any) -> bool:
    """Whether an object is a part of a library, and reads nothing of a program's own."""
    if isinstance(value, ModuleType):
        return value.__name__.partition(".")[0] in _LIBRARIES
    if isinstance(value, np.ufunc):  # others may be made of a function of Python
        return value is getattr(np, value.__name__, None)
    kind = type(value)
    if kind in (BuiltinFunctionType, type):
        if kind is BuiltinFunctionType and not isinstance(value.__self__, ModuleType | None):
            return False  # a method of something
        return value in _BUILTINS or _root(value) == "numpy"
    if kind is FunctionType:
        return _root(value) in _LIBRARIES and value.__closure__ is None
    return kind.__name__ == "_ArrayFunctionDispatcher" and _root(kind) == "numpy"


def _root(value: Any) -> str:
    return str(getattr(value, "__module__", "")).partition(".")[0]


def _globals_of(code: CodeType) -> Iterator[str]:
    """The globals and builtins that code reads, and code inside it."""
    for each in dis.get_instructions(code):
        if "IMPORT" in each.opname or "BUILD_CLASS" in each.opname:
            raise _Unknown
        if "GLOBAL" in each.opname or each.opname == "LOAD_NAME":
            yield str(each.argval)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _globals_of(constant)
