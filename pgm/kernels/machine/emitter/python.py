"""Functions of machine code that Python calls as its own, and Python's objects in machine code.

An object is known by its address, and may be of any kind: what is wrong raises an exception. It is
touched through Python's stable interface, but for its class, its slots, and the contents of tuples
and bytes. These are read where they lie, since their functions take as long as the arithmetic of a
small step; the place is looked for in objects whose contents are known (`_place_in`). Of arrays see
`arrays`. Whatever is made in a call is held until it ends, in whichever way.
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
# Where bytes have their count, and begin.
_SIZE, _BYTES = object.__basicsize__, bytes.__basicsize__ - 1
# Words of exceptions, which stay in memory as long as code that refers to them.
_NO_BYTES = ctypes.create_string_buffer(b"bytes were due")
_TOO_SHORT = ctypes.create_string_buffer(b"more bytes were due")
_OTHER_COUNT = ctypes.create_string_buffer(b"another number of arguments was due")

Objects = tuple[Address, ...]


class Python:
    """Python's interface, for code that is called with Python's objects.

    `me` is the tuple that the function is bound to, and `given` are its arguments.
    """

    def __init__(self, code: Code, count: int) -> None:
        self.code = code
        self.me, given, self._held = code.arguments
        objects = Cells(code, given, Address)
        self.given: Objects = tuple(map(objects.load, range(count)))
        self.holds = 0
        self._places: dict[str, int] = {}  # of held objects

    def call(self, name: str, *given: Any, result: Kind | None = ADDRESS) -> Any:
        """The value of one of Python's functions."""
        return self.call_at(_function(name), *given, result=result)

    def call_at(self, address: int, *given: Any, result: Kind | None = ADDRESS) -> Any:
        """The value of the function at an address that is known, such as one of NumPy's."""
        code = self.code
        values = [code.whole(each) if isinstance(each, int) else each for each in given]
        return code.call_at(code.address(address), *values, result=result)

    @property
    def null(self) -> Address:
        """No object; given back, it says that an exception is set."""
        return Address(self.code, "null")

    def none(self) -> Address:
        """None, as a value to give back."""
        return self.more(self.code.address(id(None)))

    def more(self, thing: Address) -> Address:
        """An object with a further reference: one to give back, or for a function that takes it."""
        self.call("Py_IncRef", thing, result=None)
        return thing

    def held(self, thing: Address) -> Address:
        """An object that is new, held until the function ends, unless it is `passed` on.

        Where there is none, an exception being set, the function ends.
        """
        Cells(self.code, self._held, Address).store(self.holds, thing)
        self._places[thing.text] = self.holds
        self.holds += 1
        self.give_null_if(thing.is_null())
        return Address(self.code, thing.text)

    def passed(self, thing: Address) -> Address:
        """A held object with the reference by which it was held, as `more` has one of its own."""
        Cells(self.code, self._held, Address).store(self._places.pop(thing.text), self.null)
        return thing

    def give_null_if(self, truth: Number) -> None:
        """End the function, an exception being set, where a truth holds."""
        with self.code.when(truth):
            self.code.give(self.null)

    def give_null_unless_done(self, status: Whole) -> None:
        """End the function, an exception being set, unless a function's status, an int, is 0."""
        self.give_null_if(c_int(status) != 0)

    def give_none_unless(self, truth: Number) -> None:
        """End the function with None, unless a truth holds."""
        with self.code.when(~truth):
            self.code.give(self.none())

    def mine(self, place: int) -> Address:
        """An item of the tuple that the function is bound to."""
        return Cells(self.code, self.me.moved(_place_of_items(), "i8"), Address).load(place)

    def is_same(self, a: Address, b: Address) -> Number:
        """Whether two objects are one."""
        return Number(self.code, self.code.value(f"icmp eq ptr {a.text}, {b.text}"), truth=True)

    def is_a(self, thing: Address, kind: Address) -> Number:
        """Whether an object is of a class, and of none that is derived from it."""
        return self.is_same(self.slot(thing, _place_of_class()), kind)

    def new(self, kind: Address) -> Address:
        """A new object of a class of Python's, as `object.__new__` makes it."""
        return self.held(self.call("PyType_GenericAlloc", kind, 0))

    def slot(self, thing: Address, place: int) -> Address:
        """The value in a slot of an object, which the object holds; null where it is empty.

        `place` is that of `place_of_slot`. An attribute that is looked up by name takes 15 ns.
        """
        return Cells(self.code, thing.moved(place, "i8"), Address).load(0)

    def fill(self, thing: Address, place: int, value: Address) -> None:
        """Put an object, `more` or `passed`, into a slot of a new one."""
        Cells(self.code, thing.moved(place, "i8"), Address).store(0, value)

    def bytes(self, thing: Address, size: int) -> Address:
        """The memory of a bytes object of that size or more; anything else is an exception."""
        code = self.code
        with code.when(~self.is_a(thing, code.address(id(bytes)))):
            _refuse(code, "TypeError", _NO_BYTES)
        with code.when(Cells(code, thing.moved(_SIZE, "i8"), Whole).load(0) < size):
            _refuse(code, "ValueError", _TOO_SHORT)
        return self.memory_of(thing)

    def memory_of(self, thing: Address) -> Address:
        """The memory of a bytes object."""
        return thing.moved(_BYTES, "i8")

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


def written(module: Module, name: str, count: int, write: Callable[[Python], None]) -> None:
    """Write a function of so many arguments that Python calls, as `write` gives its value."""
    passed = ADDRESS, ADDRESS, ADDRESS
    inner = module.function(f"{name} inside", passed, ADDRESS, internal=True)
    python = Python(inner, count)
    write(python)
    code = module.function(name, (ADDRESS, ADDRESS, WHOLE), ADDRESS)
    me, given, number = code.arguments
    held = Address(code, code.reserve(f"[{python.holds + 1} x ptr]"))
    null, objects = Address(code, "null"), Cells(code, held, Address)
    for k in range(python.holds):
        objects.store(k, null)
    with code.when(number != count):
        _refuse(code, "TypeError", _OTHER_COUNT)
    found = code.variable(code.call(inner, me, given, held))
    for k in range(python.holds):
        thing = objects.load(k)
        with code.when(~thing.is_null()):
            code.call_at(code.address(_function("Py_DecRef")), thing)
    code.give(found.get())


@cache
def place_of_slot(kind: type, name: str) -> int:
    """How many bytes into objects of a class a slot lies; it is seen where a value put there is."""
    thing: Any = object.__new__(kind)
    value = object()
    getattr(kind, name).__set__(thing, value)
    return _place_in(thing, kind.__basicsize__, value)


def bound(machine: Compiled, name: str, values: tuple[object, ...]) -> Callable[..., Any]:
    """A written function for Python, bound to a tuple.

    It owns its machine code: all that it needs is in the tuple, which Python keeps as long.
    """
    definition = _Definition(name.encode(), machine.address(name), _CALLED_WITH_AN_ARRAY, None)
    owned = *values, machine, definition
    found: Callable[..., Any] = _new_function()(ctypes.addressof(definition), owned, None)
    return found


def _place_in(thing: object, size: int, value: object) -> int:
    """How many bytes into an object of some size it has the address of a value."""
    words = (ctypes.c_uint64 * (size // 8)).from_address(id(thing))
    return 8 * list(words).index(id(value))


@cache
def _place_of_class() -> int:
    """How many bytes into objects their class stands."""
    return _place_in(object(), object.__basicsize__, object)


@cache
def _place_of_items() -> int:
    """How many bytes into tuples their items begin."""
    return _place_in((_TOO_SHORT,), tuple.__basicsize__ + 8, _TOO_SHORT)


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


def c_int(whole: Whole) -> Whole:
    """The int of 32 bits that a function has returned, as a whole number without sign."""
    return whole % 2**32
