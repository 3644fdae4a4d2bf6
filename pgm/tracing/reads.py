"""Surroundings of functions: all that one reads beside its arguments, and whether it changed.

A trace is what a function did once. The function does the same as long as its code is the same, and
so is what this reads: cells of closures, defaults, globals, and attributes of modules, objects and
their classes. Where these are numbers, small arrays, functions of NumPy, and other functions of
this kind, nothing changes unseen. Of a function that reads anything else, such as a list, or an
object that has properties or operators of its own, nothing is claimed.

Code names the attributes that it reads, not what it reads them of: whatever has an attribute of a
name that is met anywhere is taken to be read.
"""

from __future__ import annotations

import builtins
import dis
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from types import (
    BuiltinFunctionType,
    ClassMethodDescriptorType,
    CodeType,
    FunctionType,
    GetSetDescriptorType,
    MemberDescriptorType,
    MethodDescriptorType,
    MethodType,
    ModuleType,
    WrapperDescriptorType,
)
from typing import Any, NamedTuple, Protocol

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
# Attributes of a class that are asked for by name alone, or by nothing.
_IDLE = frozenset(
    {
        *("__annotations__", "__dataclass_fields__", "__dataclass_params__", "__dict__", "__doc__"),
        *("__firstlineno__", "__match_args__", "__module__", "__qualname__", "__slots__"),
        *("__static_attributes__", "__weakref__", "__init__", "__post_init__", "__call__"),
        *("__repr__", "__str__", "__getstate__", "__setstate__", "__replace__"),
        *("__eq__", "__hash__", "__setattr__", "__delattr__"),
    }
)
# Names in NumPy of what is no function of its arguments: it draws, or reads files or settings.
_CHANGING = frozenset(
    {"random", "load", "loadtxt", "genfromtxt", "fromfile", "memmap", "geterr", "getbufsize"}
)
# Instructions that read what no name tells, or change what is read.
_REFUSED = "IMPORT", "BUILD_CLASS", "MATCH_CLASS", "STORE_ATTR", "DELETE_ATTR"
# The flag of a class that a program has made, and kinds of attributes that those of C have.
_OF_PROGRAM = 1 << 9
_OF_C = (
    *(BuiltinFunctionType, ClassMethodDescriptorType, GetSetDescriptorType),
    *(MethodDescriptorType, WrapperDescriptorType),
)
# What is found under a name that is no global, and in an empty cell.
_NOTHING = object()


class _Unknown(Exception):
    """Something that may change unseen."""


class Reads:
    """The surroundings that a function reads, as they are now; see `reads_of`."""

    def __init__(self, function: Callable[..., Any]) -> None:
        # All that was looked at, which keeps it: no other object takes its place.
        self._seen: dict[int, object] = {}
        # Where something is looked up, and what was found there.
        self._functions: list[tuple[FunctionType, tuple[object, ...]]] = []
        self._cells: list[tuple[Any, object]] = []
        self._names: list[tuple[_Names, str, object]] = []
        self._arrays: list[tuple[Any, tuple[object, ...]]] = []
        self._objects: list[tuple[object, type, tuple[type, ...]]] = []
        self._dicts: list[tuple[object, object]] = []
        self._listed: list[tuple[Mapping[str, object], tuple[str, ...]]] = []
        # Names of attributes that are met, and what may have them.
        self._attributes: set[str] = set()
        self._holders: list[_Names] = []
        self._add(function)

    def stand(self) -> bool:
        """Whether all is as it was: the same objects, and arrays of the same numbers."""
        for function, parts in self._functions:
            if any(a is not b for a, b in zip(_parts(function), parts, strict=True)):
                return False
        return (
            all(_held(cell) is value for cell, value in self._cells)
            and all(type(x) is kind and kind.__mro__ is mro for x, kind, mro in self._objects)
            and all(getattr(x, "__dict__", None) is held for x, held in self._dicts)
            and all(tuple(held) == listed for held, listed in self._listed)
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
        elif kind is partial and not value.keywords and not vars(value):
            self._add(value.func)
            self._add(value.args)
        elif kind is np.ndarray and value.size <= _LARGEST and value.dtype.kind in "biuf":
            self._arrays.append((value, _numbers(value)))
        elif kind is FunctionType:
            self._add_function(value)
        elif kind is MethodType:
            self._add(value.__func__)
            self._add(value.__self__)
        elif kind is ModuleType:
            if "__getattr__" in vars(value):
                raise _Unknown
            self._objects.append((value, kind, kind.__mro__))
            self._look_up(vars(value), ["__getattr__"])
            self._hold(vars(value))
        else:
            self._add_object(value)

    def _add_object(self, value: Any) -> None:
        """An object of a class of a program's own, with all of its attributes."""
        kind = type(value)
        *own, _ = kind.__mro__
        if type(kind) is not type or not all(map(_is_written, own)):
            raise _Unknown
        self._objects.append((value, kind, kind.__mro__))
        self._dicts.append((value, getattr(value, "__dict__", None)))
        held = getattr(value, "__dict__", {})
        self._listed += [(names, tuple(names)) for names in (held, *map(vars, own))]
        self._look_up(held, tuple(held))
        self._meet("__call__")
        for each in map(vars, own):
            self._hold(each)
            slots = [name for name in each if type(each[name]) is MemberDescriptorType]
            self._names += [(each, name, each[name]) for name in slots]
            self._look_up(_Slots(value, each), slots)

    def _hold(self, names: _Names) -> None:
        """Look up all attributes met so far in a thing that may have them, by name."""
        self._holders.append(names)
        self._look_up(names, tuple(self._attributes))

    def _meet(self, name: str) -> None:
        """Look up an attribute of this name in all that may have it."""
        if name in _CHANGING or (name[:2] == name[-2:] == "__" and name != "__call__"):
            raise _Unknown  # as of obj.__dict__, or obj.__class__, which is not looked up by name
        if name not in self._attributes:
            self._attributes.add(name)
            for names in list(self._holders):
                self._look_up(names, [name])

    def _look_up(self, names: _Names, which: Iterable[str]) -> None:
        for name in which:
            value = names.get(name, _NOTHING)
            self._names.append((names, name, value))
            # A slot's descriptor gives what the object has there, which is looked up itself.
            if value is not _NOTHING and type(value) is not MemberDescriptorType:
                self._add(value)

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
        for code in _codes(function.__code__):
            for name in code.co_names:
                self._meet(name)
        for name in _globals_of(function.__code__):
            value = function.__globals__.get(name, _NOTHING)
            self._names.append((function.__globals__, name, value))
            if value is _NOTHING:
                value = vars(builtins).get(name, _NOTHING)
                self._names.append((vars(builtins), name, value))
            self._add(value)


class _Names(Protocol):
    """Values under names, as a namespace or the slots of an object."""

    def get(self, name: str, default: object, /) -> object: ...


class _Slots(NamedTuple):
    """The values in the slots that one of its classes gives an object, by name."""

    value: object
    own: Mapping[str, Any]

    def get(self, name: str, default: object, /) -> object:
        """The value in a slot; the default in an empty one."""
        try:
            return self.own[name].__get__(self.value)
        except AttributeError:
            return default


def reads_of(function: Callable[..., Any]) -> Reads | None:
    """The surroundings of a function; None where something in them may change unseen."""
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
        return _is_library(value.__name__)
    if isinstance(value, np.ufunc):  # others may be made of a function of Python
        return value is getattr(np, value.__name__, None)
    kind = type(value)
    if kind in (BuiltinFunctionType, type):
        if kind is BuiltinFunctionType and not isinstance(value.__self__, ModuleType | None):
            return False  # a method of something
        return value in _BUILTINS or _root(value) == "numpy"
    if kind is FunctionType:  # by where it is written: others may have the name of its module
        return _is_library(value.__globals__.get("__name__", "")) and value.__closure__ is None
    return kind.__name__ == "_ArrayFunctionDispatcher" and _root(kind) == "numpy"


def _is_library(name: str) -> bool:
    """Whether a module of this name is part of a library, and what it has is its own."""
    root, *rest = str(name).split(".")
    return root in _LIBRARIES and _CHANGING.isdisjoint(rest)


def _root(value: Any) -> str:
    return str(getattr(value, "__module__", "")).partition(".")[0]


def _is_written(kind: type) -> bool:
    """Whether a class is written in Python, and its objects do nothing but where they are named."""
    if not kind.__flags__ & _OF_PROGRAM:
        return False
    for name, held in vars(kind).items():
        if name[:2] == "__" and name not in _IDLE:
            return False
        if type(held) in _OF_C and name not in ("__dict__", "__weakref__"):
            return False
        # That of a dataclass compares attributes, all of which are looked at.
        if name == "__eq__" and getattr(held, "__code__", None) and not _is_generated(held):
            return False
    return True


def _is_generated(function: Any) -> bool:
    return bool(function.__code__.co_filename == "<string>")


def _globals_of(code: CodeType) -> Iterator[str]:
    """The globals and builtins that code reads, and code inside it."""
    for part in _codes(code):
        for each in dis.get_instructions(part):
            if any(word in each.opname for word in _REFUSED):
                raise _Unknown
            if "GLOBAL" in each.opname or each.opname == "LOAD_NAME":
                yield str(each.argval)


def _codes(code: CodeType) -> Iterator[CodeType]:
    """Code, and code inside it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)
