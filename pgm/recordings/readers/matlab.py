"""Tables of numbers from ``.mat`` files of MATLAB, Level 4 and Level 5.

Each length, kind and shape is held against the bytes that are there before it is used, so that a
damaged file is refused in words: SciPy's reader, which knows more kinds of values, ends the process
at one in fifty. The formats are those of MATLAB's "MAT-File Format" (The MathWorks, R2024b).
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pgm.io.sources import Origin, Source
from pgm.kernels.arrays import Array
from pgm.recordings.readers import files

# Of Level 5, numbers as they are stored: `mi...`; and values by their classes: `mx...`.
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8"}
_STORED |= {13: "u8"}
_MATRIX, _COMPRESSED, _UNSIGNED = 14, 15, 6
# Some writers take them for the signed ones, and UTF-8 for bytes.
_INTEGERS, _TEXT = (5, 6), (1, 16)
_NUMBERS = range(6, 16)
_OTHERS = {1: "cells", 2: "a structure", 3: "an object", 4: "text", 5: "a sparse matrix"}
_OPAQUE, _COMPLEX = 17, 0x0800
_HEADER, _TAG = 128, 8
# Of Level 4, by the tens digit of a table's type, numbers as they are stored.
_OLD = ("f8", "f4", "i4", "i2", "u2", "u1")
_OLD_HEADER = 20
# Axes that NumPy's arrays may have.
_MOST_AXES = 32

# A table, or the word for a value of another kind.
Value = Array | str


class _Damaged(Exception):
    """The error that says what is wrong with a file's bytes."""


class _Element(NamedTuple):
    """The number of an element's type, and its bytes."""

    kind: int
    data: memoryview


def matlab(
    path: Source,
    kind: str,
    tables: Mapping[str, int | None],
    optional: Sequence[str] = (),
) -> tuple[dict[str, Array], Origin]:
    """Tables of numbers from a ``.mat`` file before version 7.3.

    Parameters
    ----------
    path : str, Path or file
    kind : str
        The recording that the file should be, for messages.
    tables : mapping of str to int or None
        The tables that have to be there, by name: how many columns each has, None for any.
    optional : sequence of str
        Tables that may be there.

    Returns
    -------
    tables : dict of str to ndarray
        (rows, columns) each, finite.
    origin : Origin

    Raises
    ------
    FileError
        If it is no such file, is damaged, or lacks a table.
    """
    held = files.content(path)
    data = held.data if isinstance(held.data, bytes) else held.data.encode()
    try:
        found = _values(memoryview(data))
    except _Damaged as error:
        raise held.origin.fault(
            f"it cannot be read as a .mat file: {error}; fetch it again, or save it anew (-v7)"
        ) from error
    lost = [key for key in tables if key not in found]
    if lost:
        raise held.origin.fault(f"it has no tables {lost}; is it {kind}?")
    due = {**tables, **{key: None for key in optional if key in found}}
    read = {key: _table(found[key], key, width, kind, held.origin) for key, width in due.items()}
    return read, held.origin


def _table(value: Value, key: str, width: int | None, kind: str, origin: Origin) -> Array:
    """A value as a table of finite numbers in so many columns."""
    if isinstance(value, str) or value.ndim != 2 or width not in (None, value.shape[1]):
        found = f"is {value}" if isinstance(value, str) else f"has shape {value.shape}"
        due = "numbers" if width is None else f"numbers in {width} columns"
        raise origin.fault(f"the table {key} {found}; {due} were due; is it {kind}?")
    if not np.isfinite(value).all():
        row = int(np.argwhere(~np.isfinite(value))[0, 0])
        raise origin.fault(f"the table {key}, row {row}: {value[row].tolist()} is not finite")
    return value


def _values(data: memoryview) -> dict[str, Value]:
    """The values of a file by name; Level 4 begins with a number below 5000, in either order."""
    if len(data) < _OLD_HEADER:
        raise _Damaged("it ends before its header does")
    # HDF5 by itself, or behind a header of MATLAB's.
    first, version = (bytes(data[place : place + 4]) for place in (0, _HEADER - 4))
    if first == b"\x89HDF" or version in (b"\0\2IM", b"\2\0MI"):
        raise _Damaged("it is of version 7.3, which is HDF5")
    each = _old(data) if 0 in first else _new(data)
    found: dict[str, Value] = {}
    for name, value in each:
        if name in found:
            raise _Damaged(f"it has {name!r} twice")
        found[name] = value
    return found


def _cut(data: memoryview, start: int, size: int) -> memoryview:
    """So many bytes from a place on, which have to be there."""
    if not 0 <= size <= len(data) - start:
        raise _Damaged(f"at byte {start} something of {size} bytes is due, and it ends before")
    return data[start : start + size]


def _numbers(data: memoryview, kind: str, shape: Sequence[int]) -> Array:
    """Stored numbers as an array of that shape, the first axis the fastest."""
    wide = np.dtype(kind)
    if min(shape) < 0 or len(shape) > _MOST_AXES or math.prod(shape) * wide.itemsize != len(data):
        raise _Damaged(f"{len(data)} bytes of numbers are no table of shape {tuple(shape)}")
    return np.frombuffer(data, wide).astype(np.float64).reshape(shape, order="F")


# Level 4: a header of five integers for each table, its name, and its numbers.


def _old(data: memoryview) -> Iterator[tuple[str, Value]]:
    place = 0
    while place < len(data):
        head = _cut(data, place, _OLD_HEADER)
        order = "<" if int.from_bytes(head[:4], "little") < 5000 else ">"
        kind, rows, columns, imaginary, named = np.frombuffer(head, f"{order}i4").tolist()
        thousands, hundreds, tens, ones = (kind // 10**k % 10 for k in (3, 2, 1, 0))
        if (
            not 0 <= kind < 5000
            or thousands != (order == ">")
            or hundreds
            or tens >= len(_OLD)
            or ones > 2
            or imaginary not in (0, 1)
        ):
            raise _Damaged(f"at byte {place} there is no table's header of Level 4")
        place += _OLD_HEADER
        name = _name(_cut(data, place, named))
        place += named
        stored = f"{order}{_OLD[tens]}"
        size = np.dtype(stored).itemsize * rows * columns
        if min(rows, columns) < 0:
            raise _Damaged(f"{name!r} has shape {(rows, columns)}")
        part = _cut(data, place, size)
        place += size * (1 + imaginary)
        if place > len(data):
            raise _Damaged(f"it ends within {name!r}")
        if ones or imaginary:
            yield name, "complex" if not ones else ("text", "a sparse matrix")[ones - 1]
        else:
            yield name, _numbers(part, stored, (rows, columns))


def _name(data: memoryview) -> str:
    try:
        return bytes(data).rstrip(b"\0").decode("ascii")
    except UnicodeDecodeError:
        raise _Damaged("the name of a table is none") from None


# Level 5: a header of 128 bytes, and elements, each a tag, its bytes, and what fills eight up.


def _new(data: memoryview) -> Iterator[tuple[str, Value]]:
    orders = {b"IM": "<", b"MI": ">"}
    order = orders.get(bytes(_cut(data, _HEADER - 2, 2)))
    if order is None:
        raise _Damaged("it has no header of Level 5")
    left = files.LIMIT
    for kind, part in _elements(data[_HEADER:], order):
        if kind == _COMPRESSED:
            part = _inflated(part, left)
            left -= len(part)
            elements = list(_elements(part, order))
            if len(elements) != 1:
                raise _Damaged(f"a compressed part has {len(elements)} elements")
            ((kind, part),) = elements
        if kind != _MATRIX:
            raise _Damaged(f"an element of type {kind} stands where a table is due")
        if part:
            yield _matrix(part, order)


def _elements(data: memoryview, order: str) -> Iterator[_Element]:
    """The elements that some bytes are; one of up to four bytes may lie within its tag."""
    place = 0
    while place < len(data):
        tag = _cut(data, place, _TAG)
        kind, size = np.frombuffer(tag, f"{order}u4").tolist()
        if kind >> 16:
            kind, size = kind & 0xFFFF, kind >> 16
            if size > 4:
                raise _Damaged(f"{size} bytes lie within a tag of four")
            yield _Element(kind, tag[4 : 4 + size])
            place += _TAG
            continue
        yield _Element(kind, _cut(data, place + _TAG, size))
        place += _TAG + size
        if kind != _COMPRESSED:
            place += -size % 8


def _inflated(data: memoryview, limit: int) -> memoryview:
    """A compressed part, whose own checksum has to be right."""
    work = zlib.decompressobj()
    try:
        found = work.decompress(data, limit + 1)
    except zlib.error as error:
        raise _Damaged(f"a compressed part is broken ({error})") from None
    if len(found) > limit:
        raise _Damaged(f"it holds more than {files.LIMIT} bytes")
    if not work.eof or work.unused_data:
        raise _Damaged("a compressed part is cut, or goes on behind its end")
    return memoryview(found)


def _matrix(data: memoryview, order: str) -> tuple[str, Value]:
    """The name of a value and its numbers: flags, shape, name, real part."""
    parts = _elements(data, order)
    flags = _next(parts, "flags")
    if flags.kind != _UNSIGNED or len(flags.data) != 8:
        raise _Damaged("a value has no flags")
    flag = int(np.frombuffer(flags.data, f"{order}u4")[0])
    if flag & 0xFF == _OPAQUE:  # which has no shape
        return _name(_next(parts, "a name").data), "an object"
    shape, named = _next(parts, "a shape"), _next(parts, "a name")
    if shape.kind not in _INTEGERS or len(shape.data) % 4 or len(shape.data) < 8:
        raise _Damaged("a value has no shape")
    if named.kind not in _TEXT:
        raise _Damaged("a value has no name")
    name = _name(named.data)
    axes = np.frombuffer(shape.data, f"{order}i4").tolist()
    if flag & 0xFF not in _NUMBERS:
        return name, _OTHERS.get(flag & 0xFF, "of another class")
    if flag & _COMPLEX:
        return name, "complex"
    real = _next(parts, "numbers")
    if real.kind not in _STORED:
        raise _Damaged(f"{name!r} has numbers of the unknown type {real.kind}")
    if next(parts, None) is not None:
        raise _Damaged(f"{name!r} goes on behind its numbers")
    return name, _numbers(real.data, order + _STORED[real.kind], axes)


def _next(parts: Iterator[_Element], what: str) -> _Element:
    found = next(parts, None)
    if found is None:
        raise _Damaged(f"a value ends where {what} was due")
    return found
