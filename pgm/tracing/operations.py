"""The scalar operations of traces, named like NumPy's, and how printers write them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

_INFIX = {
    "add": "{0} + {1}",
    "subtract": "{0} - {1}",
    "multiply": "{0} * {1}",
    "divide": "{0} / {1}",
    "remainder": "{0} % {1}",
    "floor_divide": "{0} // {1}",
    "negative": "-{0}",
}
_COMPARISONS = {
    "less": "{0} < {1}",
    "less_equal": "{0} <= {1}",
    "greater": "{0} > {1}",
    "greater_equal": "{0} >= {1}",
    "equal": "{0} == {1}",
    "not_equal": "{0} != {1}",
}
_LOGICAL = {
    "logical_and": "{0} and {1}",
    "logical_or": "{0} or {1}",
    "logical_not": "not {0}",
}
# What has no name in Python's `math` is written out; a NaN goes through as it does in NumPy.
_WRITTEN = {
    "absolute": "abs({0})",
    "sign": "1.0 if {0} > 0.0 else -1.0 if {0} < 0.0 else {0} * 0.0",
    "minimum": "{0} if {0} < {1} or {0} != {0} else {1}",
    "maximum": "{0} if {0} > {1} or {0} != {0} else {1}",
    "where": "{1} if {0} else {2}",
}
_WAVES = ("sin", "cos", "tan", "sinh", "cosh", "tanh")
_LOGS = ("exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "sqrt", "cbrt")
_IN_MATH = {name: name for name in (*_WAVES, *_LOGS, "hypot", "fmod", "copysign")}
_IN_MATH |= {f"arc{name}": f"a{name}" for name in (*_WAVES, "tan2")} | {"power": "pow"}
_ROUNDING = {
    "floor": lambda a: float(math.floor(a)),
    "ceil": lambda a: float(math.ceil(a)),
    "trunc": lambda a: float(math.trunc(a)),
    "rint": lambda a: float(round(a)),
}
_TWO = {"arctan2", "hypot", "power", "fmod", "copysign"}
_CALLED = {
    name: name + ("({0}, {1})" if name in _TWO else "({0})") for name in (*_IN_MATH, *_ROUNDING)
}

BOOLEAN = {*_COMPARISONS, *_LOGICAL}
# Of Python and Numba alike; those with a name are called by it.
SCALAR = {
    **_CALLED,
    **{name: f"({text})" for name, text in (_INFIX | _COMPARISONS | _LOGICAL | _WRITTEN).items()},
}
# Of compiled code, for floats and for packs of them, of which there is no branch.
MACHINE = SCALAR | {
    "logical_and": "({0} & {1})",
    "logical_or": "({0} | {1})",
    "logical_not": "opposite({0})",
    "sign": "where({0} > 0.0, 1.0, where({0} < 0.0, -1.0, {0} * 0.0))",
    "minimum": "where(({0} < {1}) | ({0} != {0}), {0}, {1})",
    "maximum": "where(({0} > {1}) | ({0} != {0}), {0}, {1})",
    "where": "where({0}, {1}, {2})",
}
# The names in C of those called by name, and how many arguments they have.
IN_C = {name: (own, 1 + (name in _TWO)) for name, own in _IN_MATH.items()}
# Python's own functions raise where NumPy's return infinities and NaNs.
PYTHON: dict[str, Callable[..., Any]] = {
    **{name: getattr(math, own) for name, own in _IN_MATH.items()},
    **_ROUNDING,
}
BATCH: dict[str, Callable[..., Any]] = {name: getattr(np, name) for name in SCALAR}
COMMUTATIVE = {"add", "multiply", "equal", "not_equal", "logical_and", "logical_or", "hypot"}
