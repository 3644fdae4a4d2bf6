"""Gaussian factors as rows: exp(−½ ‖A x − r‖² + g) Π δ(C x − c), on stacked arrays.

A (..., k, n) is a root of the information matrix, K = AᵀA and h = Aᵀr, so that nothing is ever
squared or subtracted: a product puts rows below one another, and a QR factorisation integrates
variables out (Bierman, 1977; Schoeman, van Daalen & du Preez, 2022). The columns of r (..., k, N)
are N right sides that share one A: N factors. The *exact relations* C x = c, C (..., m, n) and c
(..., m, N), have no noise, and so no K; a row of zeros says nothing. The log-scale g is kept by
the callers. Where a result does not exist it is NaN; the callers, who know the names of variables,
raise.

The variables are in units of a *frame*, (x − prior mean) / prior standard deviation, so that fixed
thresholds tell rounding.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels import roots
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, transpose

# A singular value or a pivot below this part of its column is rounding.
NEGLIGIBLE = 1e-11
# What is larger, in units of the frame, may be more than rounding.
ROUNDING = 1e-13
# How far exact relations may miss one another, in units of the frame, and still be rounding.
CONTRADICTION = 1e-7


class Rows(NamedTuple):
    """A stack of factors exp(−½ ‖A x − r‖²) Π δ(C x − c).

    `matrix` is A (..., k, n), `right` r (..., k, N), `exact` C (..., m, n) and `exact_right` c
    (..., m, N), None both if there are no exact relations.
    """

    matrix: Array
    right: Array
    exact: Array | None = None
    exact_right: Array | None = None


class Eliminated(NamedTuple):
    """A factor over (x, s) as a conditional p(x | s), times the factor over s that is left.

    p(x | s) is x = gain s + offset + v, v ~ N(0, noise); x has d variables and s has e.

    gain: (..., d, e).
    offset: (..., d, N), a column for each right side.
    noise: The covariance of v, (..., d, d).
    rest: The factor over s that is left; its A (..., e, e) is upper triangular.
    log_scale: The log-scale g of `rest` less that of the given factor, (..., N).
    contradiction: The mask (..., N) of right sides whose exact relations contradict one another;
        None if there are no relations.
    largest: The factor by which exact relations may magnify rounding. It is the largest number,
        over the whole stack, among the entries of the rows after the relations were substituted
        for x, and the reciprocals of the singular values that the relations were divided by. It is
        infinite where it is not certain which relations are independent, 0 if there are none.
    """

    gain: Array
    offset: Array
    noise: Array
    rest: Rows
    log_scale: Array
    contradiction: Mask | None
    largest: float


def eliminate(factor: Rows, count: int) -> Eliminated:
    """Integrate the first `count` variables x out of a factor over (x, s), keeping p(x | s).

    The result has the conditional p(x | s) and the integral, the factor over s that is left.
    """
    if factor.exact is None or factor.exact_right is None or not factor.exact.shape[-2]:
        return _eliminate_proper(factor.matrix, factor.right, count)
    return _eliminate_exact(factor.matrix, factor.right, factor.exact, factor.exact_right, count)


def triangular(matrix: Array, right: Array) -> Array:
    """The upper triangular factor R of a QR factorisation of [A | r], (..., rows, n + N).

    `matrix` A is (..., k, n), `right` r (..., k, N). R has min(max(k, n), n + N) rows, n or more;
    rows of [A | r] are taken by size, the largest first, which keeps digits.
    """
    rows, size = matrix.shape[-2:]
    if rows < size:
        spare = [(0, 0)] * (matrix.ndim - 2) + [(0, size - rows), (0, 0)]
        matrix, right = np.pad(matrix, spare), np.pad(right, spare)
    both = np.concatenate([matrix, right], axis=-1)
    order = np.argsort(-np.abs(matrix).max(axis=-1, initial=0.0), axis=-1, kind="stable")
    both = np.take_along_axis(both, order[..., None], axis=-2)
    return np.asarray(np.linalg.qr(both, mode="r"))


def largest_first(correlation: Array) -> Integers:
    """The indices of components, (..., n), in pivot order, for correlations (..., n, n).

    Each component has, of those not yet in the order, the largest variance given the earlier ones.
    """
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


class Pivoted(NamedTuple):
    """A covariance as deviations and a root L of its correlations, those first that vary most.

    So no row of L⁻¹ takes up the rounding of another.

    deviation: (..., n, 1); one where there is no variance.
    order: The indices of components in pivot order, (..., n, 1).
    correlation: The correlations in this order, (..., n, n).
    lower: L (..., n, n), with zero pivots where components are determined, NaN where the covariance
        is indefinite; see `roots.root`.
    """

    deviation: Array
    order: Integers
    correlation: Array
    lower: Array


def pivoted(cov: Array) -> Pivoted:
    """The deviations of covariances (..., n, n), and the roots of their correlations."""
    variance = np.diagonal(cov, axis1=-2, axis2=-1)
    deviation = np.sqrt(np.where(variance > 0.0, variance, 1.0))[..., None]
    correlation = cov / (deviation * transpose(deviation))
    order = largest_first(correlation)[..., None]
    correlation = np.take_along_axis(correlation, order, axis=-2)
    correlation = np.take_along_axis(correlation, order.swapaxes(-1, -2), axis=-1)
    lower = roots.root(correlation, negligible=NEGLIGIBLE)
    return Pivoted(deviation, order, correlation, lower)


def _eliminate_proper(matrix: Array, right: Array, count: int) -> Eliminated:
    """Integrate the first `count` variables x out of rows without exact relations.

    `matrix` is A (..., k, n) and `right` r (..., k, N); s are all other variables. A QR
    factorisation turns the rows A into [E F; 0 G; 0 0], with a square E (count, count), and their
    right sides into [e; t; q]. The integral, a factor over s, has the rows G with right sides t.
    Given s, x is E⁻¹ (e − F s) + noise of covariance E⁻¹ E⁻ᵀ. The integral's log-scale is
    ½ count ln 2π − ln |det E| − ½ ‖q‖². Results are NaN where E is singular but for rounding.
    """
    size = matrix.shape[-1]
    factor = triangular(matrix, right)
    inside = factor[..., :count, :count]
    pivots = np.abs(np.diagonal(inside, axis1=-2, axis2=-1))
    width = np.sqrt(np.einsum("...ij,...ij->...j", inside, inside))
    proper = pivots > NEGLIGIBLE * width
    lost = ~proper.all(axis=-1)
    if lost.any():  # which must not stop the others of the stack
        inside = np.where(lost[..., None, None], np.eye(count), inside)
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
    if lost.any():
        solved = np.where(lost[..., None, None], np.nan, solved)  # does not exist
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
    """Integrate the first `count` variables x out of rows with exact relations C_x x + C_s s = c.

    `matrix` is A (..., k, n) and `right` r (..., k, N); `exact` is [C_x C_s] (..., m, n) and
    `exact_right` c (..., m, N). C_x has the singular value decomposition U S Vᵀ; V₁ are the columns
    of V with a nonzero singular value, U₂ those of U without one. The relations determine x by s
    along V₁; along all other directions x is integrated out of the rows by a QR factorisation. The
    relations that remain without any x, U₂ᵀ (C_s s − c) = 0, are those of the factor over s that is
    left.
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
    """Exact relations C x = c as orthonormal rows, none of them implied by the remaining ones.

    `exact` is C (..., m, n), `right` c (..., m, N), and `size` (..., N) the size of the numbers
    that c is computed from. A relation that others imply is left out. Returns

    - the new C, (..., k, n) with k = min(m, n); rows not needed are zero;
    - the new c, (..., k, N), zero in the same rows;
    - the sum of the logarithms of the singular values that C and c were divided by, (...);
    - the mask (..., N) of contradictions: right sides for which a relation that was left out is
      wrong by more than 10⁻⁷ `size`;
    - the largest, over the whole stack, of 1 and the reciprocals of the singular values divided by;
      infinite if a relation left out may yet be independent of the others.
    """
    independent, solved, left, log_size, doubt = _solved(exact, right)
    far = np.abs(left).max(axis=-2, initial=0.0)
    if not (far <= ROUNDING * size).all():
        doubt = np.inf
    return independent, solved, log_size, far > CONTRADICTION * size, doubt


def _solved(matrix: Array, right: Array) -> tuple[Array, Array, Array, Array, float]:
    """The equations A x = B, (..., m, n) and (..., m, N), solved by the decomposition A = U S Vᵀ.

    S₁ are the k = min(m, n) singular values less those that are rounding, U₁ and V₁ the columns of
    U and V that belong to S₁, and U₂ the other columns of U. The equations are then equal to
    V₁ᵀ x = S₁⁻¹ U₁ᵀ B and 0 = U₂ᵀ B. Returns

    - V₁ᵀ, (..., k, n), with a row of zeros for each singular value that is rounding;
    - S₁⁻¹ U₁ᵀ B, (..., k, N), zero in the same rows;
    - U₂ᵀ B, (..., m, N), with rows of zeros in the places of U₁;
    - the sum of the logarithms of S₁, (...);
    - the number max(1, 1 / the least of S₁), over the whole stack; infinite if a singular value
      taken for rounding may be more.
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
    """The U (..., m, m), diagonal of S and Vᵀ (..., n, n) of A = U S Vᵀ; NaN if A is not finite.

    A (..., m, n) may have no rows or no columns.
    """
    if matrix.size:
        try:
            return np.linalg.svd(matrix, full_matrices=True)
        except np.linalg.LinAlgError:  # NaN or infinity, of which nothing is known
            lost = np.linalg.svd(np.zeros_like(matrix), full_matrices=True)
            return lost[0] * np.nan, lost[1] * np.nan, lost[2] * np.nan
    lead, (rows, columns) = matrix.shape[:-2], matrix.shape[-2:]
    left = np.broadcast_to(np.eye(rows), (*lead, rows, rows))
    return left, np.zeros((*lead, 0)), np.broadcast_to(np.eye(columns), (*lead, columns, columns))
