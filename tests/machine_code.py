"""Functions of machine code on arrays, for tests of the emitter."""

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="LLVM is driven by llvmlite")

from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.module import Module

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
