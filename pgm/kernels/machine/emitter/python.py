"""Functions of machine code that Python calls as its own, and Python's objects in machine code.

An object is known by its address, and touched through Python's stable interface alone, so that it
may be of any kind: what is wrong raises an exception. Memory of arrays is lent by the buffer
protocol; whatever is borrowed in a call is given back where it ends, in whichever way.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE, Kind
from pgm.kernels.machine.emitter.memory import Cells
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Address, Whole

if TYPE_CHECKING:
    from pgm.kernels.machine.emitter.compiled import Compiled

_CALLED_WITH_AN_ARRAY = 0x80  # METH_FASTCALL
_CONTIGUOUS = 0x08 | 0x04  # PyBUF_ND | PyBUF_FORMAT
# Where a Py_buffer of 80 bytes has the address, the owner, and its format and shape.
_BUFFER, _OWNER, _FORMAT, _SHAPE, _WIDE = 0, 1, 5, 6, 10
# The text "d" of a float64 in the machine's own order of bytes, as a number of 16 bits.
_DOUBLE = int.from_bytes(b"d\0", "little")
# Words of exceptions, which stay in memory as long as code that refers to them.
_TOO_SHORT = ctypes.create_string_buffer(b"more bytes were due")
_OTHER_COUNT = ctypes.create_string_buffer(b"another number of arguments was due")

Objects = tuple[Address, ...]


class Python:
    """Python's interface, for code that is called with Python's objects.

    `me` is the tuple that the function is bound to, and `given` are its arguments.
    """

    def __init__(self, code: Code, count: int) -> None:
        self.code = code
        self.me, given, self._held, self._views = code.arguments
        objects = Cells(code, given, Address)
        self.given: Objects = tuple(map(objects.load, range(count)))
        self.holds, self.lends = 0, 0

    def call(self, name: str, *given: Any, result: Kind | None = ADDRESS) -> Any:
        """The value of one of Python's functions."""
        code = self.code
        values = [code.whole(each) if isinstance(each, int) else each for each in given]
        return code.call_at(code.address(_function(name)), *values, result=result)

    @property
    def null(self) -> Address:
        """No object; given back, it says that an exception is set."""
        return Address(self.code, "null")

    def none(self) -> Address:
        """None, as a value to give back."""
        none = self.code.address(id(None))
        self.call("Py_IncRef", none, result=None)
        return none

    def give_null_if(self, truth: Number) -> None:
        """End the function, an exception being set, where a truth holds."""
        with self.code.when(truth):
            self.code.give(self.null)

    def give_none_unless(self, truth: Number) -> None:
        """End the function with None, unless a truth holds."""
        with self.code.when(~truth):
            self.code.give(self.none())

    def mine(self, place: int) -> Address:
        """An item of the tuple that the function is bound to."""
        found: Address = self.call("PyTuple_GetItem", self.me, place)
        return found

    def is_same(self, a: Address, b: Address) -> Number:
        """Whether two objects are one."""
        return Number(self.code, self.code.value(f"icmp eq ptr {a.text}, {b.text}"), truth=True)

    def is_a(self, thing: Address, kind: Address) -> Number:
        """Whether an object is of a class, and of none that is derived from it."""
        found = self.call("PyObject_Type", thing)
        self.call("Py_DecRef", found, result=None)
        return self.is_same(found, kind)

    def attribute(self, thing: Address, name: Address) -> Address:
        """An attribute of an object, held until the function ends."""
        found = self.call("PyObject_GetAttr", thing, name)
        Cells(self.code, self._held, Address).store(self.holds, found)
        self.holds += 1
        self.give_null_if(found.is_null())
        return Address(self.code, found.text)

    def bytes(self, thing: Address, size: int) -> Address:
        """The memory of a bytes object of that size or more; anything else is an exception."""
        found: Address = self.call("PyBytes_AsString", thing)
        self.give_null_if(found.is_null())
        with self.code.when(self.call("PyBytes_Size", thing, result=WHOLE) < size):
            _refuse(self.code, "ValueError", _TOO_SHORT)
        return found

    def items(self, thing: Address, count: int) -> list[tuple[Address, Address]]:
        """The keys and values of a dict of so many; the function ends with None for another."""
        code = self.code
        self.give_none_unless(self.is_a(thing, code.address(id(dict))))
        self.give_none_unless(self.call("PyDict_Size", thing, result=WHOLE) == count)
        at, key, value = (Address(code, code.reserve(kind)) for kind in ("i64", "ptr", "ptr"))
        Cells(code, at, Whole).store(0, code.whole(0))
        found = []
        for _ in range(count):
            self.call("PyDict_Next", thing, at, key, value, result=WHOLE)
            found.append((Cells(code, key, Address).load(0), Cells(code, value, Address).load(0)))
        return found

    def floats(self, thing: Address, kind: Address, axes: int) -> tuple[Address, list[Whole]]:
        """The memory of an array of float64, and its shape.

        The function ends with None where the object is not of this class of arrays, or its memory
        is of another kind, or not contiguous.
        """
        code = self.code
        self.give_none_unless(self.is_a(thing, kind))
        view = self._views.moved(_WIDE * self.lends, "i64")
        self.lends += 1
        failed = self.call("PyObject_GetBuffer", thing, view, _CONTIGUOUS, result=WHOLE)
        with code.when(_c_int(failed) != 0):
            self.call("PyErr_Clear", result=None)
            code.give(self.none())
        cells = Cells(code, view, Address)
        letters = code.value(f"load i16, ptr {cells.load(_FORMAT).text}, align 1")
        code_of = Whole(code, code.value(f"zext i16 {letters} to i64"))
        self.give_none_unless(code_of == _DOUBLE)
        # The number of axes stands beside `readonly`, in the upper half of a place.
        both = Cells(code, view, Whole).load(4)
        self.give_none_unless(both // 2**32 == axes)
        shape = Cells(code, cells.load(_SHAPE), Whole)
        return cells.load(_BUFFER), [shape.load(k) for k in range(axes)]


def written(module: Module, name: str, count: int, write: Callable[[Python], None]) -> None:
    """Write a function of so many arguments that Python calls, as `write` gives its value."""
    passed = ADDRESS, ADDRESS, ADDRESS, ADDRESS
    inner = module.function(f"{name} inside", passed, ADDRESS, internal=True)
    python = Python(inner, count)
    write(python)
    code = module.function(name, (ADDRESS, ADDRESS, WHOLE), ADDRESS)
    me, given, number = code.arguments
    held = Address(code, code.reserve(f"[{python.holds + 1} x ptr]"))
    views = Address(code, code.reserve(f"[{_WIDE * python.lends + 1} x i64]"))
    null = Address(code, "null")
    objects, lent = Cells(code, held, Address), Cells(code, views, Address)
    places = [_WIDE * k + _OWNER for k in range(python.lends)]
    for k in range(python.holds):
        objects.store(k, null)
    for place in places:
        lent.store(place, null)
    with code.when(number != count):
        _refuse(code, "TypeError", _OTHER_COUNT)
    found = code.variable(code.call(inner, me, given, held, views))
    for place in places:
        release = code.address(_function("PyBuffer_Release"))
        code.call_at(release, views.moved(place - _OWNER, "i64"))
    for k in range(python.holds):
        code.call_at(code.address(_function("Py_DecRef")), objects.load(k))
    code.give(found.get())


def bound(machine: Compiled, name: str, values: tuple[object, ...]) -> Callable[..., Any]:
    """A written function for Python, bound to a tuple.

    It owns its machine code: all that it needs is in the tuple, which Python keeps as long.
    """
    definition = _Definition(name.encode(), machine.address(name), _CALLED_WITH_AN_ARRAY, None)
    owned = *values, machine, definition
    found: Callable[..., Any] = _new_function()(ctypes.addressof(definition), owned, None)
    return found


class _Definition(ctypes.Structure):
    """A PyMethodDef."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("function", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("doc", ctypes.c_char_p),
    )


@cache
def _new_function() -> Any:
    kind = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p)
    return kind(("PyCFunction_NewEx", ctypes.pythonapi))


@cache
def _function(name: str) -> int:
    """Where a function of Python's interface begins."""
    found = ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value
    assert found is not None
    return found


def _refuse(code: Code, kind: str, words: ctypes.Array[ctypes.c_char]) -> None:
    """End a function with an exception."""
    error, text = code.address(_exception(kind)), code.address(ctypes.addressof(words))
    code.call_at(code.address(_function("PyErr_SetString")), error, text)
    code.give(Address(code, "null"))


def _exception(name: str) -> int:
    """The address of a class of exceptions, which lives as long as Python."""
    found = ctypes.c_void_p.in_dll(ctypes.pythonapi, f"PyExc_{name}").value
    assert found is not None
    return found


def _c_int(whole: Whole) -> Whole:
    """The int of 32 bits that a function has returned, as a whole number without sign."""
    return whole % 2**32
