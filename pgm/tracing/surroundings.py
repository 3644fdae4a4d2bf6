"""Whether all that a function refers to is still what it was."""

from __future__ import annotations

import dis
import functools
import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import fields
from typing import Any

import numpy as np

_CONSTANT: tuple[type, ...] = (bool, int, float, complex, str, bytes, types.NoneType, slice)
_CONSTANT += (types.EllipsisType, types.MemberDescriptorType, np.generic, np.dtype, np.ufunc)
_OWN = (types.ModuleType, type, types.BuiltinFunctionType, types.FunctionType, type(np.stack))
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
        self._seen: set[int | tuple[type, str]] = set()
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
        if isinstance(value, types.ModuleType):
            for name in names & value.__dict__.keys():
                self._watch(functools.partial(value.__dict__.get, name), names)
            return
        if _is_frozen(value):
            self._members(type(value).__mro__, names | {"__call__"})
        if id(value) in self._seen:
            return
        self._seen.add(id(value))
        if isinstance(value, types.FunctionType):
            self._function(value)
        elif isinstance(value, np.ndarray) and value.dtype != object and value.nbytes <= _SMALL:
            self._arrays.append((value, value.tobytes()))
        else:
            parts = _parts(value)
            self.known &= parts is not None
            if isinstance(own := getattr(value, "__func__", None), types.FunctionType):
                names |= _named(own.__code__)
            for part in parts or ():
                self._visit(part, names)

    def _members(self, kinds: tuple[type, ...], names: frozenset[str]) -> None:
        """The attributes of classes that are named, and that their functions name."""
        for kind in kinds:
            for name in names & vars(kind).keys():
                if (kind, name) not in self._seen:
                    self._seen.add((kind, name))
                    self._watch(functools.partial(vars(kind).get, name), names)
                    if isinstance(part := vars(kind)[name], types.FunctionType):
                        self._members(kinds, _named(part.__code__))

    def _function(self, function: types.FunctionType) -> None:
        names = _named(function.__code__)
        self.known &= not names & _HIDDEN and vars(function).keys() <= {"__wrapped__"}
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
            elif name in sys.modules and name in _imported(function.__code__):
                self._visit(sys.modules[name], names)

    def _watch(self, read: Callable[[], Any], names: frozenset[str]) -> None:
        value = read()
        self._reads.append((read, value))
        self._visit(value, names)


def _parts(value: Any) -> tuple[Any, ...] | None:
    """The parts of a value, which are always the same; None of one that may change."""
    if isinstance(value, types.MethodType):
        return value.__func__, value.__self__
    if isinstance(value, functools.partial):
        return value.func, *value.args, *value.keywords.values()
    if isinstance(value, tuple | frozenset):
        return tuple(value)
    return tuple(getattr(value, f.name) for f in fields(value)) if _is_frozen(value) else None


def _is_frozen(value: Any) -> bool:
    return getattr(getattr(type(value), "__dataclass_params__", None), "frozen", False)


def _trusted(value: Any) -> bool:
    """Whether a module, a class or a function is NumPy's or Python's own."""
    if isinstance(value, types.BuiltinFunctionType) and not isinstance(
        value.__self__, types.ModuleType
    ):
        return False  # a method, of an object that may change
    name = getattr(value, "__name__" if isinstance(value, types.ModuleType) else "__module__", None)
    package = (name or "").partition(".")[0]
    return isinstance(value, _OWN) and package in ("numpy", "math", "builtins")


def _named(code: types.CodeType) -> frozenset[str]:
    return frozenset(name for part in _codes(code) for name in part.co_names)


def _imported(code: types.CodeType) -> set[str]:
    steps = (step for part in _codes(code) for step in dis.get_instructions(part))
    return {step.argval for step in steps if step.opname == "IMPORT_NAME"}


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    yield code
    for part in code.co_consts:
        if isinstance(part, types.CodeType):
            yield from _codes(part)
