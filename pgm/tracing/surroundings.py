"""Whether all that a function refers to is still what it was."""

from __future__ import annotations

import dis
import functools
import types
from abc import ABCMeta
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from pgm.kernels.arrays import Array

# What classes have for slots and for the fields of named tuples.
_FIELDS = (types.MemberDescriptorType, type(vars(namedtuple("_Pair", "a b"))["a"]))
_FIXED: tuple[type, ...] = (bool, int, float, complex, str, bytes, types.NoneType, slice)
_FIXED += (types.EllipsisType, np.generic, np.dtype, np.ufunc, *_FIELDS)
_OWN = (types.ModuleType, type, types.BuiltinFunctionType, types.FunctionType, type(np.stack))
# By these a function finds what its code does not name, or what is not there yet.
_HIDDEN = {"eval", "exec", "globals", "locals", "vars", "getattr", "hasattr", "open"}
_HIDDEN |= {"AttributeError", "NameError", "Exception", "MATCH_CLASS"}
_HIDDEN |= {"__import__", "__globals__", "__class__", "__getattribute__", "__annotations__"}
# By these it calls methods that its code does not name.
_CALLS = {"==": "__eq__", "!=": "__eq__", "CONTAINS_OP": "__eq__", "hash": "__hash__"}
_CALLS |= {"type": "__init__", "str": "__str__", "repr": "__repr__"}
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
        self.arrays: list[tuple[Array, Any]] = []
        self._names = {"__call__", "__getattr__"}
        self._holders: list[Any] = []  # of attributes
        self._seen: set[tuple[int, str]] = set()
        count = -1
        try:
            self._visit(function)
            while self.known and count < len(self._seen):
                count = len(self._seen)
                for holder in tuple(self._holders):
                    self._attributes(holder)
        except Exception:  # an object may refuse to be looked at; functions may lie deep
            self.known = False

    def same(self) -> bool:
        """Whether it is known that nothing has changed."""
        return self.known and hold((*self.values, *self._code), self.arrays)

    def _visit(self, value: Any) -> None:
        if not self.known or _fixed(value) or _trusted(value) or not self._new(value):
            return
        if isinstance(value, types.FunctionType):
            self._function(value)
        elif type(value) is np.ndarray and value.dtype.kind in "biufc" and value.nbytes <= _SMALL:
            self.arrays.append((value, _content(value)))
        elif type(value) in (types.MethodType, property, functools.cached_property, staticmethod):
            for part in ("__func__", "__self__", "fget", "func"):
                self._visit(getattr(value, part, None))
        elif type(value) is functools.partial and not vars(value):
            for part in (value.func, *value.args, *value.keywords.values()):
                self._visit(part)
        elif isinstance(value, types.ModuleType) or _is_plain(_class(value)):
            self._holders.append(value)
            if isinstance(value, type):  # the function may make one
                self._names |= {"__new__", "__init__", "__post_init__"}
            elif not isinstance(value, types.ModuleType):
                for name in ("__class__", "__dict__"):
                    read = functools.partial(getattr, value, name, None)
                    self._code.append((read, read()))
            for part in value if isinstance(value, tuple | frozenset) else ():
                self._visit(part)
        else:
            self.known = False

    def _attributes(self, holder: Any) -> None:
        """The attributes of a module, a class or an object that are named."""
        kinds = [vars(kind) for kind in _class(holder).__mro__ if not _packaged(kind.__module__)]
        own = kinds.pop(0) if isinstance(holder, type) else getattr(holder, "__dict__", {})
        places = [own, *kinds]
        for name in tuple(self._names):
            having = [place for place in places if name in place]
            if not having or not self._new(holder, name):
                continue
            value = having[0][name]
            shared = having[0] is not own or isinstance(holder, types.ModuleType | type)
            kept = self._code if shared and isinstance(value, _OWN + _FIELDS) else self.values
            for place in places:  # one in a nearer place would come first
                self._watch(functools.partial(place.get, name), kept)
                if place is having[0]:
                    break
            for place in having[1:2] if having[0] is own else ():
                self._visit(place[name])  # which may be a property, which comes before all
            if isinstance(value, types.MemberDescriptorType):  # of a slot
                self._watch(functools.partial(getattr, holder, name, None), self.values)

    def _function(self, function: types.FunctionType) -> None:
        names, known = _named(function.__code__)
        self._names |= names
        self.known &= known and vars(function).keys() <= {"__wrapped__"}
        for attribute in ("__code__", "__defaults__", "__kwdefaults__"):
            read = functools.partial(getattr, function, attribute)
            self._code.append((read, read()))
        for value in (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()):
            self._visit(value)
        for cell in function.__closure__ or ():
            self._watch(functools.partial(_held, cell), self.values)
        for name in names:
            if name in function.__globals__:
                self._watch(functools.partial(function.__globals__.get, name))

    def _watch(self, read: Callable[[], Any], kept: list[Read] | None = None) -> None:
        value = read()
        if kept is None:
            kept = self._code if isinstance(value, _OWN) else self.values
        kept.append((read, value))
        self._visit(value)

    def _new(self, value: Any, name: str = "") -> bool:
        count = len(self._seen)
        self._seen.add((id(value), name))
        return len(self._seen) > count


def hold(reads: Iterable[Read], arrays: Sequence[tuple[Array, Any]]) -> bool:
    """Whether what is read is what was read, and arrays are as they were."""
    for read, value in reads:
        if read() is not value:
            return False
    return not arrays or all(_content(each) == held for each, held in arrays)


def _content(array: Array) -> tuple[Any, ...]:
    return array.tobytes(), array.shape, array.dtype


def _fixed(value: Any) -> bool:
    """Whether a value is a number or the like, not of a class that adds to it."""
    kind = type(value)
    return issubclass(kind, _FIXED) and kind is not np.void and _packaged(kind.__module__)


def _class(value: Any) -> type:
    return value if isinstance(value, type) else type(value)


def _is_plain(kind: type) -> bool:
    """Whether instances are what is read of them by name, or, of tuples, their elements."""
    if kind in (tuple, frozenset, object):
        return True
    dunders = {name for name, each in vars(kind).items() if name[:2] == "__" and callable(each)}
    known = type(kind) in (type, ABCMeta) and dunders <= _HARMLESS
    return known and all(map(_is_plain, kind.__bases__))


def _trusted(value: Any) -> bool:
    """Whether a module, a class or a function is NumPy's or Python's own."""
    if not issubclass(type(value), _OWN):
        return False
    if isinstance(value, types.FunctionType):  # whose __module__ may be of one that it wraps
        return _packaged(value.__globals__.get("__name__"))
    if isinstance(value, types.BuiltinFunctionType) and (
        not isinstance(value.__self__, types.ModuleType) or value.__name__ in _HIDDEN
    ):
        return False  # a method, of an object that may change, or what looks for anything
    return _packaged(value.__name__ if isinstance(value, types.ModuleType) else value.__module__)


def _packaged(name: str | None) -> bool:
    return (name or "").partition(".")[0] in ("numpy", "math", "builtins", "_collections")


def _held(cell: types.CellType) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # of a variable that has no value yet
        return None


@functools.lru_cache(maxsize=1024)
def _named(code: types.CodeType) -> tuple[set[str], bool]:
    """The names in code, of what it calls too, and whether it finds nothing in other ways."""
    steps = [step for part in _codes(code) for step in dis.get_instructions(part)]
    words = {word for step in steps for word in (step.opname, step.argval)}
    names = {name for part in _codes(code) for name in part.co_names}
    names |= {called for word, called in _CALLS.items() if word in words}
    found = all(_packaged(step.argval) for step in steps if step.opname == "IMPORT_NAME")
    hidden = words & _HIDDEN - {"__class__" if code.co_name == "__eq__" else ""}  # of data classes
    return names, found and not hidden


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    yield code
    for part in code.co_consts:
        if isinstance(part, types.CodeType):
            yield from _codes(part)
