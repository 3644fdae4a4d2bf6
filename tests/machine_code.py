"""Functions of machine code on arrays, for tests of the emitter."""

from math import prod

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="LLVM is driven by llvmlite")

from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.memory import Memory, Runs
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.matrices.in_memory.frame import LINE, Frame
from pgm.kernels.machine.matrices.lines import Lines
from pgm.kernels.machine.matrices.loops import Loops

WIDTHS = (1, 2, 4, 8)


def elementwise(make, count, lanes, level=2, **options):
    """The function of arrays that applies what `make` writes of so many numbers to each point."""
    module = Module(**options)
    code = module.function("each", [ADDRESS] * (count + 1) + [WHOLE], lanes=lanes, disjoint=True)
    *given, out, length = code.arguments
    with code.loop(length) as index:
        numbers = [code.memory(each).load(index) for each in given]
        code.memory(out).store(index, make(code, *numbers))
    function = module.compile(level).callable("each")

    def applied(*arrays):
        arrays = [np.asarray(each, float) for each in np.broadcast_arrays(*arrays)]
        size = len(arrays[0])
        padded = [np.resize(each, -(-size // lanes) * lanes) for each in arrays]
        found = np.full(len(padded[0]), 12345.0)
        places = [each.ctypes.data for each in (*padded, found)]
        function(*places, len(found) // lanes)
        return found[:size]

    return applied


def apart(found, due):
    """How many units in the last place numbers differ; infinite where one of them is special."""
    found, due = np.asarray(found, float), np.asarray(due, float)
    same = (found == due) & (np.signbit(found) == np.signbit(due))
    same |= np.isnan(found) & np.isnan(due)
    with np.errstate(invalid="ignore", over="ignore"):
        units = np.abs(found - due) / np.spacing(np.abs(due))
    units[~np.isfinite(units) | (found == 0.0) & (due == 0.0)] = np.inf
    units[same] = 0.0
    return units


def over_matrices(make, shapes, matrices=Lines, lanes=1, level=1, contract=True):
    """The function of arrays (runs, m, n) of these shapes that has the results of `make`, as such.

    `make` is called with the kind of `matrices`, and a matrix of each of the arrays, and gives
    matrices and numbers. Room begins as NaN, so that nothing is read that was never written.
    """
    module = Module(contract=contract)
    code = module.function("each", [ADDRESS] * (len(shapes) + 2), lanes=lanes)
    *places, out, room = code.arguments
    frame = Frame(code, room)
    kind = matrices(code, frame) if matrices is Loops else matrices(code)
    runs = Runs.APART if lanes > 1 else Runs.BESIDE

    def cells(place, size):
        return Memory(code, place, runs=runs, apart=code.whole(size))

    given = [
        kind.matrix(cells(place, height * width), height, width)
        for place, (height, width) in zip(places, shapes, strict=True)
    ]
    results = list(make(kind, *given))
    ends = np.cumsum([0, *(prod(shape_of(each)) for each in results)]).tolist()
    for each, begin in zip(results, ends, strict=False):
        to = cells(out + begin, ends[-1])
        if hasattr(each, "shape"):
            kind.keep(to, each)
        else:
            to.store(0, each)
    function = module.compile(level).callable("each")

    def applied(*arrays):
        count = len(arrays[0])
        whole = -(-count // lanes) * lanes
        arrays = [
            np.resize(each, (whole, *shape)) for each, shape in zip(arrays, shapes, strict=True)
        ]
        found, space = np.zeros((whole, ends[-1])), np.full(frame.size + LINE, np.nan)
        start = space.ctypes.data + -space.ctypes.data % (8 * LINE)
        for first in range(0, whole, lanes):
            function(*(each[first:].ctypes.data for each in (*arrays, found)), start)
        parts = zip(results, ends[:-1], ends[1:], strict=True)
        return [found[:count, i:j].reshape(count, *shape_of(each)) for each, i, j in parts]

    return applied


def shape_of(result):
    """The shape of a matrix; of a number, that of its own matrix."""
    return getattr(result, "shape", (1, 1))
