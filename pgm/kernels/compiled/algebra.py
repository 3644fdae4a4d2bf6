"""Small matrices in machine code.

A matrix of m columns has rows of `padded(m)` floats, zeros at their ends: a processor takes a row
by fours, so that sums go along rows, of which there are few.
"""

from __future__ import annotations

from math import log, sqrt
from typing import Any

from numba import njit

from pgm.kernels.compiled.memory import past

# They are called by each other alone, and hold no object of Python's.
compiled: Any = njit(
    error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=False
)


@compiled
def padded(columns):
    """The floats of a row."""
    return (columns + 3) & ~3


@compiled
def copy(source, target, count):
    """Copy so many floats."""
    for i in range(count):
        target[i] = source[i]


@compiled
def clear(target, count):
    """Zeros."""
    for i in range(count):
        target[i] = 0.0


@compiled
def add(sign, a, down, across, b, out, rows, inner, wide):
    """Add ± A B to rows of so many floats; entries of A lie `down` and `across` from each other."""
    for i in range(rows):
        for j in range(0, wide, 4):
            here = i * wide + j
            s0, s1, s2, s3 = out[here], out[here + 1], out[here + 2], out[here + 3]
            for k in range(inner):
                part, there = sign * a[i * down + k * across], k * wide + j
                s0 += part * b[there]
                s1 += part * b[there + 1]
                s2 += part * b[there + 2]
                s3 += part * b[there + 3]
            out[here], out[here + 1], out[here + 2], out[here + 3] = s0, s1, s2, s3


@compiled
def product(a, down, across, b, out, rows, inner, wide):
    """A B, as `add` adds it."""
    clear(out, rows * wide)
    add(1.0, a, down, across, b, out, rows, inner, wide)


@compiled
def transpose(a, out, rows, columns):
    """Aᵀ."""
    wide, tall = padded(columns), padded(rows)
    clear(out, columns * tall)
    for i in range(rows):
        for j in range(columns):
            out[j * tall + i] = a[i * wide + j]


@compiled
def mirror(a, size):
    """Copy what is below the diagonal above it."""
    wide = padded(size)
    for i in range(1, size):
        for j in range(i):
            a[j * wide + i] = a[i * wide + j]


@compiled
def root(s, upper, inverse, size, least):
    """The Lᵀ of S = L Lᵀ, and one over its diagonal; |S|, or zero if a pivot is too small.

    Too small is not above the part `least` of its diagonal entry.
    """
    wide, det = padded(size), 1.0
    for i in range(size):
        for j in range(i):
            rest = s[i * wide + j]
            for k in range(j):
                rest -= upper[k * wide + i] * upper[k * wide + j]
            upper[j * wide + i] = rest * inverse[j]
            upper[i * wide + j] = 0.0
        rest = s[i * wide + i]
        for k in range(i):
            rest -= upper[k * wide + i] * upper[k * wide + i]
        if not rest > least * s[i * wide + i]:
            return 0.0
        pivot = sqrt(rest)
        upper[i * wide + i], inverse[i] = pivot, 1.0 / pivot
        det *= rest
    for i in range(size):
        for j in range(size, wide):
            upper[i * wide + j] = 0.0
    return det


@compiled
def log_det(det, inverse, size):
    """The logarithm of a determinant, which may be too large or too small a number."""
    if 1e-280 < det < 1e280:
        return log(det)
    total = 0.0
    for i in range(size):
        total -= 2.0 * log(inverse[i])
    return total


@compiled
def whiten(upper, inverse, b, size, wide):
    """Put L⁻¹ B into B, of rows of so many floats."""
    tall = padded(size)
    for j in range(0, wide, 4):
        for i in range(size):
            here = i * wide + j
            s0, s1, s2, s3 = b[here], b[here + 1], b[here + 2], b[here + 3]
            for k in range(i):
                part, there = upper[k * tall + i], k * wide + j
                s0 -= part * b[there]
                s1 -= part * b[there + 1]
                s2 -= part * b[there + 2]
                s3 -= part * b[there + 3]
            by = inverse[i]
            b[here], b[here + 1], b[here + 2], b[here + 3] = s0 * by, s1 * by, s2 * by, s3 * by


@compiled
def unwhiten(upper, inverse, b, size, wide):
    """Put L⁻ᵀ B into B, of rows of so many floats."""
    tall = padded(size)
    for j in range(0, wide, 4):
        for i in range(size - 1, -1, -1):
            here = i * wide + j
            s0, s1, s2, s3 = b[here], b[here + 1], b[here + 2], b[here + 3]
            for k in range(i + 1, size):
                part, there = upper[i * tall + k], k * wide + j
                s0 -= part * b[there]
                s1 -= part * b[there + 1]
                s2 -= part * b[there + 2]
                s3 -= part * b[there + 3]
            by = inverse[i]
            b[here], b[here + 1], b[here + 2], b[here + 3] = s0 * by, s1 * by, s2 * by, s3 * by


@compiled
def squares(cov, gain, matrix, noise, size, height, out, work):
    """The covariance (I − G H) P (I − G H)ᵀ + G noise Gᵀ, given Gᵀ, (height, size)."""
    wide, tall = padded(size), padded(height)
    keep, half = work, past(work, size * wide)
    clear(keep, size * wide)
    for i in range(size):
        keep[i * wide + i] = 1.0
    add(-1.0, gain, 1, wide, matrix, keep, size, height, wide)
    product(noise, tall, 1, gain, half, height, height, wide)
    product(gain, 1, wide, half, out, size, height, wide)
    product(keep, wide, 1, cov, half, size, size, wide)
    turned = past(half, size * wide)
    transpose(keep, turned, size, size)
    add(1.0, half, wide, 1, turned, out, size, size, wide)
    mirror(out, size)


@compiled
def least_open(s, work, size):
    """The smallest share of a variance that the components before it leave open.

    One of zero does not count; a share below zero is rounding, or worse.
    """
    least, wide = 1.0, padded(size)
    for i in range(size):
        rest = s[i * wide + i]
        entry = rest
        for j in range(i):
            part = s[i * wide + j]
            for k in range(j):
                part -= work[i * wide + k] * work[k * wide + j]
            work[j * wide + i] = part  # of L D, above the diagonal
            work[i * wide + j] = part / work[j * wide + j]
            rest -= part * work[i * wide + j]
        if entry == 0.0:
            rest = 1.0
        elif not rest / abs(entry) > least:
            least = rest / abs(entry)
        work[i * wide + i] = rest
    return least
