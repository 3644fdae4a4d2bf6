"""NumPy's arrays in machine code: the numbers of an array, and arrays that show numbers.

Both go by NumPy's binary interface, which every extension of it is compiled with: where an array
has its fields, and the table of its functions. The buffer protocol needs neither, but describes
each array anew, in memory of its own and as text: that takes longer than a small step's arithmetic.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from importlib import import_module

import numpy as np

from pgm.kernels.machine.emitter.kinds import WHOLE
from pgm.kernels.machine.emitter.memory import Cells
from pgm.kernels.machine.emitter.python import Python
from pgm.kernels.machine.emitter.wholes import Address, Whole

# An object's own fields begin behind Python's. Those of an array, in words: its memory, its number
# of axes and its flags (each an int, beside which nothing else lies), its shape and its dtype.
_OWN = object.__basicsize__
_DATA, _AXES, _SHAPE, _DTYPE, _FLAGS = 0, 1, 2, 5, 6
# Of a dtype the word that has its kind, its letter and the order of its bytes, and the number of
# its type in the upper half.
_LETTERS, _FLOAT64, _NUMBER = 1, int.from_bytes(b"fd=", "little"), 12
_CONTIGUOUS, _ALIGNED = 0x1, 0x100
# Places in the table of NumPy's functions.
_NEW, _SET_BASE = 94, 282


def floats(python: Python, thing: Address, kind: Address, axes: int) -> tuple[Address, list[Whole]]:
    """The memory of an array of float64, and its shape.

    The function ends with None where the object is not of this class of arrays, or its memory is of
    another kind, or not contiguous.
    """
    code = python.code
    python.give_none_unless(python.is_a(thing, kind))
    own = thing.moved(_OWN, "i8")
    cells = Cells(code, own, Address)
    letters = Cells(code, cells.load(_DTYPE).moved(_OWN, "i8"), Whole).load(_LETTERS)
    flags = _int(own, _FLAGS)
    fits = _int(own, _AXES) == axes
    fits = fits & (letters % 2**24 == _FLOAT64) & (letters // 2**32 == _NUMBER)
    fits = fits & (flags // _CONTIGUOUS % 2 == 1) & (flags // _ALIGNED % 2 == 1)
    python.give_none_unless(fits)
    shape = Cells(code, cells.load(_SHAPE), Whole)
    return cells.load(_DATA), [shape.load(k) for k in range(axes)]


def shown(
    python: Python,
    kinds: tuple[Address, Address],
    shape: tuple[int, ...],
    place: Address,
    owner: Address,
) -> Address:
    """An array of a shape that shows numbers of its owner, and cannot be written to.

    `kinds` are the class of arrays and the dtype of float64. The array is held until the function
    ends.
    """
    code, (kind, dtype) = python.code, kinds
    lengths = Address(code, code.reserve(f"[{len(shape)} x i64]"))
    for k, length in enumerate(shape):
        Cells(code, lengths, Whole).store(k, code.whole(length))
    null, flags = python.null, _CONTIGUOUS | _ALIGNED
    made = kind, python.more(dtype), len(shape), lengths, null, place, flags, null
    found = python.held(python.call_at(_function(_NEW), *made))
    kept = python.call_at(_function(_SET_BASE), found, python.more(owner), result=WHOLE)
    python.give_null_unless_done(kept)
    return found


def _int(own: Address, place: int) -> Whole:
    """The int at the beginning of a word.

    It is not read as a whole word, which a processor has to wait for where the int alone has just
    been written, as that of an array which has just been made.
    """
    code, word = own.code, own.moved(place, "i64")
    return Whole(code, code.value(f"zext i32 {code.value(f'load i32, ptr {word.text}')} to i64"))


@cache
def are_known() -> bool:
    """Whether arrays lie here as this file has it."""
    probe = np.zeros((2, 3))
    fields = (ctypes.c_uint64 * 7).from_address(id(probe) + _OWN)
    letters = (ctypes.c_uint64 * 2).from_address(id(probe.dtype) + _OWN)[_LETTERS]
    shape = (ctypes.c_int64 * 2).from_address(fields[_SHAPE])
    return (
        sys.byteorder == "little"
        and (fields[_DATA], fields[_DTYPE]) == (probe.ctypes.data, id(probe.dtype))
        and (fields[_AXES] % 2**32, tuple(shape)) == (2, probe.shape)
        and fields[_FLAGS] % 2**32 == probe.flags.num
        and (letters % 2**24, letters // 2**32) == (_FLOAT64, probe.dtype.num)
    )


@cache
def _function(place: int) -> int:
    """Where a function of NumPy's interface begins."""
    opened = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)
    capsule = import_module("numpy._core._multiarray_umath")._ARRAY_API
    table = opened(("PyCapsule_GetPointer", ctypes.pythonapi))(capsule, None)
    found: int = ctypes.cast(table, ctypes.POINTER(ctypes.c_void_p))[place]
    return found
