r"""Displacements on a lattice: kernels of exact mean and variance, as matrices along an axis.

A displacement of μ cells with variance s² (in cells) has the weights, over whole numbers k,

    w_k ∝ exp(a k − b k (k − 1)),  Σ w_k k = μ,  Σ w_k (k − μ)² = max(s², f (1 − f)),  f = μ − ⌊μ⌋:

the normal density of least distortion on a lattice, f(1 − f) being the least variance, of two
points. Means and variances then add up exactly from step to step. About ⌊μ⌋ the conditions are E k
= f and E k(k − 1) = max(s² − f(1 − f), 0), which Newton's method solves in a, b on the truncated
tails, so that truncating costs no digit of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import Array, Integers

# Deviations after which tails are cut: exp(−8.5²/2) is the rounding of float64.
REACH = 8.5
# An excess of variance below this is none; what is asked for is then met to as much.
_NONE = 1e-14
# From this variance on a sampled normal is the better beginning, else three points are.
_WIDE = 0.3
# Weights below this are none: products of them would be slow, denormal numbers.
_TINY = 1e-60
_ITERATIONS = 60


class Kernels(NamedTuple):
    """Kernels, one a row: the displacement `first` of the first of the `weights`, in cells.

    `added` is the variance that the lattice adds to the one asked for.
    """

    first: Integers
    weights: Array
    added: Array


def tap_count(variance: float) -> int:
    """The number of weights of a kernel of a variance, in cells."""
    return 2 * (math.ceil(REACH * math.sqrt(max(variance, 0.04))) + 2)


def kernels(shift: Array, variance: Array | float) -> Kernels:
    """The kernels of displacements (n,) with variances (n,) or a number, both in cells."""
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
    """Weights (n, taps) over k with E k = mean in [0, ½] and E k(k − 1) = excess."""
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
    """The parameters to begin with: of three points −1, 0, 1, or of a sampled normal."""
    variance = excess + mean * (1.0 - mean)
    wide = variance >= _WIDE
    with np.errstate(divide="ignore", invalid="ignore"):  # where the other one is taken
        middle = 1.0 - mean - excess
        a = np.log((mean + 0.5 * excess) / middle)
        b = -0.5 * (a + np.log(0.5 * excess / middle))
    b = np.where(wide, 0.5 / variance, b)
    return np.where(wide, (mean - 0.5) / variance, a), b


def _weights(k: Array, product: Array, a: Array, b: Array) -> Array:
    """The weights wₖ ∝ exp(a k − b p(k)) of each kernel, (kernels, taps), adding up to one.

    p is `product`; a and b (kernels,) are the multipliers of the mean and of the excess variance.
    """
    exponent = a[:, None] * k - b[:, None] * product
    exponent -= exponent.max(axis=1, keepdims=True)
    found = np.exp(exponent)
    found /= found.sum(axis=1, keepdims=True)
    return found


def _residual(
    weights: Array, k: Array, product: Array, mean: Array, excess: Array
) -> tuple[Array, Array]:
    """The mean and the excess variance that weights (kernels, taps) still miss.

    Σ w k should be the mean, and Σ w p(k) the excess, p being `product`.
    """
    return mean - weights @ k, excess - weights @ product


def _norm(residual: tuple[Array, Array], excess: Array) -> Array:
    """The size of both residuals together, (kernels,).

    The mean counts in cells; the excess variance relative to what is due, where that is above one.
    """
    return np.abs(residual[0]) + np.abs(residual[1]) / np.maximum(excess, 1.0)


class Span(NamedTuple):
    """Cells of an axis that stand together, past the end of a circle too."""

    first: int
    length: int


def reached(low: int, high: int, cells: int, periodic: bool) -> Span:
    """The cells of an axis from `low` up to, but without, `high`; at least one."""
    if periodic:
        return Span(0, cells) if high - low >= cells else Span(low % cells, high - low)
    low, high = min(max(low, 0), cells - 1), max(min(high, cells), 1)
    return Span(low, max(high - low, 1))


def matrices(
    first: Integers, weights: Array, source: Span, target: Span, cells: int, periodic: bool
) -> Array:
    """The kernels as matrices (n, target cells, source cells), columns being where mass comes from.

    `first` is (n, 1), of displacements that are equal from all cells, or (n, source cells), weights
    (*first.shape, taps); what leaves an axis that is not periodic is lost.
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
    """Products of matrices (n, target, source) with the lines of an array along an axis.

    One for each of the n cells of the other axes `by`, which ascend, or one of all.
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
