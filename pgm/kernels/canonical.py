"""The canonical form C(x; K, h, g) = exp(−½ xᵀK x + hᵀx + g) of a Gaussian factor, on arrays.

K (..., n, n), called `precision`, is symmetric and need not be definite; h is (..., n), g (...); a
`Canonical` is the tuple (K, h, g). Where a result does not exist (an integral that diverges, an
inverse of a singular matrix) it is NaN; the callers, who know the names of variables, raise.

The *pivots* of a matrix A = L Lᵀ are the squares L_jj² of its lower triangular root. A pivot of at
most 10⁻¹³ A_jj is rounding and counts as zero, and so does its column of L: component j is then
*determined* by those before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pgm.kernels import roots, solving
from pgm.kernels.arrays import (
    LOG_2PI,
    Array,
    Index,
    Integers,
    Mask,
    apply,
    block,
    inner,
    sandwich,
    symmetric,
    transpose,
)

Canonical = tuple[Array, Array, Array]
# Of forms that are flat along directions: information along one, in units in which each component's
# own is one, that is none, and the part in such a direction of a component that has moments.
FLAT, LOOSE = 1e-10, 1e-6


def strict_root(matrix: Array) -> Array:
    """The lower triangular roots L, A = L Lᵀ, of matrices A = `matrix` (..., n, n).

    They are NaN where A is not positive definite.
    """
    lower = roots.root(matrix)
    singular: Mask = np.asarray(roots.determined(lower).any(axis=-1))
    if singular.any():
        lower = np.where(singular[..., None, None], np.nan, lower)
    return lower


def _invertible_root(cov: Array) -> Array:
    """The lower triangular L with L Lᵀ = `cov` (..., n, n); NaN where it is singular or indefinite.

    A covariance counts as singular where a pivot is rounding, or an eigenvalue of the correlations
    is below 10⁻¹³, which pivots alone can miss.
    """
    lower = strict_root(cov)
    variances = np.diagonal(cov, axis1=-2, axis2=-1)
    std = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    with np.errstate(invalid="ignore"):  # an infinite variance has no root
        scaled = np.where(np.isnan(lower), 0.0, cov / (std[..., None] * std[..., None, :]))
    singular = np.linalg.eigvalsh(scaled)[..., :1] < roots.NEGLIGIBLE
    return np.where(singular[..., None], np.nan, lower)


def _column(vector: Array) -> Array:
    return vector[..., None]


def from_moments(mean: Array, cov: Array, log_weight: Array) -> Canonical:
    """The canonical form K, h, g of exp(log_weight) N(x; mean, cov).

    `mean` is (..., n), `cov` (..., n, n), `log_weight` (...). NaN where `cov` is singular.
    """
    size = mean.shape[-1]
    lower = _invertible_root(cov)
    precision = symmetric(solving.solve(lower, np.broadcast_to(np.eye(size), cov.shape)))
    h = apply(precision, mean)
    white = solving.solve_lower(lower, _column(mean))[..., 0]
    g = log_weight - 0.5 * (inner(white, white) + size * LOG_2PI + solving.log_determinant(lower))
    return precision, h, g


def to_moments(precision: Array, h: Array, g: Array) -> tuple[Array, Array, Array]:
    """The mean K⁻¹h, the covariance K⁻¹ and ln ∫ C(x; K, h, g) dx, (...).

    All three are NaN where K = `precision` is not positive definite.
    """
    size = h.shape[-1]
    lower = strict_root(precision)
    cov = symmetric(solving.solve(lower, np.broadcast_to(np.eye(size), precision.shape)))
    white = solving.solve_lower(lower, _column(h))
    mean = solving.solve_upper(lower, white)[..., 0]
    white = white[..., 0]
    log_integral = g + 0.5 * (size * LOG_2PI - solving.log_determinant(lower) + inner(white, white))
    return mean, cov, log_integral


def marginalise(precision: Array, h: Array, g: Array, keep: Index, drop: Index) -> Canonical:
    """The canonical form over the components `keep`, with the components `drop` integrated out.

    NaN where the block of K at `drop` is not positive definite.
    """
    lower = strict_root(block(precision, drop, drop))
    size = lower.shape[-1]
    white = solving.solve_lower(lower, block(precision, drop, keep))
    white_h = solving.solve_lower(lower, _column(h[..., drop]))
    shift = (transpose(white) @ white_h)[..., 0]
    white_h = white_h[..., 0]
    return (
        symmetric(block(precision, keep, keep) - transpose(white) @ white),
        h[..., keep] - shift,
        g + 0.5 * (size * LOG_2PI - solving.log_determinant(lower) + inner(white_h, white_h)),
    )


def reduce(
    precision: Array, h: Array, g: Array, keep: Index, fixed: Index, value: Array
) -> Canonical:
    """The canonical form over the components `keep`, with the d components `fixed` set to a value.

    `value` is (..., d).
    """
    inside = apply(block(precision, fixed, fixed), value)
    return (
        block(precision, keep, keep),
        h[..., keep] - apply(block(precision, keep, fixed), value),
        g + inner(h[..., fixed], value) - 0.5 * inner(inside, value),
    )


def from_affine(matrix: Array, offset: Array, noise: Array) -> Canonical:
    """The canonical form over the stacked vector (y, x) of N(y; F x + b, Σ).

    F is `matrix` (..., d, n), b `offset` (..., d) and Σ `noise` (..., d, d). NaN where Σ is
    singular.
    """
    size = matrix.shape[-2]
    lower = _invertible_root(noise)
    joint = np.concatenate([np.broadcast_to(np.eye(size), (*matrix.shape[:-1], size)), -matrix], -1)
    white = solving.solve_lower(lower, joint)
    white_offset = solving.solve_lower(lower, _column(offset))
    h = (transpose(white) @ white_offset)[..., 0]
    white_offset = white_offset[..., 0]
    g = -0.5 * (inner(white_offset, white_offset) + size * LOG_2PI + solving.log_determinant(lower))
    return transpose(white) @ white, h, np.broadcast_to(g, h.shape[:-1])


def backward(
    matrix: Array, offset: Array, noise: Array, precision: Array, h: Array, g: Array
) -> Canonical:
    """The canonical form over x of the integral ∫ N(y; F x + b, Σ) C(y; K, h, g) dy.

    F is `matrix` (..., d, n), b `offset` (..., d) and Σ `noise` (..., d, d); y has d components. Σ
    is never inverted and may be singular. For a semidefinite K a root R, K = R Rᵀ, is used, so that
    nothing is subtracted from K: this would cost digits where C(y; K, h, g) is far narrower than
    the noise. An indefinite K is allowed where the integral converges; else the result is NaN.
    """
    root = roots.root(precision)
    if not roots.is_proper(root):
        return _backward_indefinite(matrix, offset, noise, precision, h, g)
    spread = noise @ root
    inside = transpose(root) @ spread
    lower = strict_root(inside + np.eye(inside.shape[-1]))
    rest = h - apply(precision, offset)
    # M⁻¹K = R (I + RᵀΣR)⁻¹ Rᵀ with M = I + KΣ, and for e = R q + r: M⁻¹e = R (I + RᵀΣR)⁻¹ q +
    # (r − R (I + RᵀΣR)⁻¹ RᵀΣ r). What evidence says has no r, and nothing is subtracted.
    white = solving.solve_lower(lower, transpose(root) @ matrix)
    inside_range, outside = _split(root, rest)
    damped = solving.solve(lower, _column(inside_range) - transpose(spread) @ _column(outside))
    solved = outside + (root @ damped)[..., 0]
    log_integral = (
        g
        - 0.5 * solving.log_determinant(lower)
        + inner(h, offset)
        - 0.5 * inner(apply(precision, offset), offset)
        + 0.5 * inner(rest, apply(noise, solved))
    )
    return transpose(white) @ white, apply(transpose(matrix), solved), log_integral


def _split(root: Array, vector: Array) -> tuple[Array, Array]:
    """Split v = `vector` (..., n) into R q, in the range of R, and a rest r; returns q and r.

    Both are (..., n). R = `root` (..., n, n) is lower triangular with a zero column for each
    determined component. At determined components q is zero, and r is v − R q; a difference of at
    most 10⁻⁹ of |v| + |R| |q| is rounding, and becomes zero. At all other components r is zero. A v
    in the range of R has no rest.
    """
    fixed = roots.determined(root)
    found = solving.solve_lower(root, _column(vector))[..., 0]
    q = np.where(fixed, 0.0, found)
    size = np.abs(vector) + apply(np.abs(root), np.abs(q))
    outside = fixed & (np.abs(found) > 1e-9 * size)
    return q, np.where(outside, found, 0.0)


class Squares(NamedTuple):
    """A canonical form as a square, exp(−½ |A x − y|² + slopeᵀx), but for a constant.

    rows, target: A (r, n) and y (r,), r being the rank of K.
    slope: (n,), along directions of no information; zero where h is in the range of K.
    lost: The part of the least information that is kept by which rounding of the entries may have
        changed it.
    """

    rows: Array
    target: Array
    slope: Array
    lost: float


def squares(precision: Array, h: Array) -> Squares | None:
    """The square of one form K (n, n), h (n,); None where K is indefinite.

    Eigenvalues are those of K in units in which its diagonal is one, so that what is known in
    micrometres counts as what is known in kilometres. They are known to n roundings: one within
    8 n of these, or no further above zero than another is below, is zero. Where some are, parts
    that K does not join are taken apart: rounding would bring the h of one, which may be large,
    into the flat directions of another.
    """
    size, diagonal = len(precision), np.diagonal(precision)
    absent = diagonal == 0.0
    if (diagonal < 0.0).any() or precision[absent].any():
        return None
    unit = np.where(absent, 1.0, np.sqrt(diagonal))
    values, axes = np.linalg.eigh(precision / unit[:, None] / unit)
    rounding = size * float(np.finfo(np.float64).eps)
    below = -float(values.min(initial=0.0))
    if below > roots.INDEFINITE:
        return None
    some = values > max(8.0 * rounding, below)
    if not some.all() and len(parts := _joined(precision)) > 1:
        return _side_by_side(precision, h, parts)
    root = np.sqrt(values[some])
    scaled = h / unit
    along = axes[:, ~some]
    slope = along.T @ scaled
    slope[np.abs(slope) <= 100.0 * rounding * (np.abs(along).T @ np.abs(scaled))] = 0.0
    return Squares(
        (axes[:, some] * root).T * unit,
        (axes[:, some].T @ scaled) / root,
        (along @ slope) * unit,
        max(rounding, below) / float(values[some].min(initial=np.inf)),
    )


def _joined(precision: Array) -> list[Integers]:
    """The components of a form in parts, between which K (n, n) has no entries."""
    linked = precision != 0.0
    np.fill_diagonal(linked, True)
    found, left = list[Integers](), np.ones(len(precision), dtype=bool)
    while left.any():
        part = linked[left.argmax()]
        while (wider := linked[part].any(axis=0)).sum() > part.sum():
            part = wider
        found.append(np.flatnonzero(part))
        left &= ~part
    return found


def _side_by_side(precision: Array, h: Array, parts: Sequence[Integers]) -> Squares | None:
    """The square of a form, of those of its parts; None where one is indefinite."""
    rows, target, slope, lost = list[Array](), list[Array](), np.zeros(len(h)), 0.0
    for part in parts:
        own = squares(precision[np.ix_(part, part)], h[part])
        if own is None:
            return None
        wide = np.zeros((len(own.rows), len(h)))
        wide[:, part] = own.rows
        rows.append(wide)
        target.append(own.target)
        slope[part] = own.slope
        lost = max(lost, own.lost)
    return Squares(np.concatenate(rows), np.concatenate(target), slope, lost)


def determined_moments(precision: Array, h: Array) -> tuple[Array, Array, Mask]:
    """The moments of forms K (..., n, n), h (..., n, m) that may be flat along directions.

    Returns means (..., n, m), covariances (..., n, n), and a mask (..., n) of the components that a
    flat direction has a part in, which have no moments: their numbers are as if the flat directions
    were known. Directions are flat as of `squares`, but for 10⁻¹⁰ in place of roundings.
    """
    own = np.diagonal(precision, axis1=-2, axis2=-1)
    unit = np.where(own > 0.0, np.sqrt(own), 1.0)
    values, axes = np.linalg.eigh(precision / unit[..., :, None] / unit[..., None, :])
    flat = values <= FLAT
    loose = (np.where(flat[..., None, :], axes, 0.0) ** 2).sum(axis=-1) > LOOSE**2
    root = axes * np.where(flat, 0.0, 1.0 / np.sqrt(np.where(flat, 1.0, values)))[..., None, :]
    root = root / unit[..., None]
    return root @ (transpose(root) @ h), root @ transpose(root), loose


def _backward_indefinite(
    matrix: Array, offset: Array, noise: Array, precision: Array, h: Array, g: Array
) -> Canonical:
    """The canonical form over x of ∫ N(y; F x + b, Σ) C(y; K, h, g) dy, for an indefinite K.

    F is `matrix` (..., d, n), b `offset` (..., d), Σ `noise` (..., d, d) and K `precision`
    (..., d, d), such as that of a quotient of two messages. K has no root, so that a root L of the
    noise, Σ = L Lᵀ, is used instead. The integral converges where I + LᵀKL is positive definite;
    elsewhere the result is NaN.
    """
    root = roots.root(noise)
    reach = precision @ root
    inside = transpose(root) @ reach
    lower = strict_root(inside + np.eye(inside.shape[-1]))
    rest = h - apply(precision, offset)
    white = solving.solve_lower(lower, transpose(reach))
    white_rest = solving.solve_lower(lower, transpose(root) @ _column(rest))
    solved = rest - (transpose(white) @ white_rest)[..., 0]
    white_rest = white_rest[..., 0]
    log_integral = (
        g
        - 0.5 * solving.log_determinant(lower)
        + inner(h, offset)
        - 0.5 * inner(apply(precision, offset), offset)
        + 0.5 * inner(white_rest, white_rest)
    )
    back = transpose(matrix) @ (precision - transpose(white) @ white) @ matrix
    return symmetric(back), apply(transpose(matrix), solved), log_integral


def product(a: Canonical, b: Canonical) -> Canonical:
    """The product of two canonical forms over the same variables."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def combine(
    mean: Array, cov: Array, precision: Array, h: Array, g: Array
) -> tuple[Array, Array, Array]:
    """The mean, covariance and log-integral (...) of the product N(x; mean, cov) C(x; K, h, g).

    With cov = L Lᵀ, which may be singular, the covariance is L (I + LᵀKL)⁻¹ Lᵀ. All three are NaN
    where I + LᵀKL is not positive definite.
    """
    root = roots.root(cov)
    inside = sandwich(transpose(root), precision)
    lower = strict_root(inside + np.eye(inside.shape[-1]))
    white = solving.solve_lower(lower, transpose(root))
    posterior = transpose(white) @ white
    rest = h - apply(precision, mean)
    shift = apply(posterior, rest)
    log_integral = (
        g
        + inner(h, mean)
        - 0.5 * inner(apply(precision, mean), mean)
        + 0.5 * inner(rest, shift)
        - 0.5 * solving.log_determinant(lower)
    )
    return mean + shift, posterior, log_integral


def shift(precision: Array, h: Array, g: Array, by: Array) -> Canonical:
    """The canonical form over x = y + `by`, from the form K, h, g over y; `by` is (..., n)."""
    moved = apply(precision, by)
    return precision, h + moved, g - inner(h, by) - 0.5 * inner(moved, by)
