"""Derivatives of drawn functions against numbers of fifty digits; kinks, and where."""

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pgm.tracing import Program, trace

ONE = ["sin", "cos", "tan", "tanh", "sinh", "cosh", "arctan", "arcsinh", "exp", "log1p", "expm1"]
ONE += [
    "sqrt",
    "cbrt",
    "absolute",
    "arcsin",
    "arccos",
    "arccosh",
    "arctanh",
    "log",
    "square",
    "log2",
]
ONE += ["exp2", "log10", "sinc", "negative", "sign", "reciprocal"]
TWO = ["add", "subtract", "multiply", "divide", "hypot", "arctan2", "power", "maximum", "minimum"]
TWO += ["remainder", "fmod"]
# Of an argument of any size, one that a function is defined and tame for.
INSIDE = {
    **dict.fromkeys(("sinh", "cosh", "exp", "expm1", "exp2"), lambda np, a: np.sin(a)),
    **dict.fromkeys(("arcsin", "arccos", "arctanh"), lambda np, a: 0.9 * np.cos(a)),
    **dict.fromkeys(("sqrt", "log", "log2", "log10", "log1p"), lambda np, a: a * a + 0.1),
    **dict.fromkeys(("arccosh",), lambda np, a: a * a + 1.5),
    **dict.fromkeys(("tan",), lambda np, a: 1.2 * np.sin(a)),
    **dict.fromkeys(("reciprocal", "cbrt"), lambda np, a: a * a + 0.3),
}
leaves = st.one_of(
    st.sampled_from([0, 1, 2]), st.floats(-2.0, 2.0).map(lambda c: round(c, 3) + 0.0)
)
trees = st.recursive(
    leaves,
    lambda t: st.one_of(
        st.tuples(st.sampled_from(ONE), t),
        st.tuples(st.sampled_from(TWO), t, t),
        st.tuples(st.just("where"), t, t, t, t),
    ),
    max_leaves=8,
)


def evaluate(tree, x, np):
    if isinstance(tree, int):
        return x[tree]
    if isinstance(tree, float):
        return tree
    name, *parts = tree
    values = [evaluate(part, x, np) for part in parts]
    if name == "where":
        return np.where(values[0] < values[1], *values[2:])
    if name in ("divide", "remainder", "fmod", "power"):
        base = values[0] * values[0] + 0.2 if name == "power" else values[0]
        values = [base, np.sin(values[1]) if name == "power" else values[1] * values[1] + 0.7]
    if name in INSIDE:
        values = [INSIDE[name](np, values[0])]
    return getattr(np, name)(*values)


class Precise:
    """NumPy's functions for numbers of mpmath."""

    arctan, arcsinh, arctan2, arcsin = mpmath.atan, mpmath.asinh, mpmath.atan2, mpmath.asin
    arccos, arccosh, arctanh, absolute = mpmath.acos, mpmath.acosh, mpmath.atanh, abs
    power, floor, sign, log10, cbrt = (
        mpmath.power,
        mpmath.floor,
        mpmath.sign,
        mpmath.log10,
        mpmath.cbrt,
    )
    add, subtract, multiply = (lambda a, b: a + b), (lambda a, b: a - b), (lambda a, b: a * b)
    divide, square, negative = (lambda a, b: a / b), (lambda a: a * a), (lambda a: -a)
    log2, exp2 = (lambda a: mpmath.log(a, 2)), (lambda a: mpmath.power(2, a))
    reciprocal, hypot, maximum, minimum = (lambda a: 1 / a), mpmath.hypot, max, min
    where = lambda c, a, b: a if c else b  # noqa: E731
    remainder = lambda a, b: a - b * mpmath.floor(a / b)  # noqa: E731
    fmod = lambda a, b: a - b * mpmath.sign(a) * mpmath.floor(abs(a / b))  # noqa: E731
    sinc = lambda a: mpmath.sincpi(a)  # noqa: E731

    def __getattr__(self, name):
        return getattr(mpmath, name)


PRECISE = Precise()
for _name, _value in vars(Precise).items():  # plain functions, not methods
    if callable(_value) and not _name.startswith("_"):
        setattr(PRECISE, _name, _value)


@settings(max_examples=200)
@given(trees, st.integers(0, 1000))
def test_drawn_functions_have_exact_derivatives(tree, seed):
    """Against central differences of steps so small that fifty digits lose nothing by them."""
    found = trace(
        lambda x: np.stack([evaluate(tree, [x[..., k] for k in range(3)], np) + x[..., 0]], -1),
        (3,),
        (1,),
    )
    assert isinstance(found, Program), found
    program = found.by(((0, 0), (0, 1), (0, 2)))
    x = np.random.default_rng(seed).normal(size=3)
    (value,), slope, _ = program.single([x])
    with mpmath.workdps(50):
        h, at = mpmath.mpf(10) ** -20, [mpmath.mpf(c) for c in x]

        def f(*moves):
            return (
                evaluate(tree, [c + d for c, d in zip(at, moves, strict=True)], PRECISE)
                + at[0]
                + moves[0]
            )

        moves = [[h * (j == k) for j in range(3)] for k in range(3)]
        due = [float((f(*m) - f(*[-d for d in m])) / (2 * h)) for m in moves]
        assert value == pytest.approx(float(f(0, 0, 0)), rel=1e-11, abs=1e-11)
    assume(np.isfinite(slope).all())
    np.testing.assert_allclose(slope[0], due, rtol=1e-10, atol=1e-10)
