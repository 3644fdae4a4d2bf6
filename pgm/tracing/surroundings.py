"""Whether all that a function refers to is still what it was."""

from __future__ import annotations

import dis
import functools
import sys
import types
from abc import ABCMeta
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from pgm.kernels.arrays import Array

_FIXED: tuple[type, ...] = (bool, int, float, complex, str, bytes, types.NoneType, slice)
_FIXED += (types.EllipsisType, np.generic, np.dtype, np.ufunc)
# What classes have for slots and for the fields of named tuples.
_FIELDS = (types.MemberDescriptorType, type(vars(namedtuple("_Pair", "a b"))["a"]))
_OWN = (types.ModuleType, type, types.BuiltinFunctionType, types.FunctionType, type(np.stack))
# By these a function finds what its code does not name.
_HIDDEN = {"eval", "exec", "globals", "locals", "vars", "getattr", "open", "__import__"}
# Methods that operators and conversions do not call.
_NAMED = "new init post_init call repr str format eq ne hash setattr delattr getstate setstate "
_NAMED += "getnewargs reduce reduce_ex copy deepcopy replace sizeof dir annotate annotate_func"
_HARMLESS = {f"__{name}__" for name in _NAMED.split()}
_SMALL = 1024  # bytes of an array
# How something is read, and what was read.
Read = tuple[Callable[[], Any], Any]


class Surroundings:
    """Globals, closures and defaults of a function, and of the functions that it calls.

    Of modules and objects, the attributes that one of these functions names. `known` is False where
    there is anything that could change without being rebound, such as a list, a large array, or an
    object with operators.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.known = True
        # Of quantities and objects, and of modules, classes and functions; and arrays.
        self.values: list[Read] = []
        self._code: list[Read] = []
        self.arrays: list[tuple[Array, bytes]] = []
        self._names = {"__call__"}
        self._holders: list[Any] = []  # of attributes
        self._seen: set[tuple[int, str]] = set()
        self._visit(function)
        count = -1
        while count < len(self._seen):
            count = len(self._seen)
            for holder in tuple(self._holders):
                self._attributes(holder)

    def same(self) -> bool:
        """Whether it is known that nothing has changed."""
        return self.known and hold((*self.values, *self._code), self.arrays)

    def _visit(self, value: Any) -> None:
        if isinstance(value, _FIXED + _FIELDS) or _trusted(value) or not self._new(value):
            return
        if isinstance(value, types.FunctionType):
            self._function(value)
        elif isinstance(value, np.ndarray) and value.dtype != object and value.nbytes <= _SMALL:
            self.arrays.append((value, value.tobytes()))
        elif isinstance(value, types.MethodType):
            self._visit(value.__func__)
            self._visit(value.__self__)
        elif isinstance(value, functools.partial):
            for part in (value.func, *value.args, *value.keywords.values()):
                self._visit(part)
        elif isinstance(value, types.ModuleType) or _is_plain(type(value)):
            self._holders.append(value)
            for part in value if isinstance(value, tuple | frozenset) else ():
                self._visit(part)
        else:
            self.known = False

    def _attributes(self, holder: Any) -> None:
        """The attributes of a module or an object that are named."""
        own, kinds = getattr(holder, "__dict__", {}), type(holder).__mro__
        for name in tuple(self._names):
            places = [place for place in (own, *map(vars, kinds)) if name in place]
            if not places or not self._new(holder, name):
                continue
            for place in places:
                self._watch(functools.partial(place.get, name))
            if isinstance(places[0][name], types.MemberDescriptorType):  # of a slot
                self._watch(functools.partial(getattr, holder, name, None))
            elif places[0] is not own and not isinstance(places[0][name], _OWN):
                self._watch(functools.partial(own.get, name))  # which would come first

    def _function(self, function: types.FunctionType) -> None:
        names = {name for part in _codes(function.__code__) for name in part.co_names}
        self._names |= names
        self.known &= not names & _HIDDEN and vars(function).keys() <= {"__wrapped__"}
        for attribute in ("__code__", "__defaults__", "__kwdefaults__"):
            read = functools.partial(getattr, function, attribute)
            self._code.append((read, read()))
        for value in (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()):
            self._visit(value)
        for cell in function.__closure__ or ():
            self._watch(functools.partial(_held, cell))
        for name in names:
            if name in function.__globals__:
                self._watch(functools.partial(function.__globals__.get, name))
            elif name in sys.modules and name in _imported(function.__code__):
                self._visit(sys.modules[name])

    def _watch(self, read: Callable[[], Any]) -> None:
        value = read()
        (self._code if isinstance(value, _OWN + _FIELDS) else self.values).append((read, value))
        self._visit(value)

    def _new(self, value: Any, name: str = "") -> bool:
        count = len(self._seen)
        self._seen.add((id(value), name))
        return len(self._seen) > count


def hold(reads: Iterable[Read], arrays: Sequence[tuple[Array, bytes]]) -> bool:
    """Whether what is read is what was read, and arrays are as they were."""
    for read, value in reads:
        if read() is not value:
            return False
    return not arrays or all(each.tobytes() == held for each, held in arrays)


def _is_plain(kind: type) -> bool:
    """Whether instances are what is read of them by name, or, of tuples, their elements."""
    if kind in (tuple, frozenset, object):
        return True
    dunders = {name for name, each in vars(kind).items() if name[:2] == "__" and callable(each)}
    known = type(kind) in (type, ABCMeta) and dunders <= _HARMLESS
    return known and all(map(_is_plain, kind.__bases__))


def _trusted(value: Any) -> bool:
    """Whether a module, a class or a function is NumPy's or Python's own."""
    if isinstance(value, types.BuiltinFunctionType) and not isinstance(
        value.__self__, types.ModuleType
    ):
        return False  # a method, of an object that may change
    name = getattr(value, "__name__" if isinstance(value, types.ModuleType) else "__module__", None)
    package = (name or "").partition(".")[0]
    return isinstance(value, _OWN) and package in ("numpy", "math", "builtins")


def _held(cell: types.CellType) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # of a variable that has no value yet
        return None


def _imported(code: types.CodeType) -> set[str]:
    steps = (step for part in _codes(code) for step in dis.get_instructions(part))
    return {step.argval for step in steps if step.opname == "IMPORT_NAME"}


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    yield code
    for part in code.co_consts:
        if isinstance(part, types.CodeType):
            yield from _codes(part)
