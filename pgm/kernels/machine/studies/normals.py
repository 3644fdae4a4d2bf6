"""Quantiles of the standard normal distribution, by rational functions.

Source: Wichura, Algorithm AS 241: the percentage points of the normal distribution, 1988, whose
routine PPND16 has a relative error of some 1e-16. In the middle, |u − 1/2| ≤ 0.425, the quantile is
q A(r) / B(r), q = u − 1/2 and r = 0.425² − q²; in a tail of probability p it is ± C(s) / D(s) of
s = √(−ln p) − 1.6, and beyond √(−ln p) = 5 likewise of √(−ln p) − 5. The coefficients below are of
numerators and denominators, of the highest power first.
"""

from __future__ import annotations

from collections.abc import Sequence

from pgm.kernels.machine.emitter.code import Code
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.numbers import log, sqrt, where

_MIDDLE = (
    (
        2.5090809287301226727e3,
        3.3430575583588128105e4,
        6.7265770927008700853e4,
        4.5921953931549871457e4,
        1.3731693765509461125e4,
        1.9715909503065514427e3,
        1.3314166789178437745e2,
        3.3871328727963666080e0,
    ),
    (
        5.2264952788528545610e3,
        2.8729085735721942674e4,
        3.9307895800092710610e4,
        2.1213794301586595867e4,
        5.3941960214247511077e3,
        6.8718700749205790830e2,
        4.2313330701600911252e1,
        1.0,
    ),
)
_TAIL = (
    (
        7.74545014278341407640e-4,
        2.27238449892691845833e-2,
        2.41780725177450611770e-1,
        1.27045825245236838258e0,
        3.64784832476320460504e0,
        5.76949722146069140550e0,
        4.63033784615654529590e0,
        1.42343711074968357734e0,
    ),
    (
        1.05075007164441684324e-9,
        5.47593808499534494600e-4,
        1.51986665636164571966e-2,
        1.48103976427480074590e-1,
        6.89767334985100004550e-1,
        1.67638483018380384940e0,
        2.05319162663775882187e0,
        1.0,
    ),
)
_FAR = (
    (
        2.01033439929228813265e-7,
        2.71155556874348757815e-5,
        1.24266094738807843860e-3,
        2.65321895265761230930e-2,
        2.96560571828504891230e-1,
        1.78482653991729133580e0,
        5.46378491116411436990e0,
        6.65790464350110377720e0,
    ),
    (
        2.04426310338993978564e-15,
        1.42151175831644588870e-7,
        1.84631831751005468180e-5,
        7.86869131145613259100e-4,
        1.48753612908506148525e-2,
        1.36929880922735805310e-1,
        5.99832206555887937690e-1,
        1.0,
    ),
)
_WIDTH, _SQUARE, _NEAR, _BEYOND = 0.425, 0.180625, 1.6, 5.0


def quantile(code: Code, uniform: Number) -> Number:
    """The standard normal numbers below which uniform ones, in (0, 1), lie."""
    off = uniform - 0.5
    found = code.variable(off * _ratio(_MIDDLE, _SQUARE - off * off))
    outside = abs(off) > _WIDTH
    with code.when(code.some(outside)):
        tail = where(off < 0.0, uniform, 1.0 - uniform)
        root = sqrt(-log(tail))
        size = code.variable(_ratio(_TAIL, root - _NEAR))
        far = root > _BEYOND
        with code.when(code.some(outside & far)):
            size.set(where(far, _ratio(_FAR, root - _BEYOND), size.get()))
        signed = where(off < 0.0, -size.get(), size.get())
        found.set(where(outside, signed, found.get()))
    return found.get()


def _ratio(coefficients: tuple[Sequence[float], Sequence[float]], x: Number) -> Number:
    above, below = (_polynomial(each, x) for each in coefficients)
    return above / below


def _polynomial(coefficients: Sequence[float], x: Number) -> Number:
    found = x * coefficients[0] + coefficients[1]
    for each in coefficients[2:]:
        found = found * x + each
    return found
