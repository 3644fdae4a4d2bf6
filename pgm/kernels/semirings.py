"""Semirings of tables: the product and the sum that a pass of messages is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgm.kernels.arrays import Array

Axes = int | tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Semiring:
    """A product and a sum of entries of tables, and their neutral entries.

    ``total(values, axes, out)`` sums along axes; `linear` entries are numbers, not logarithms.
    """

    zero: float
    one: float
    times: np.ufunc
    over: np.ufunc
    total: Callable[[Array, Axes, Array | None], Array]
    linear: bool

    def divisor(self, values: Array) -> Array:
        """The values with 1 for 0, so that the message quotient 0/0 becomes 0."""
        safe: Array = np.where(values == self.zero, self.one, values)
        return safe

    def entries(self, values: Array) -> Array:
        """Non-negative numbers as entries of this semiring."""
        if self.linear:
            return values
        with np.errstate(divide="ignore"):
            logs: Array = np.log(values)
        return logs

    def logs(self, entries: Array) -> Array:
        """The logarithms of entries."""
        logs: Array = np.log(entries) if self.linear else entries
        return logs


def _add(values: Array, axis: Axes, out: Array | None) -> Array:
    result: Array = np.add.reduce(values, axis, out=out)
    return result


def _maximum(values: Array, axis: Axes, out: Array | None) -> Array:
    result: Array = np.maximum.reduce(values, axis, out=out)
    return result


def log_sum(values: Array, axis: Axes, out: Array | None = None) -> Array:
    """The value ln Σ exp(values) along axes; −∞ where all are −∞."""
    top = np.maximum.reduce(values, axis, keepdims=True)
    top = np.where(top == -np.inf, 0.0, top)
    with np.errstate(divide="ignore", under="ignore"):
        result: Array = np.log(np.add.reduce(np.exp(values - top), axis), out)
    result += top.squeeze(axis)
    return result


def exp(logs: Array, out: Array | None = None) -> Array:
    """The numbers of logarithms; zero, where they are too small."""
    with np.errstate(under="ignore"):
        values: Array = np.exp(logs, out)
    return values


SUM_PRODUCT = Semiring(0.0, 1.0, np.multiply, np.divide, _add, True)
LOG_SUM_PRODUCT = Semiring(-np.inf, 0.0, np.add, np.subtract, log_sum, False)
MAX_PRODUCT = Semiring(-np.inf, 0.0, np.add, np.subtract, _maximum, False)
