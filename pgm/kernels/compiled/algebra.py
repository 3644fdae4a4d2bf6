"""Small matrices in machine code, of one run, or of a pack of runs.

A matrix of m columns of one run has rows of `padded(m)` floats, zeros at their ends: a processor
takes a row by fours, so that sums go along rows, of which there are few. Of packs nothing is added.
"""

from __future__ import annotations

from math import log, sqrt

from pgm.kernels.compiled.memory import by_row, compiled, every, inlined, past, some
from pgm.kernels.compiled.packs import per_row, where


@compiled
def padded(columns):
    """The floats of a row of one run."""
    return (columns + 3) & ~3


@compiled
def width(columns, pointer):
    """The floats, or packs, of a row."""
    return (columns + per_row(pointer) - 1) & -per_row(pointer)


@compiled
def copy(source, target, count):
    """Copy so many."""
    for i in range(count):
        target[i] = source[i]


@compiled
def clear(target, count):
    """Zeros."""
    for i in range(count):
        target[i] = 0.0


@compiled
def add(sign, a, down, across, b, out, rows, inner, wide):
    """Add ± A B to rows of so many; entries of A lie `down` and `across` from each other."""
    # Loops of a known length are unrolled.
    if sign < 0.0:
        _add(-1.0, a, down, across, b, out, rows, inner, wide)
    elif inner == 3:
        _add(1.0, a, down, across, b, out, rows, 3, wide)
    elif inner == 2:
        _add(1.0, a, down, across, b, out, rows, 2, wide)
    else:
        _add(1.0, a, down, across, b, out, rows, inner, wide)


@inlined
def _add(sign, a, down, across, b, out, rows, inner, wide):
    blocks, right, sums = wide // per_row(out), by_row(b), by_row(out)
    for i in range(rows):
        for j in range(blocks):
            total = sums[i * blocks + j]
            for k in range(inner):
                total += sign * a[i * down + k * across] * right[k * blocks + j]
            sums[i * blocks + j] = total


@compiled
def product(a, down, across, b, out, rows, inner, wide):
    """A B, as `add` adds it."""
    clear(out, rows * wide)
    add(1.0, a, down, across, b, out, rows, inner, wide)


@compiled
def transpose(a, out, rows, columns):
    """Aᵀ."""
    wide, tall = width(columns, a), width(rows, a)
    clear(out, columns * tall)
    for i in range(rows):
        for j in range(columns):
            out[j * tall + i] = a[i * wide + j]


@compiled
def mirror(a, size):
    """Copy what is below the diagonal above it."""
    wide = width(size, a)
    for i in range(1, size):
        for j in range(i):
            a[j * wide + i] = a[i * wide + j]


@compiled
def root(s, upper, inverse, size, least):
    """The Lᵀ of S = L Lᵀ, and one over its diagonal; |S|, not above zero if a pivot is too small.

    Too small is not above the part `least` of its diagonal entry.
    """
    wide, det = width(size, s), 1.0
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
        det = where(rest > least * s[i * wide + i], det * rest, 0.0)
        if not some(det > 0.0):
            return det
        pivot = sqrt(rest)
        upper[i * wide + i], inverse[i] = pivot, 1.0 / pivot
    for i in range(size):
        for j in range(size, wide):
            upper[i * wide + j] = 0.0
    return det


@compiled
def log_det(det, inverse, size):
    """The logarithm of a determinant, which may be too large or too small a number."""
    moderate = (det > 1e-280) & (det < 1e280)
    if every(moderate):
        return log(det)
    total = 0.0
    for i in range(size):
        total -= 2.0 * log(inverse[i])
    return where(moderate, log(det), total)


@compiled
def whiten(upper, inverse, b, size, wide):
    """Put L⁻¹ B into B, of rows of so many."""
    tall, blocks, right = width(size, b), wide // per_row(b), by_row(b)
    for j in range(blocks):
        for i in range(size):
            total = right[i * blocks + j]
            for k in range(i):
                total -= upper[k * tall + i] * right[k * blocks + j]
            right[i * blocks + j] = total * inverse[i]


@compiled
def unwhiten(upper, inverse, b, size, wide):
    """Put L⁻ᵀ B into B, of rows of so many."""
    tall, blocks, right = width(size, b), wide // per_row(b), by_row(b)
    for j in range(blocks):
        for i in range(size - 1, -1, -1):
            total = right[i * blocks + j]
            for k in range(i + 1, size):
                total -= upper[i * tall + k] * right[k * blocks + j]
            right[i * blocks + j] = total * inverse[i]


@compiled
def squares(cov, gain, matrix, noise, size, height, out, work):
    """The covariance (I − G H) P (I − G H)ᵀ + G noise Gᵀ, given Gᵀ, (height, size)."""
    wide, tall = width(size, cov), width(height, cov)
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
    least, wide = 1.0, width(size, s)
    for i in range(size):
        entry = s[i * wide + i]
        rest = entry
        for j in range(i):
            part = s[i * wide + j]
            for k in range(j):
                part -= work[i * wide + k] * work[k * wide + j]
            work[j * wide + i] = part  # of L D, above the diagonal
            work[i * wide + j] = part / work[j * wide + j]
            rest -= part * work[i * wide + j]
        work[i * wide + i] = where(entry == 0.0, 1.0, rest)
        share = where(entry == 0.0, 1.0, rest / abs(entry))
        least = where(share > least, least, share)
    return least
