"""Arithmetic of stacks of tables with log-scales, beyond the range of float64.

A stack of tables φ is an array of non-negative values, whose last `axes` axes are the entries of a
table, times exp(log-scale), with one log-scale for each table, (...).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from pgm.kernels.arrays import Array, Mask

Stacked = TypeVar("Stacked", Array, Mask)
Operation = Callable[[Array, Array], Array]

LOG_2 = float(np.log(2.0))
# A product whose largest entry is above this has lost nothing but entries 1e-300 times smaller.
SAFE = 1e-6
# An entry above this has all its digits.
LEAST = 1e-300
# Tables whose largest entry is between these stay as they are: products and sums of such hold.
SMALL, LARGE = 1e-100, 1e100
# This stands for the exponent of zero: it is below all exponents, and twice it fits 32 bits.
NOWHERE = -(10**6)
# Beyond this log-scale no entry of a double's range stays in it.
OUTSIDE = 3000.0


def rescale(values: Array, log_scale: Array, axes: int) -> tuple[Array, Array]:
    """The same tables, as values and log-scale, with extreme largest entries divided out.

    A table whose largest entry is below 10⁻¹⁰⁰ or above 10¹⁰⁰ is divided by this entry, whose
    logarithm is added to the log-scale. A table of zeros gets the log-scale zero.
    """
    top = largest(values, axes)
    extreme = (top < SMALL) | (top > LARGE)
    if not extreme.any():
        return values, log_scale
    empty = top == 0.0
    divisor = np.where(extreme & ~empty, top, 1.0)
    return values / _per_table(divisor, axes), np.where(empty, 0.0, log_scale + np.log(divisor))


def multiply(a: Array, b: Array, axes: int) -> tuple[Array, Array]:
    """The products of tables of values a and b, which broadcast, as values and log-scales (...).

    Log-scales of a and b themselves are for the caller to add.
    """
    return _combined(np.multiply, np.add, a, b, axes)


def divide(a: Array, b: Array, axes: int) -> tuple[Array, Array]:
    """The quotients of tables of values a and b, zero where b is, as values and log-scales (...).

    Log-scales of a and b themselves are for the caller to subtract.
    """
    return _combined(_quotient, np.subtract, a, b, axes)


def _quotient(a: Array, b: Array) -> Array:
    """The quotients a / b; zero where b is zero, since 0 / 0 arises at impossible states."""
    zeros = np.zeros(np.broadcast_shapes(a.shape, b.shape))
    return np.divide(a, b, out=zeros, where=b > 0.0)


def _combined(
    of_values: Operation, of_powers: Operation, a: Array, b: Array, axes: int
) -> tuple[Array, Array]:
    """The product or quotient of tables of values a and b, as values and log-scales (...).

    `of_values` multiplies or divides numbers, and `of_powers` adds or subtracts powers of two.
    Tables that would lose digits to overflow or underflow are computed again as mantissas and
    powers of two.
    """
    with np.errstate(over="ignore", under="ignore"):
        plain = of_values(a, b)
    held = _held(plain, a, b, axes)
    if held.all():
        return plain, np.zeros(held.shape)
    (a, powers), (b, others) = _exponents(a), _exponents(b)
    values = of_values(a, b)
    power = np.where(values > 0.0, of_powers(powers, others), NOWHERE)
    return _instead(plain, held, *_assemble(values, power, axes))


def _held(result: Array, a: Array, b: Array, axes: int) -> Mask:
    """The mask (...) of tables that lost no digits in `result`, the product or quotient of a and b.

    A table whose largest entry is finite and above 10⁻⁶ counts, as underflow can only have touched
    entries that are 10³⁰⁰ times smaller. Any other finite table counts if all its entries are at
    least 10⁻³⁰⁰, apart from those where a or b is zero.
    """
    top = largest(result, axes)
    held = (top > SAFE) & (top < np.inf)
    if not held.all():
        lost = ((result < LEAST) & (a > 0.0) & (b > 0.0)).any(axis=_span(axes))
        held |= ~lost & (top < np.inf)
    return held


def _instead(plain: Array, held: Mask, values: Array, log_scale: Array) -> tuple[Array, Array]:
    """Tables and their log-scales (...), each table chosen from two computations of it.

    Where the mask `held` (...) is true they are `plain` and zero, elsewhere `values` and
    `log_scale` (...).
    """
    kept = _per_table(held, plain.ndim - held.ndim)
    return np.where(kept, plain, values), np.where(held, 0.0, log_scale)


def largest(values: Array, axes: int) -> Array:
    """The largest entry of each table, (...)."""
    result: Array = values.max(axis=_span(axes))
    return result


def normalise(values: Array, axes: int) -> Array:
    """Each table divided by its sum; no table may be all zero."""
    result: Array = values / values.sum(axis=_span(axes), keepdims=True)
    return result


def log_total(values: Array, log_scale: Array, axes: int) -> Array:
    """The value ln Σ φ of each table, (...); −∞ if it is all zero.

    The sum of the values without the log-scale may neither overflow nor underflow.
    """
    with np.errstate(divide="ignore"):
        result: Array = np.log(values.sum(axis=_span(axes))) + log_scale
    return result


def log_entries(values: Array, log_scale: Array, axes: int) -> Array:
    """The logarithms of the entries of tables, ln φ; −∞ where φ is zero."""
    with np.errstate(divide="ignore"):
        result: Array = np.log(values) + _per_table(log_scale, axes)
    return result


def entries(values: Array, log_scale: Array) -> Array:
    """The entries v exp(s) of values v and log-scales s that broadcast with them.

    They overflow or underflow only where the result does.
    """
    held = np.clip(log_scale, -OUTSIDE, OUTSIDE)
    powers = np.rint(held / LOG_2)
    with np.errstate(over="ignore"):
        result: Array = np.ldexp(values * np.exp(held - powers * LOG_2), powers.astype(np.int32))
    return result


def _span(axes: int) -> tuple[int, ...]:
    """The indices −axes to −1 of the last `axes` axes, those of a table's entries."""
    return tuple(range(-axes, 0))


def _per_table(stacked: Stacked, axes: int) -> Stacked:
    """Numbers (...), one for each table, with `axes` axes of length one for its entries."""
    return stacked.reshape(stacked.shape + (1,) * axes)


def _exponents(values: Array) -> tuple[Array, Array]:
    """The mantissas and powers of two of values; for zero the power is −10⁶, below all others."""
    mantissa, power = np.frexp(values)
    return mantissa, np.where(values > 0.0, power, NOWHERE)


def _assemble(mantissa: Array, power: Array, axes: int) -> tuple[Array, Array]:
    """The tables mantissa · 2^power as values and log-scales (...).

    The largest power of two of each table goes into its log-scale. A table that is all zero has the
    log-scale zero.
    """
    top = power.max(axis=_span(axes))
    values: Array = np.ldexp(mantissa, power - _per_table(top, axes))
    return values, np.where(top > NOWHERE // 2, top * LOG_2, 0.0)


def entropy(probabilities: Array, axes: int) -> Array:
    """−Σ p ln p over the last axes, (...)."""
    from scipy.special import entr  # here, since it is slow to import

    return _over(entr(probabilities), axes)


def divergence(logs: Array, others: Array, axes: int) -> Array:
    """Σ p ln(p/q) over the last axes, (...), of the logarithms of p and q, whose sums are one.

    ∞ where a p that is not zero has a q that is. The sum is of p ln(p/q) − p + q, which is never
    negative: with d = ln(p/q) it is p (d + e⁻ᵈ − 1).
    """
    with np.errstate(invalid="ignore", over="ignore"):
        apart = logs - others
        near = np.exp(logs) * np.maximum(apart + np.expm1(-np.maximum(apart, -1.0)), 0.0)
        far = np.exp(logs) * (apart - 1.0) + np.exp(others)
        terms = np.where(apart > -1.0, near, far)
    terms = np.where(logs == -np.inf, np.exp(others), terms)
    terms = np.where((others == -np.inf) & (logs > -np.inf), np.inf, terms)
    found: Array = _over(terms, axes)
    return found


def _over(values: Array, axes: int) -> Array:
    found: Array = values.sum(axis=tuple(range(values.ndim - axes, values.ndim)))
    return found
