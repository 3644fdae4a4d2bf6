"""Tables of .mat files: those that SciPy writes and reads, and files that are damaged."""

import io
import warnings
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from numpy.testing import assert_array_equal

from pgm.errors import FileError
from pgm.recordings.readers.matlab import matlab

KINDS = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"]
OLD = ["f8", "f4", "i4", "i2", "u2", "u1"]


def saved(tables, **options):
    file = io.BytesIO()
    scipy.io.savemat(file, tables, **options)
    return file.getvalue()


def read(data, *names):
    return matlab(io.BytesIO(data), "a recording", dict.fromkeys(names))[0]


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize(("level", "kinds"), [("5", KINDS), ("4", OLD)])
def test_tables_of_all_kinds_of_numbers(level, kinds, compressed):
    rng = np.random.default_rng(0)
    tables = {kind: rng.integers(0, 100, (5, 3)).astype(kind) for kind in kinds}
    tables |= {"one": np.array([[7.0]]), "none": np.zeros((0, 4)), "wide": np.arange(5.0)[None]}
    found = read(saved(tables, format=level, do_compression=compressed), *tables)
    for name, table in tables.items():
        assert_array_equal(found[name], table.astype(float), strict=True)


@pytest.mark.parametrize(
    ("value", "word"),
    [
        ("hello", "text"),
        (np.array([[1, "a"]], object), "cells"),
        ({"a": 1.0}, "a structure"),
        (np.array([[1 + 2j]]), "complex"),
        (scipy.sparse.csc_array(np.eye(3)), "a sparse matrix"),
        (np.zeros((2, 2, 2)), r"has shape \(2, 2, 2\)"),
    ],
)
def test_other_values_are_passed_over_and_refused_by_name(value, word):
    data = saved({"x": value, "y": np.eye(2)})
    assert_array_equal(read(data, "y")["y"], np.eye(2))
    with pytest.raises(FileError, match=f"the table x (is )?{word}; numbers were due"):
        read(data, "x")


def test_files_of_both_orders_and_other_writers():
    """SciPy's own collection: MATLAB 4 to 7.1, of Solaris, Linux and Windows, and broken ones."""
    folder = Path(scipy.io.__file__).parent / "matlab" / "tests" / "data"
    if not folder.is_dir():
        pytest.skip("this SciPy came without the files of its tests")
    compared = 0
    for path in sorted(folder.glob("*.mat")):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                due = scipy.io.loadmat(path)
        except Exception:
            with pytest.raises(FileError, match=path.name):
                matlab(path, "a recording", {"nothing": None})
            continue
        tables = {
            name: value
            for name, value in due.items()
            if isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.ndim == 2
        }
        tables = {
            name: value
            for name, value in tables.items()
            if np.isfinite(value).all() and not name.startswith("__")
        }
        found, _ = matlab(path, "a recording", dict.fromkeys(tables))
        for name, value in tables.items():
            assert_array_equal(found[name], value.astype(float))
            compared += 1
    assert compared > 20


TABLES = {"x": np.arange(60.0).reshape(20, 3), "y": np.arange(4, dtype=np.int16)[None]}


@pytest.mark.parametrize(
    "options",
    [{"format": "5"}, {"format": "5", "do_compression": True}, {"format": "4"}],
    ids=["plain", "compressed", "Level 4"],
)
def test_damaged_files_are_refused_or_read(options):
    """Of a compressed file all damage to numbers shows; of others, that of lengths and kinds."""
    whole, rng = saved(TABLES, **options), np.random.default_rng(0)
    refused = 0
    for k in range(250):
        data = bytearray(whole)
        at = min(int(rng.exponential(150.0)), len(data) - 1)
        if k % 5 == 0:
            del data[at:]
        elif k % 5 == 1:
            data[at : at + 4] = (b"\xff\xff\xff\xff", b"\0\0\0\x80", b"\xff\xff\xff\x7f")[k % 3]
        else:
            data[at] ^= 1 << int(rng.integers(8))
        try:
            found = read(bytes(data), "x", "y")
        except FileError:
            refused += 1
        else:
            if "do_compression" in options:
                assert_array_equal(found["x"], TABLES["x"])
    assert refused > 60


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "ends before its header"),
        (b"#!/bin/sh\n" * 20, "no header of Level 5"),
        (b"\x89HDF\r\n\x1a\n" + bytes(200), "version 7.3, which is HDF5"),
        (b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM" + bytes(400), "version 7.3"),
        (bytes([0, 0, 0, 0]) + b"\xff" * 400, "no table's header of Level 4"),
        (saved({"x": np.eye(2)}) * 2, "lie within a tag of four"),
        (saved({"x": np.eye(2)}) + saved({"x": np.eye(3)})[128:], "'x' twice"),
        (saved({"x": np.eye(9)}, do_compression=True)[:-5], "something of .* bytes is due"),
    ],
)
def test_what_is_wrong_is_said(data, told):
    with pytest.raises(FileError, match=told):
        read(data, "x")


def test_a_bomb_is_refused(monkeypatch):
    from pgm.recordings.readers import files

    monkeypatch.setattr(files, "LIMIT", 10_000)
    with pytest.raises(FileError, match="more than 10000 bytes"):
        read(saved({"x": np.zeros((100, 100))}, do_compression=True), "x")
