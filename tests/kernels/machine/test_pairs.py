"""Pairs of floats in machine code: the very digits of NumPy's, which contraction would spoil."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest
from machine_code import WIDTHS, apart, elementwise

from pgm.beliefs.moments.digits.laid_out import two
from pgm.beliefs.moments.digits.written import Trace
from pgm.kernels import extended
from pgm.kernels.extended import Twofold
from pgm.kernels.machine.emitter.traces import written

mp = mpmath.mp.clone()
mp.dps = 60


def machine(step, count, lanes, **options):
    """A function of pairs in machine code, as that of arrays: high and low part of its value."""
    trace = Trace()
    function = trace.function(step(*(two(trace.given, 1) for _ in range(count))))

    def part(place):
        def make(code, *numbers):
            return written(code, function, function.value, lambda k, _: numbers[k])[place]

        return elementwise(make, 2 * count, lanes, **{"contract": False, **options})

    def applied(*pairs):
        given = [each for pair in pairs for each in (pair.hi, pair.lo)]
        return Twofold(part(0)(*given), part(1)(*given))

    return applied


def drawn(count, seed, most=20.0):
    rng = np.random.default_rng(seed)
    high = rng.choice([-1.0, 1.0], count) * np.exp(rng.uniform(-most, most, count))
    return Twofold(high, high * rng.uniform(-1.0, 1.0, count) * 2.0**-54)


STEPS = {
    "sum": (lambda a, b: a + b, 2),
    "difference": (lambda a, b: a - b, 2),
    "product": (lambda a, b: a * b, 2),
    "quotient": (lambda a, b: a / b, 2),
    "root": (lambda a: extended.sqrt(a * a), 1),
    "determinant": (lambda a, b, c, d: a * d - b * c, 4),
}


@pytest.mark.parametrize("lanes", WIDTHS)
@pytest.mark.parametrize("name", STEPS)
def test_pairs_are_numpys_to_the_last_bit(name, lanes):
    step, count = STEPS[name]
    given = [drawn(400, seed) for seed in range(count)]
    found, due = machine(step, count, lanes)(*given), step(*given)
    np.testing.assert_array_equal(found.hi, due.hi)
    np.testing.assert_array_equal(found.lo, due.lo)


def test_contraction_would_spoil_them():
    step, count = STEPS["determinant"]
    given = [drawn(400, seed) for seed in range(count)]
    found, due = machine(step, count, 1, contract=True)(*given), step(*given)
    assert (found.lo != due.lo).any()


@pytest.mark.parametrize("lanes", [1, 8])
def test_a_product_and_a_sum_are_rounded_together(lanes):
    a, b, c = (drawn(500, seed, most=2.0).hi for seed in range(3))
    c[:250] = -(a * b)[:250]
    found = elementwise(lambda _, x, *others: x.apply("fma", *others), 3, lanes)(a, b, c)
    triples = zip(a, b, c, strict=True)
    due = [float(Fraction(x) * Fraction(y) + Fraction(z)) for x, y, z in triples]
    assert apart(found, due).max() == 0


def exact(pair, k):
    return mp.mpf(pair.hi[k]) + mp.mpf(pair.lo[k])


@pytest.mark.parametrize("lanes", [None, 1, 8])
@pytest.mark.parametrize("name", ["log", "sqrt"])
def test_logarithms_and_roots_have_30_digits(name, lanes):
    x = drawn(200, 5, most=300.0)
    x = extended.where(x.hi < 0.0, -x, x)
    near = np.random.default_rng(1).uniform(-1e-3, 1e-3, 60)
    x[140:] = 1.0 + Twofold(near) * near
    function = getattr(extended, name)
    found = function(x) if lanes is None else machine(function, 1, lanes)(x)
    for k in range(200):
        due = getattr(mp, name)(exact(x, k))
        assert abs(exact(found, k) - due) <= 1e-30 * abs(due)


@pytest.mark.parametrize("lanes", [None, 1, 8])
@pytest.mark.parametrize("name", ["log", "sqrt"])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_special_values_are_numpys(name, lanes):
    x = Twofold(np.array([0.0, -1.0, np.inf, np.nan, 1.0, -np.inf, -0.0, 2.0**-1060, 1e308]))
    function = getattr(extended, name)
    found = function(x) if lanes is None else machine(function, 1, lanes)(x)
    assert apart(found.hi, getattr(np, name)(x.hi)).max() <= 1
