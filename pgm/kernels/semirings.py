"""Semirings of tables: the product and the sum that a pass of messages is made of.

Entries are non-negative numbers in `SUM_PRODUCT`. They are logarithms in `LOG_SUM_PRODUCT`, whose
sum is ln Σ exp, and in `MAX_PRODUCT`, whose sum is the maximum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgm.kernels.arrays import Array

Axes = int | tuple[int, ...]
# The logarithm of the smallest number of float64 that has all digits, rounded up.
_LEAST = -708.0
# The least number of all that are finite.
_LOWEST = float(np.finfo(np.float64).min)


@dataclass(frozen=True, eq=False)
class Semiring:
    """A semiring of the entries of tables: a product and a sum, and their neutral entries.

    `times` and `over` multiply and divide entries; `zero` and `one` are neutral for sum and
    product. ``total(values, axes)`` sums along one or more axes, into an array ``out=`` if one is
    given. `linear`: entries are numbers, not logarithms.
    """

    zero: float
    one: float
    times: np.ufunc
    over: np.ufunc
    total: Callable[..., Array]
    linear: bool

    def divisor(self, values: Array) -> Array:
        """The values with each `zero` replaced by `one`, so that zero divided by them is zero."""
        safe: Array = np.where(values == self.zero, self.one, values)
        return safe

    def entries(self, values: Array) -> Array:
        """Non-negative numbers as entries of this semiring: themselves, or their logarithms."""
        if self.linear:
            return values
        with np.errstate(divide="ignore"):
            logs: Array = np.log(values)
        return logs

    def of_logs(self, logs: Array) -> Array:
        """Logarithms as entries of this semiring: themselves, or their exponentials.

        An exponential that float64 does not hold with all its digits is a `FloatingPointError`.
        """
        if not self.linear:
            return logs
        if (((logs < _LEAST) & (logs > -np.inf)) | (logs > -_LEAST)).any():
            raise FloatingPointError
        values: Array = np.exp(logs)
        return values

    def logs(self, entries: Array) -> Array:
        """The logarithms of entries."""
        logs: Array = np.log(entries) if self.linear else entries
        return logs


def log_sum(values: Array, axis: Axes, out: Array | None = None) -> Array:
    """The sums ln Σ exp(values) along axes, which are dropped; −∞ where all values are −∞.

    They are put into `out` if that is given.
    """
    top = np.maximum.reduce(values, axis, keepdims=True, initial=_LOWEST)
    with np.errstate(divide="ignore", under="ignore"):
        result: Array = np.log(np.add.reduce(np.exp(values - top), axis), out)
    result += top.squeeze(axis)
    return result


def subtrahend(logs: Array) -> Array:
    """Logarithms to be subtracted from others: −∞ is the least number, so that −∞ less it is −∞."""
    found: Array = np.maximum(logs, _LOWEST)
    return found


def exp(logs: Array, out: Array | None = None) -> Array:
    """The exponentials of logarithms; zero, without a warning, where they are too small.

    They are put into `out` if that is given.
    """
    with np.errstate(under="ignore"):
        values: Array = np.exp(logs, out)
    return values


SUM_PRODUCT = Semiring(0.0, 1.0, np.multiply, np.divide, np.add.reduce, True)
LOG_SUM_PRODUCT = Semiring(-np.inf, 0.0, np.add, np.subtract, log_sum, False)
MAX_PRODUCT = Semiring(-np.inf, 0.0, np.add, np.subtract, np.maximum.reduce, False)
