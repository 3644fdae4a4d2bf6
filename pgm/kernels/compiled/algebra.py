"""Small matrices as rows of floats, one after another, in machine code.

A product goes along the rows of its right factor, which a processor does several columns at a time.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from numba import njit

compiled: Any = njit(
    error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=False
)


@compiled
def copy(source, target, count):
    """Copy so many floats."""
    for i in range(count):
        target[i] = source[i]


@compiled
def times(f, x, out, height, width):
    """F x."""
    for i in range(height):
        total = 0.0
        for k in range(width):
            total += f[i * width + k] * x[k]
        out[i] = total


@compiled
def product(a, b, out, height, inner, width):
    """A B."""
    for i in range(height):
        for j in range(width):
            total = 0.0
            for k in range(inner):
                total += a[i * inner + k] * b[k * width + j]
            out[i * width + j] = total


@compiled
def add_symmetric(a, b, out, size, inner):
    """Add A Bᵀ, which is symmetric, to a symmetric matrix."""
    for i in range(size):
        for j in range(i + 1):
            total = out[i * size + j]
            for k in range(inner):
                total += a[i * inner + k] * b[j * inner + k]
            out[i * size + j] = total
            out[j * size + i] = total


@compiled
def root(s, lower, size, least):
    """The lower triangular L of S = L Lᵀ; whether each pivot is above this part of its entry."""
    for i in range(size):
        for j in range(i + 1):
            rest = s[i * size + j]
            for k in range(j):
                rest -= lower[i * size + k] * lower[j * size + k]
            if j < i:
                lower[i * size + j] = rest / lower[j * size + j]
            elif not rest > least * s[i * size + i]:
                return False
            else:
                lower[i * size + i] = sqrt(rest)
    return True


@compiled
def whiten(lower, b, size, width):
    """Put L⁻¹ B into B, (size, width)."""
    for i in range(size):
        for k in range(i):
            part = lower[i * size + k]
            for j in range(width):
                b[i * width + j] -= part * b[k * width + j]
        pivot = 1.0 / lower[i * size + i]
        for j in range(width):
            b[i * width + j] *= pivot


@compiled
def unwhiten(lower, b, size, width):
    """Put L⁻ᵀ B into B, (size, width)."""
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            part = lower[k * size + i]
            for j in range(width):
                b[i * width + j] -= part * b[k * width + j]
        pivot = 1.0 / lower[i * size + i]
        for j in range(width):
            b[i * width + j] *= pivot


@compiled
def least_open(s, lower, size):
    """The smallest share of a variance that the components before it leave open.

    One of zero does not count; a negative share is rounding, or worse.
    """
    least = 1.0
    for i in range(size):
        entry = s[i * size + i]
        for j in range(i):
            rest = s[i * size + j]
            for k in range(j):
                rest -= lower[i * size + k] * lower[k * size + j]
            lower[j * size + i] = rest  # of L D, above the diagonal
            lower[i * size + j] = rest / lower[j * size + j]
        rest = entry
        for k in range(i):
            rest -= lower[i * size + k] * lower[k * size + i]
        if entry == 0.0:
            rest = 1.0
        elif not rest / abs(entry) > least:
            least = rest / abs(entry)
        lower[i * size + i] = rest
    return least
