"""Gaussian factors as rows: exp(−½ ‖A x − r‖² + g) Π δ(C x − c), on stacked arrays.

A (..., k, n) is a root of the information matrix, K = AᵀA and h = Aᵀr, so that nothing is ever
squared or subtracted: a product stacks rows, and a QR factorisation integrates variables out.
Several right sides r, (..., k, N), share one A. C (..., m, n) with c (..., m, N) are exact
relations, which have no K; a row of zeros says nothing. Where a result does not exist it is NaN;
the callers, who know the names, raise (Bierman, 1977; Schoeman, van Daalen & du Preez, 2022).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, transpose

# A singular value or a pivot below this part of its column is rounding.
NEGLIGIBLE = 1e-11
# What is larger, of a frame's units, may be no rounding.
ROUNDING = 1e-13
# How far exact relations may miss one another, in units of the frame, and still be rounding.
CONTRADICTION = 1e-7


class Rows(NamedTuple):
    """A stack of factors: A (..., k, n), r (..., k, N); exact relations C x = c, or None."""

    matrix: Array
    right: Array
    exact: Array | None = None
    exact_right: Array | None = None


class Eliminated(NamedTuple):
    """A factor over (x, s) as a conditional of x given s, times a factor over s.

    x = gain s + offset + n, n ~ N(0, noise). `rest`, over s, has s rows, triangular; `log_scale`
    (..., N) is g of it, less that of the factor. `contradiction` tells where exact relations
    contradict one another; `largest` is of rows' entries after these were put in, and of
    reciprocals of their divisors, infinite where it is not certain which are independent.
    """

    gain: Array
    offset: Array
    noise: Array
    rest: Rows
    log_scale: Array
    contradiction: Mask | None
    largest: float


def eliminate(factor: Rows, count: int) -> Eliminated:
    """Integrate the first `count` variables out, keeping their conditional."""
    if factor.exact is None or factor.exact_right is None or not factor.exact.shape[-2]:
        return _eliminate_proper(factor.matrix, factor.right, count)
    return _eliminate_exact(factor.matrix, factor.right, factor.exact, factor.exact_right, count)


def triangular(matrix: Array, right: Array) -> Array:
    """The triangular factor of [A | r], of A's columns or more; rows sorted by size keep digits."""
    rows, size = matrix.shape[-2:]
    if rows < size:
        spare = [(0, 0)] * (matrix.ndim - 2) + [(0, size - rows), (0, 0)]
        matrix, right = np.pad(matrix, spare), np.pad(right, spare)
    both = np.concatenate([matrix, right], axis=-1)
    order = np.argsort(-np.abs(matrix).max(axis=-1, initial=0.0), axis=-1, kind="stable")
    both = np.take_along_axis(both, order[..., None], axis=-2)
    return np.asarray(np.linalg.qr(both, mode="r"))


def largest_first(correlation: Array) -> Integers:
    """The pivot order of components, (..., n): each has the largest conditional variance left."""
    left = correlation
    order = np.empty(left.shape[:-1], dtype=np.intp)
    taken = np.zeros(left.shape[:-1], dtype=bool)
    for k in range(left.shape[-1]):
        pivots = np.where(taken, -np.inf, np.diagonal(left, axis1=-2, axis2=-1))
        first = pivots.argmax(axis=-1)[..., None]
        order[..., k] = first[..., 0]
        np.put_along_axis(taken, first, True, axis=-1)
        column = np.take_along_axis(left, first[..., None], axis=-1)
        pivot = np.take_along_axis(pivots, first, axis=-1)[..., None]
        left = left - column * (transpose(column) / np.where(pivot > NEGLIGIBLE, pivot, np.inf))
    return order


def _eliminate_proper(matrix: Array, right: Array, count: int) -> Eliminated:
    """Integrate the first `count` variables out of rows without exact relations.

    A QR factorisation makes the rows [E F; 0 G], with sides [e; g]: the rest is G with g, and the
    variables are E⁻¹ (e − F s) + noise of covariance E⁻¹ E⁻ᵀ, given the others s. The log-scale is
    ½ count ln 2π − ln |det E| − ½ ‖what is left of r‖².
    """
    size = matrix.shape[-1]
    factor = triangular(matrix, right)
    inside = factor[..., :count, :count]
    pivots = np.abs(np.diagonal(inside, axis1=-2, axis2=-1))
    width = np.sqrt(np.einsum("...ij,...ij->...j", inside, inside))
    proper = pivots > NEGLIGIBLE * width
    if not proper.all():
        # NaN marks what does not exist, without stopping the others of the stack.
        inside = np.where(proper[..., None], inside, np.nan)
        pivots = np.where(proper, pivots, np.nan)
    wanted = np.concatenate(
        [
            -factor[..., :count, count:size],
            factor[..., :count, size:],
            np.broadcast_to(np.eye(count), inside.shape),
        ],
        axis=-1,
    )
    solved = np.linalg.solve(inside, wanted)
    sepset = size - count
    inverse = solved[..., -count:] if count else solved[..., :0]
    left = factor[..., size:, size:]
    log_scale = (
        0.5 * (count * LOG_2PI - np.einsum("...ij,...ij->...j", left, left))
        - (np.log(pivots).sum(axis=-1)[..., None])
    )
    rest = Rows(factor[..., count:size, count:size], factor[..., count:size, size:])
    return Eliminated(
        solved[..., :sepset],
        solved[..., sepset : solved.shape[-1] - count],
        inverse @ transpose(inverse),
        rest,
        log_scale,
        None,
        0.0,
    )


def _eliminate_exact(
    matrix: Array, right: Array, exact: Array, exact_right: Array, count: int
) -> Eliminated:
    """`eliminate` with exact relations: they determine some directions of x, the rest is proper.

    With C_x = U S Vᵀ, directions V₁ are determined by s; V₂ are left to the rows.
    """
    sepset = matrix.shape[-1] - count
    known = np.concatenate([exact[..., count:], exact_right], axis=-1)
    determined, turned, left, log_size, least = _solved(exact[..., :count], known)
    # x = along s + at + free w, with w in the directions that no relation determines.
    fixed = transpose(determined) @ turned
    along, at = -fixed[..., :sepset], fixed[..., sepset:]
    free = np.eye(count) - transpose(determined) @ determined
    inside = matrix[..., :count]
    # Unit rows hold the determined directions of w at zero; what they integrate to is taken off.
    pins = np.concatenate([determined, np.zeros((*determined.shape[:-1], sepset))], axis=-1)
    moved = np.concatenate([inside @ free, matrix[..., count:] + inside @ along], axis=-1)
    proper = _eliminate_proper(
        np.concatenate([moved, pins], axis=-2),
        np.concatenate(
            [right - inside @ at, np.zeros((*pins.shape[:-1], right.shape[-1]))], axis=-2
        ),
        count,
    )
    pinned = determined.any(axis=-1).sum(axis=-1)
    log_scale = proper.log_scale - (0.5 * LOG_2PI * pinned + log_size)[..., None]
    rest_exact, rest_right, scale, contradiction, doubt = _independent(
        left[..., :sepset], left[..., sepset:], np.abs(exact_right).max(axis=-2, initial=1.0)
    )
    return Eliminated(
        along + free @ proper.gain,
        at + free @ proper.offset,
        free @ proper.noise @ free,
        Rows(*proper.rest[:2], rest_exact, rest_right),
        log_scale - scale[..., None],
        contradiction,
        max(float(np.abs(moved).max(initial=0.0)), least, doubt),
    )


def _independent(
    exact: Array, right: Array, size: Array
) -> tuple[Array, Array, Array, Mask, float]:
    """Orthonormal rows of noise-free relations.

    With them: ln of the scale removed, contradictions, and rows in doubt.

    A relation that the others imply is left out. Right sides come of numbers of a size, (..., N).
    """
    independent, solved, left, log_size, doubt = _solved(exact, right)
    far = np.abs(left).max(axis=-2, initial=0.0)
    if not (far <= ROUNDING * size).all():
        doubt = np.inf
    return independent, solved, log_size, far > CONTRADICTION * size, doubt


def _solved(matrix: Array, right: Array) -> tuple[Array, Array, Array, Array, float]:
    """Relations solved for directions: matrix x = right is rows x = solved, and left = 0.

    Returns orthonormal rows, and rows of zeros; `solved`; `left`; the sum of logarithms of
    divisors, (...); and the reciprocal of the least, infinite if one left out may be no rounding.
    """
    u, values, vt = _svd(matrix)
    count = values.shape[-1]
    used = values > NEGLIGIBLE * np.maximum(values.max(axis=-1, initial=0.0), 1.0)[..., None]
    divisor = np.where(used, values, 1.0)
    turned = transpose(u) @ right
    solved = turned[..., :count, :] / divisor[..., None] * used[..., None]
    turned[..., :count, :] *= ~used[..., None]
    rounding = (values[~used] <= ROUNDING).all()
    doubt = float(1.0 / values[used].min(initial=1.0)) if rounding else np.inf
    rows = vt[..., :count, :] * used[..., None]
    return rows, solved, turned, np.log(divisor).sum(axis=-1), doubt


def _svd(matrix: Array) -> tuple[Array, Array, Array]:
    """U, S and Vᵀ with a square U, also where there are no columns."""
    if matrix.size:
        try:
            return np.linalg.svd(matrix, full_matrices=True)
        except np.linalg.LinAlgError:  # NaN or infinity, of which nothing is known
            lost = np.linalg.svd(np.zeros_like(matrix), full_matrices=True)
            return lost[0] * np.nan, lost[1] * np.nan, lost[2] * np.nan
    lead, (rows, columns) = matrix.shape[:-2], matrix.shape[-2:]
    left = np.broadcast_to(np.eye(rows), (*lead, rows, rows))
    return left, np.zeros((*lead, 0)), np.broadcast_to(np.eye(columns), (*lead, columns, columns))
