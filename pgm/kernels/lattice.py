r"""Displacements on a lattice: kernels of exact mean and variance, as matrices along an axis.

Lengths are in cells of the lattice, variances in squared cells. A *kernel* is a distribution over
displacements by whole numbers k of cells; its weights w_k, in a row, are its *taps*. A normal
distribution of displacements, of mean μ and variance s², becomes the kernel

    w_k ∝ exp(a k − b k (k − 1)),  Σ w_k k = μ,  Σ w_k (k − μ)² = max(s², f (1 − f)),  f = μ − ⌊μ⌋.

The parameters a and b are chosen such that its mean and variance are exact, and so add up exactly
from step to step. The least variance that a mean μ allows on a lattice is f (1 − f), that of a
kernel on the two points around μ.

With k counted from ⌊μ⌋ the two conditions are E k = f and E k(k − 1) = max(s² − f (1 − f), 0),
where E is the expectation under w; the latter value is the *excess*. Newton's method solves them
for a and b after the tails were cut off, so that cutting them costs no digit of the moments.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import Array, Integers

# Standard deviations after which tails are cut: exp(−8.5²/2) is the rounding of float64.
REACH = 8.5
# An excess below this counts as none: the variance is then off by less.
_NONE = 1e-14
# From this variance on a sampled normal is the better beginning, else three points are.
_WIDE = 0.3
# Weights below this are none: products of them would be slow, denormal numbers.
_TINY = 1e-60
_ITERATIONS = 60


class Kernels(NamedTuple):
    """The kernels of n displacements: tap j of `weights` (n, taps) moves by `first` (n,) + j cells.

    `added` (n,) is the variance that the lattice adds to the one asked for, max(f(1 − f) − s², 0).
    """

    first: Integers
    weights: Array
    added: Array


def tap_count(variance: float) -> int:
    """The number of taps of a kernel: enough for 8.5 standard deviations to both sides of its mean.

    `variance` is in squared cells; one below 0.04 counts as 0.04.
    """
    return 2 * (math.ceil(REACH * math.sqrt(max(variance, 0.04))) + 2)


def kernels(shift: Array, variance: Array | float) -> Kernels:
    """The kernels of displacements of mean `shift` (n,) and of a variance, (n,) or a number."""
    whole = np.floor(shift)
    part = shift - whole
    least = part * (1.0 - part)
    wanted = np.broadcast_to(np.asarray(variance, dtype=np.float64), shift.shape)
    excess = np.maximum(wanted - least, 0.0)
    # Mirrored, k to 1 − k, the fractional part is at most one half, and k(k − 1) stays.
    mirrored = part > 0.5
    near = np.where(mirrored, 1.0 - part, part)
    radius = tap_count(float(wanted.max(initial=0.0))) // 2
    k = np.arange(-radius + 1.0, radius + 1.0)
    weights = _solved(k, near, excess)
    weights[weights < _TINY] = 0.0
    weights = np.where(mirrored[:, None], weights[:, ::-1], weights)
    first = whole.astype(np.intp) + int(k[0])
    return Kernels(first, weights, np.maximum(least - wanted, 0.0))


def _solved(k: Array, mean: Array, excess: Array) -> Array:
    """Weights (n, taps) of whole numbers `k` (taps,), with E k = `mean`, E k(k − 1) = `excess`.

    `k` ascends by one, through 0 and 1; `mean` (n,) is in [0, ½], `excess` (n,) not negative. The
    weights are wₖ ∝ exp(a k − b k(k − 1)), or without an excess those of the two points 0 and 1.
    Newton's method ends when both conditions hold to rounding, no step comes nearer, or after 60
    steps.
    """
    weights = np.zeros((mean.size, k.size))
    zero = int(-k[0])
    two = excess <= _NONE
    weights[two, zero], weights[two, zero + 1] = 1.0 - mean[two], mean[two]
    (open_,) = np.nonzero(~two)
    if not open_.size:
        return weights
    mean, excess = mean[open_], excess[open_]
    a, b = _beginning(mean, excess)
    product = k * (k - 1.0)
    found = _weights(k, product, a, b)
    residual = _residual(found, k, product, mean, excess)
    size = np.maximum(1.0, excess)
    for _ in range(_ITERATIONS):
        bad = (np.abs(residual[0]) > 4e-16 * size**0.5) | (np.abs(residual[1]) > 4e-16 * size)
        if not bad.any():
            break
        row, one, other = found[bad], residual[0][bad], residual[1][bad]
        centred = k - (mean[bad] - one)[:, None]
        squared = product - (excess[bad] - other)[:, None]
        weighted = row * squared
        var = np.einsum("ij,ij,ij->i", row, centred, centred)
        cross = np.einsum("ij,ij->i", weighted, centred)
        spread = np.einsum("ij,ij->i", weighted, squared)
        determinant = var * spread - cross * cross
        step_a = (spread * one - cross * other) / determinant
        step_b = -(var * other - cross * one) / determinant
        # Moments are exponentials of a and b: no step changes one by more than about e².
        far = np.maximum(np.abs(step_a), np.abs(step_b))
        short = np.minimum(1.0, 2.0 / np.maximum(far, 1e-300))
        new_a, new_b = a[bad] + short * step_a, b[bad] + short * step_b
        tried = _weights(k, product, new_a, new_b)
        after = _residual(tried, k, product, mean[bad], excess[bad])
        chosen = _norm(after, excess[bad]) < _norm((one, other), excess[bad])
        chosen |= short < 1.0
        places = np.flatnonzero(bad)[chosen]
        if not places.size:  # as far as rounding goes
            break
        a[places], b[places], found[places] = new_a[chosen], new_b[chosen], tried[chosen]
        residual[0][places], residual[1][places] = after[0][chosen], after[1][chosen]
    weights[open_] = found
    return weights


def _beginning(mean: Array, excess: Array) -> tuple[Array, Array]:
    """The parameters a and b, (n,), that Newton's method begins with, of a mean and an excess (n,).

    For variances of 0.3 or more they are those of a sampled normal density, else those of the
    kernel on the three points −1, 0, 1 alone.
    """
    variance = excess + mean * (1.0 - mean)
    wide = variance >= _WIDE
    with np.errstate(divide="ignore", invalid="ignore"):  # where the other one is taken
        middle = 1.0 - mean - excess
        a = np.log((mean + 0.5 * excess) / middle)
        b = -0.5 * (a + np.log(0.5 * excess / middle))
    b = np.where(wide, 0.5 / variance, b)
    return np.where(wide, (mean - 0.5) / variance, a), b


def _weights(k: Array, product: Array, a: Array, b: Array) -> Array:
    """The weights wₖ ∝ exp(a k − b k(k − 1)) of each kernel, (kernels, taps), adding up to one.

    `product` (taps,) is k(k − 1); a and b (kernels,) are the multipliers of mean and excess.
    """
    exponent = a[:, None] * k - b[:, None] * product
    exponent -= exponent.max(axis=1, keepdims=True)
    found = np.exp(exponent)
    found /= found.sum(axis=1, keepdims=True)
    return found


def _residual(
    weights: Array, k: Array, product: Array, mean: Array, excess: Array
) -> tuple[Array, Array]:
    """By how much weights (kernels, taps) miss the mean and the excess asked for, (kernels,) each.

    They are mean − Σ w k and excess − Σ w k(k − 1), `product` being k(k − 1).
    """
    return mean - weights @ k, excess - weights @ product


def _norm(residual: tuple[Array, Array], excess: Array) -> Array:
    """The size of the residuals of mean and excess together, for each kernel, (kernels,).

    `residual` has by how much the kernels miss their means and `excess`, (kernels,) each. The size
    is |residual of the mean| + |residual of the excess| / max(excess, 1).
    """
    return np.abs(residual[0]) + np.abs(residual[1]) / np.maximum(excess, 1.0)


class Span(NamedTuple):
    """An interval of an axis: the `length` cells from the cell `first` on.

    On a periodic axis the interval may go past the last cell, and there goes on with cell 0.
    """

    first: int
    length: int


def reached(low: int, high: int, cells: int, periodic: bool) -> Span:
    """The span from cell `low` up to, but without, cell `high`, of an axis of so many `cells`.

    On a periodic axis the span begins at `low` modulo `cells`; a span of `cells` or more is the
    whole axis, from 0 on. On any other axis the span is cut to the axis, and has at least one cell.
    """
    if periodic:
        return Span(0, cells) if high - low >= cells else Span(low % cells, high - low)
    low, high = min(max(low, 0), cells - 1), max(min(high, cells), 1)
    return Span(low, max(high - low, 1))


def matrices(
    first: Integers, weights: Array, source: Span, target: Span, cells: int, periodic: bool
) -> Array:
    """The n kernels as matrices (n, target cells, source cells) along an axis of `cells` cells.

    Entry (i, j) moves mass from cell j of the span `source` to cell i of the span `target`. `first`
    has the displacements, in cells, of the kernels' first taps: (n, 1) if a kernel is the same from
    all source cells, else (n, source cells). `weights` (*first.shape, taps) are the kernels'
    weights. Mass that leaves the target, or an axis that is not periodic, is lost.
    """
    count, own, taps = weights.shape
    low = source.first - target.first
    if own > 1 or source.length == 1:
        column = np.arange(source.length)
        row = low + column[:, None] + first[..., None] + np.arange(taps)
        if periodic:
            row %= cells
        inside = (row >= 0) & (row < target.length)
        place = (np.arange(count)[:, None, None] * target.length + row) * source.length
        place = (place + column[:, None])[inside]
        size = count * target.length * source.length
        flat = np.bincount(place, weights=weights[inside], minlength=size).astype(np.float64)
        return flat.reshape(count, target.length, source.length)
    # Along diagonals: row − column runs from 1 − source.length to target.length − 1.
    length = target.length + source.length - 1
    diagonal = low + first + np.arange(taps) + source.length - 1
    if periodic:
        turns = range(-(-length // cells) + 1)
        diagonal = np.concatenate([diagonal % cells + cells * k for k in turns], axis=-1)
        weights = np.concatenate([weights[:, 0]] * len(turns), axis=-1)
    else:
        weights = weights[:, 0]
    inside = (diagonal >= 0) & (diagonal < length)
    place = (np.arange(count)[:, None] * length + diagonal)[inside]
    line = np.bincount(place, weights=weights[inside], minlength=count * length)
    line = line.reshape(count, length)
    step = line.strides[1]
    view = np.lib.stride_tricks.as_strided(
        line[:, source.length - 1 :],
        (count, target.length, source.length),
        (line.strides[0], step, -step),
        writeable=False,
    )
    return np.ascontiguousarray(view)  # products of overlapping rows would be slow


def along(matrix: Array, array: Array, axis: int, by: tuple[int, ...]) -> Array:
    """Multiply each line of an array along `axis` by a matrix.

    The array has source cells along `axis`, the result target cells. `matrix` (n, target cells,
    source cells) has n matrices: one for each combination of indices along the axes `by`, in C
    order, and one alone if `by` is empty. The axes `by` ascend, without `axis`. Lines that differ
    only in their indices along the remaining axes share a matrix.
    """
    rest = tuple(k for k in range(array.ndim) if k not in (axis, *by))
    last = axis == array.ndim - 1 and by + rest + (axis,) == tuple(range(array.ndim))
    order = (*by, *rest, axis) if last else (*by, axis, *rest)
    moved = array.transpose(order)
    lines = moved.reshape(len(matrix), -1, array.shape[axis]) if last else None
    if lines is not None:
        product = lines @ matrix.swapaxes(-1, -2)
    else:
        product = matrix @ moved.reshape(len(matrix), array.shape[axis], -1)
    shape = [array.shape[k] for k in order]
    shape[order.index(axis)] = matrix.shape[1]
    found: Array = product.reshape(shape).transpose(np.argsort(order))
    return found
