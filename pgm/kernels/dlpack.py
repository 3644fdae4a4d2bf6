"""DLPack, the protocol by which array libraries hand memory to each other, by ctypes.

A *capsule* has a tensor: where its memory lies, on which device, its shape, its strides, and a
function that its consumer calls when it is done with it.
Source: DLPack 0.8, https://dmlc.github.io/dlpack/latest/ (``dlpack.h`` and the Python protocol).
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Sequence
from typing import Any, NamedTuple

# The kinds of devices: this machine's memory, and that of a CUDA card.
HERE, CUDA = 1, 2
_FRESH, _USED = b"dltensor", b"used_dltensor"
_FLOAT = 2


class _Device(ctypes.Structure):
    _fields_ = (("kind", ctypes.c_int32), ("number", ctypes.c_int32))


class _Type(ctypes.Structure):
    _fields_ = (("code", ctypes.c_uint8), ("bits", ctypes.c_uint8), ("lanes", ctypes.c_uint16))


class _Managed(ctypes.Structure):
    _fields_ = (
        ("data", ctypes.c_void_p),
        ("device", _Device),
        ("axes", ctypes.c_int32),
        ("type", _Type),
        ("shape", ctypes.POINTER(ctypes.c_int64)),
        ("strides", ctypes.POINTER(ctypes.c_int64)),
        ("offset", ctypes.c_uint64),
        ("context", ctypes.c_void_p),
        ("done", ctypes.c_void_p),
    )


_DONE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
_api = ctypes.pythonapi
_new = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)(
    ("PyCapsule_New", _api)
)
_valid = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_char_p)(
    ("PyCapsule_IsValid", _api)
)
_pointer = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", _api)
)
_rename = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.py_object, ctypes.c_char_p)(
    ("PyCapsule_SetName", _api)
)
# What tensors that were handed out need, by their addresses, until their consumers are done.
_lent: dict[int, Any] = {}


def _take_back(tensor: int) -> None:
    _lent.pop(tensor, None)


def _take_back_fresh(capsule: int) -> None:
    """Take back the tensor of a capsule that nobody has consumed."""
    if _valid(capsule, _FRESH):
        _lent.pop(_pointer(capsule, _FRESH), None)


_returned, _dropped = _DONE(_take_back), _DONE(_take_back_fresh)


class Tensor(NamedTuple):
    """A tensor: its address, shape, strides in bytes, the type of its numbers, and its device.

    `owner` keeps its memory; `type` is such as ``"<f8"``.
    """

    address: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    type: str
    device: tuple[int, int]
    owner: object


def capsule(
    address: int,
    shape: Sequence[int],
    strides: Sequence[int],
    device: tuple[int, int],
    owner: object,
) -> Any:
    """A capsule of doubles, of strides in bytes; `owner` is kept until its consumer is done."""
    axes = len(shape)
    lengths = (ctypes.c_int64 * axes)(*shape)
    distances = (ctypes.c_int64 * axes)(*(stride // 8 for stride in strides))
    tensor = _Managed(
        data=address,
        device=_Device(*device),
        axes=axes,
        type=_Type(_FLOAT, 64, 1),
        shape=lengths,
        strides=distances,
        done=ctypes.cast(_returned, ctypes.c_void_p),
    )
    place = ctypes.addressof(tensor)
    _lent[place] = tensor, lengths, distances, owner
    return _new(place, _FRESH, ctypes.cast(_dropped, ctypes.c_void_p))


class _Owner:
    """The keeper of a consumed tensor's memory."""


def opened(given: Any) -> Tensor:
    """The tensor of a capsule, which is consumed; a ValueError refuses one that has been."""
    if not _valid(id(given), _FRESH):
        raise ValueError("the capsule has no tensor, or has been consumed")
    place = _pointer(id(given), _FRESH)
    _rename(given, _USED)
    found = _Managed.from_address(place)
    shape = tuple(found.shape[k] for k in range(found.axes))
    if found.strides:
        steps = tuple(found.strides[k] for k in range(found.axes))
    else:  # the last axis fastest
        steps = tuple(_product(shape[k + 1 :]) for k in range(found.axes))
    code = {0: "i", 1: "u", _FLOAT: "f", 5: "c", 6: "b"}.get(found.type.code, "V")
    size, owner = found.type.bits // 8, _Owner()
    if found.done:
        weakref.finalize(owner, _DONE(found.done), place)
    strides = tuple(step * size for step in steps)
    device = found.device.kind, found.device.number
    return Tensor((found.data or 0) + found.offset, shape, strides, f"<{code}{size}", device, owner)


def _product(lengths: Sequence[int]) -> int:
    found = 1
    for each in lengths:
        found *= each
    return found
