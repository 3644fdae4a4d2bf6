"""Whether all that a function refers to is still what it was."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields
from types import (
    BuiltinFunctionType,
    CodeType,
    EllipsisType,
    FunctionType,
    MethodType,
    ModuleType,
    NoneType,
)
from typing import Any

import numpy as np

_CONSTANT: tuple[type, ...] = (bool, int, float, complex, str, bytes, NoneType, EllipsisType)
_CONSTANT += (slice, np.generic, np.dtype, np.ufunc)
# By these a function finds what its code does not name.
_HIDDEN = {"eval", "exec", "globals", "locals", "vars", "getattr", "open", "__import__"}
_SMALL = 1024  # bytes of an array


class Surroundings:
    """Globals, closures and defaults of a function, and of the functions that it calls.

    `known` is False where there is anything that could change without being rebound, such as an
    object with attributes, a list or a large array.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.known = True
        self._reads: list[tuple[Callable[[], Any], Any]] = []
        self._arrays: list[tuple[Any, bytes]] = []
        self._seen: set[int] = set()
        self._visit(function, frozenset())

    def same(self) -> bool:
        """Whether it is known that nothing has changed."""
        return (
            self.known
            and all(read() is value for read, value in self._reads)
            and all(array.tobytes() == held for array, held in self._arrays)
        )

    def _visit(self, value: Any, names: frozenset[str]) -> None:
        if isinstance(value, _CONSTANT) or _trusted(value):
            return
        if isinstance(value, ModuleType):
            for name in names & value.__dict__.keys():
                self._watch(functools.partial(value.__dict__.get, name), names)
            return
        if id(value) in self._seen:
            return
        self._seen.add(id(value))
        if isinstance(value, FunctionType):
            self._function(value)
        elif isinstance(value, MethodType):
            self._visit(value.__func__, names)
            self._visit(value.__self__, names)
        elif isinstance(value, functools.partial):
            for part in (value.func, *value.args, *value.keywords.values()):
                self._visit(part, names)
        elif isinstance(value, tuple | frozenset):
            for part in value:
                self._visit(part, names)
        elif isinstance(value, np.ndarray) and value.dtype != object and value.nbytes <= _SMALL:
            self._arrays.append((value, value.tobytes()))
        elif _frozen(value):
            calls = [vars(each).get("__call__") for each in type(value).__mro__]
            for part in (*calls, *(getattr(value, field.name) for field in fields(value))):
                self._visit(part, names)
        else:
            self.known = False

    def _function(self, function: FunctionType) -> None:
        names = frozenset(_named(function.__code__))
        self.known &= not names & _HIDDEN
        for attribute in ("__code__", "__defaults__", "__kwdefaults__"):
            read = functools.partial(getattr, function, attribute)
            self._reads.append((read, read()))
        for value in (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()):
            self._visit(value, names)
        for cell in function.__closure__ or ():
            self._watch(functools.partial(getattr, cell, "cell_contents", None), names)
        for name in names:
            if name in function.__globals__:
                self._watch(functools.partial(function.__globals__.get, name), names)
            elif name in sys.modules:  # imported inside
                self._visit(sys.modules[name], names)

    def _watch(self, read: Callable[[], Any], names: frozenset[str]) -> None:
        value = read()
        self._reads.append((read, value))
        self._visit(value, names)


def _frozen(value: Any) -> bool:
    """Whether a value is one of a frozen dataclass."""
    parameters = getattr(type(value), "__dataclass_params__", None)
    return parameters is not None and bool(parameters.frozen)


def _trusted(value: Any) -> bool:
    """Whether a module, a class or a function is NumPy's or Python's own."""
    if isinstance(value, BuiltinFunctionType) and not isinstance(value.__self__, ModuleType):
        return False  # a method, of an object that may change
    name = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
    own = (ModuleType, type, BuiltinFunctionType, FunctionType, type(np.stack))
    return isinstance(value, own) and (name or "").partition(".")[0] in (
        "numpy",
        "math",
        "builtins",
    )


def _named(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield from _named(part)
