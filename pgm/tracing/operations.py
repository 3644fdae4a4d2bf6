"""The scalar operations of traces, named like NumPy's, and how printers write them."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from operator import not_
from typing import Any

import numpy as np


def _infix(names: str, signs: str) -> dict[str, str]:
    pairs = zip(names.split(), signs.split(), strict=True)
    return {name: f"({{0}} {sign} {{1}})" for name, sign in pairs}


_ARITHMETIC = _infix("add subtract multiply divide remainder floor_divide", "+ - * / % //")
_COMPARISONS = _infix("less less_equal greater greater_equal equal not_equal", "< <= > >= == !=")
_LOGICAL = _infix("logical_and logical_or", "& |") | {"logical_not": "opposite({0})"}
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


_NAMED = (*_IN_MATH, *_ROUNDING)
BOOLEAN = {*_COMPARISONS, *_LOGICAL}
COMMUTATIVE = {"add", "multiply", "equal", "not_equal", "logical_and", "logical_or", "hypot"}
# Of these and their like the derivative neither cancels nor jumps.
SMOOTH = {"constant", "input", "add", "subtract", "multiply", "negative", "arctan", "arcsinh"}
SMOOTH |= {"sin", "cos", "sinh", "cosh", "tanh", "exp", "exp2", "expm1"}
# Of Python; a NaN goes through as it does in NumPy.
SCALAR = {
    **{name: f"{name}({{0}}, {{1}})" if name in _TWO else f"{name}({{0}})" for name in _NAMED},
    **_ARITHMETIC,
    **_COMPARISONS,
    **_LOGICAL,
    "negative": "(-{0})",
    "absolute": "abs({0})",
    "sign": "(1.0 if {0} > 0.0 else (-1.0 if {0} < 0.0 else {0} * 0.0))",
    "minimum": "({0} if ({0} < {1}) | ({0} != {0}) else {1})",
    "maximum": "({0} if ({0} > {1}) | ({0} != {0}) else {1})",
    "where": "({1} if {0} else {2})",
}
# Python's own functions raise where NumPy's return infinities and NaNs.
PYTHON: dict[str, Callable[..., Any]] = {
    **{name: getattr(math, own) for name, own in _IN_MATH.items()},
    **_ROUNDING,
    "opposite": not_,
}
BATCH: dict[str, Callable[..., Any]] = {name: getattr(np, name) for name in SCALAR}


def _fma(a: float, b: float, c: float) -> Any:
    return np.float64(Fraction(a) * Fraction(b) + Fraction(c))


# A product and a sum rounded together, of our own traces alone.
BATCH["fma"] = _fma
