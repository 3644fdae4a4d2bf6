"""Packs of floats against NumPy, in every corner of float64."""

import math

import numpy as np
import pytest

numba = pytest.importorskip("numba", reason="packs are compiled by Numba, the extra fast")

from pgm.kernels.compiled import packs  # noqa: E402
from pgm.kernels.compiled.memory import give, numbers, opened, take  # noqa: E402
from pgm.tracing.operations import IN_C  # noqa: E402

SPECIAL = np.array(
    [0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3.7, 1e-310, 1e300, -1e300, np.inf, -np.inf, np.nan]
)
PAIRS = np.stack(np.meshgrid(SPECIAL, SPECIAL), axis=-1).reshape(-1, 2)
POINTS = np.concatenate([PAIRS, np.random.default_rng(2).normal(0, 30, (71, 2))])
LINES = {
    "add": "a + b",
    "subtract": "a - b",
    "multiply": "a * b",
    "divide": "a / b",
    "remainder": "a % b",
    "floor_divide": "a // b",
    "negative": "-a",
    "absolute": "abs(a)",
    "sqrt": "sqrt(a)",
    "less": "where(a < b, 1.0, 0.0)",
    "less_equal": "where(a <= b, 1.0, 0.0)",
    "greater": "where(a > b, 1.0, 0.0)",
    "greater_equal": "where(a >= b, 1.0, 0.0)",
    "equal": "where(a == b, 1.0, 0.0)",
    "not_equal": "where(a != b, 1.0, 0.0)",
    "logical_and": "where((a != 0.0) & (b != 0.0), 1.0, 0.0)",
    "logical_or": "where((a != 0.0) | (b != 0.0), 1.0, 0.0)",
    "logical_not": "where(opposite(a != 0.0), 1.0, 0.0)",
    "rint": "whole(a)",
    "floor": "floor(a)",
    "ceil": "ceil(a)",
    "trunc": "trunc(a)",
}
LINES |= {name: f"{name}({'a, b' if count == 2 else 'a'})" for name, (_, count) in IN_C.items()}


def packed(line):
    """A function of addresses (2, points) and (points,), eight points after another."""
    names = {name: packs.of_c(*own) for name, own in IN_C.items()}
    names |= {name: getattr(packs, name) for name in ("where", "opposite", "whole")}
    names |= {name: getattr(packs, name) for name in ("floor", "ceil", "trunc")}
    names |= {"opened": opened, "sqrt": math.sqrt}
    source = f"""
def function(x, y, out, count):
    left, right, found = opened(x, 8), opened(y, 8), opened(out, 8)
    for k in range(count):
        a, b = left[k], right[k]
        found[k] = {line}
"""
    exec(source, names)
    return numba.njit(error_model="numpy")(names["function"])


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", LINES)
def test_arithmetic(name):
    x, y = POINTS.T.copy()
    out = np.empty(len(POINTS))
    packed(LINES[name])(*(each.ctypes.data for each in (x, y, out)), len(POINTS) // 8)
    function = getattr(np, name)
    due = function(x, y) if function.nin == 2 else function(x)
    np.testing.assert_allclose(out, due.astype(float), rtol=1e-14, atol=1e-307)


@pytest.mark.parametrize("apart", [0, 1, 3])
def test_runs_are_taken_and_given_where_they_lie(apart):
    source, target, pack = np.arange(30.0), np.zeros(30), np.zeros(8)

    @numba.njit
    def moved(source, target, pack, apart):
        like = opened(pack, 8)
        like[0] = take(numbers(source), 2, apart, like)
        if apart:
            give(numbers(target), 2, apart, like[0] + 1.0, like)

    moved(*(each.ctypes.data for each in (source, target, pack)), apart)
    places = 2 + apart * np.arange(8)
    np.testing.assert_array_equal(pack, source[places])
    due = np.zeros(30)
    if apart:
        due[places] = source[places] + 1.0
    np.testing.assert_array_equal(target, due)
