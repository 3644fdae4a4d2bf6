"""Arrays of `decimal.Decimal`: arithmetic in as many digits as a model needs.

A Decimal represents any float64 exactly, and its exponent is unlimited, so that nothing underflows.
An operation takes about a microsecond an element, so that only small problems are solved this way.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import MAX_EMAX, MIN_EMIN, Context, Decimal, localcontext
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.kernels.arrays import Array

Decimals = npt.NDArray[Any]

ZERO: Decimals = np.array(Decimal(0), dtype=object)
ONE: Decimals = np.array(Decimal(1), dtype=object)
_LN10 = math.log(10.0)


@contextmanager
def precision(count: int) -> Iterator[None]:
    """A context in which decimals are rounded to `count` significant digits, and nothing raises."""
    # No traps: an overflow cannot happen, and what is undefined is NaN, as in float64.
    with localcontext(Context(prec=count, Emax=MAX_EMAX, Emin=MIN_EMIN, traps=[])):
        yield


_exact = np.frompyfunc(lambda number: Decimal(float(number)), 1, 1)
_float = np.frompyfunc(float, 1, 1)
_root = np.frompyfunc(lambda number: number.sqrt(), 1, 1)


def exact(array: Array) -> Decimals:
    """An array of floats as decimals, to all their digits."""
    return np.asarray(_exact(array), dtype=object).reshape(np.shape(array))


def zeros(*shape: int) -> Decimals:
    """An array of decimal zeros of a shape."""
    return np.full(shape, Decimal(0), dtype=object)


def floats(array: Decimals) -> Array:
    """The nearest float64 of each decimal; zero or infinity beyond its range."""
    return np.asarray(_float(array), dtype=np.float64).reshape(np.shape(array))


def sqrt(array: Decimals) -> Decimals:
    """The square roots of decimals, rounded to the digits of the current decimal context.

    That of a negative number is NaN in the context that `precision` opens; elsewhere it may raise.
    """
    return np.asarray(_root(array), dtype=object).reshape(np.shape(array))


def product(a: Decimals, b: Decimals) -> Decimals:
    """The product A B of stacked matrices (..., m, k) and (..., k, n); zeros where k is zero."""
    if a.shape[-1]:
        return np.asarray(np.matmul(a, b), dtype=object)
    lead = np.broadcast_shapes(a.shape[:-2], b.shape[:-2])
    return zeros(*lead, a.shape[-2], b.shape[-1])


def log(number: Decimal) -> float:
    """The natural logarithm of a positive number of any exponent, as a float64."""
    exponent = number.adjusted()
    return math.log(float(number.scaleb(-exponent))) + exponent * _LN10


def total(a: Decimals) -> Decimals:
    """The sums (...) of decimals (..., n) over the last axis; zero where n is zero."""
    return np.asarray(a.sum(axis=-1) if a.shape[-1] else zeros(*a.shape[:-1]), dtype=object)
