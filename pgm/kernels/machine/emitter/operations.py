"""The operations of traces on numbers, by their NumPy names, with NumPy's meaning."""

from __future__ import annotations

from collections.abc import Callable

from pgm.kernels.machine.emitter.elementary import elementary
from pgm.kernels.machine.emitter.numbers import Number, Operand, alike, constant


def _sign(a: Number) -> Number:
    a = a.number()
    return (a > 0.0).where(1.0, (a < 0.0).where(-1.0, (a == 0.0).where(0.0, a)))


def _minimum(a: Number, b: Operand) -> Number:
    a, b = alike(a, constant(a.code, b))
    return ((a < b) | (a != a)).where(a, b)


def _maximum(a: Number, b: Operand) -> Number:
    a, b = alike(a, constant(a.code, b))
    return ((a > b) | (a != a)).where(a, b)


def _fmod(a: Number, b: Operand) -> Number:
    return elementary("fmod", a, constant(a.code, b))


def _divided(a: Number, b: Number) -> tuple[Number, Number]:
    """The remainder with the sign of a, as in C, and whether that with the sign of b is another."""
    rest = _fmod(a, b)
    return rest, (rest != 0.0) & ((rest < 0.0) & (b >= 0.0) | (rest >= 0.0) & (b < 0.0))


def _remainder(a: Number, b: Operand) -> Number:
    a, b = alike(a, constant(a.code, b))
    rest, other = _divided(a, b)
    none = (rest == 0.0) & (b != 0.0)
    return none.where(rest.intrinsic("copysign", b), other.where(rest + b, rest))


def _floor_divide(a: Number, b: Operand) -> Number:
    a, b = alike(a, constant(a.code, b))
    rest, other = _divided(a, b)
    near = (a - rest) / b
    near = other.where(near - 1.0, near)
    below = near.intrinsic("floor")
    whole = (near - below > 0.5).where(below + 1.0, below)  # near is within rounding of a whole one
    quotient = a / b
    whole = (near == 0.0).where(constant(a.code, 0.0).intrinsic("copysign", quotient), whole)
    return (b == 0.0).where(quotient, whole)


def _intrinsic(name: str) -> Callable[..., Number]:
    return lambda a, *others: a.intrinsic(name, *others)


def _of_c(name: str) -> Callable[..., Number]:
    return lambda a, *others: elementary(name, a, *(constant(a.code, b) for b in others))


# The names in C of functions whose NumPy names are others.
_IN_C = {f"arc{name}": f"a{name}" for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "tan2")}
_IN_C |= {"power": "pow"}
_IN_C |= {name: name for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "hypot", "cbrt")}
_IN_C |= {name: name for name in ("exp", "exp2", "expm1", "log", "log2", "log10", "log1p")}

OPERATIONS: dict[str, Callable[..., Number]] = {
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "remainder": _remainder,
    "floor_divide": _floor_divide,
    "fmod": _fmod,
    "less": lambda a, b: a < b,
    "less_equal": lambda a, b: a <= b,
    "greater": lambda a, b: a > b,
    "greater_equal": lambda a, b: a >= b,
    "equal": lambda a, b: a == b,
    "not_equal": lambda a, b: a != b,
    "logical_and": lambda a, b: a & b,
    "logical_or": lambda a, b: a | b,
    "logical_not": lambda a: ~a,
    "where": lambda truth, yes, no: truth.where(yes, no),
    "fma": lambda a, b, c: a.intrinsic("fma", b, c),
    "negative": lambda a: -a,
    "absolute": abs,
    "sign": _sign,
    "minimum": _minimum,
    "maximum": _maximum,
    **{name: _intrinsic(name) for name in ("floor", "ceil", "trunc", "rint", "sqrt", "copysign")},
    **{name: _of_c(own) for name, own in _IN_C.items()},
}
