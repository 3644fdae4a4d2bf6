"""Numbers of twice the digits of float64.

A `Twofold` is the unevaluated sum of two float64, of some 32 digits; one operation is some ten to
forty of NumPy's (Dekker, 1971; Joldes, Muller & Popescu, 2017).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from pgm.kernels.arrays import Array, Integers, Mask

# 2²⁷ + 1 cuts a number into two halves of 26 bits.
_CUT = 134217729.0
# Terms of ln((1 + s)/(1 − s)) up to which |s| < .18 leaves 32 digits.
_LAST_TERM = 22


class Twofold:
    """An array of numbers hi + lo, with |lo| at most half a unit in the last place of hi.

    `hi` and `lo` are of one shape; `lo` is zero if None. Operands may be float64. In its last two
    axes the array is a stack of matrices, with the operations of `numbers.Matrix` that sums and
    products of covariances need.
    """

    __array_ufunc__ = None  # so that an array leaves the operation to this class
    __slots__ = ("hi", "lo")

    def __init__(self, hi: Array, lo: Array | None = None) -> None:
        self.hi = hi
        self.lo = np.zeros_like(hi) if lo is None else lo

    @classmethod
    def zeros(cls, shape: tuple[int, ...]) -> Twofold:
        """An array of zeros of this shape."""
        return cls(np.zeros(shape), np.zeros(shape))

    @property
    def shape(self) -> tuple[int, ...]:
        """The lengths of the axes."""
        return self.hi.shape

    @property
    def T(self) -> Twofold:
        """The transposed matrices."""
        return Twofold(self.hi.swapaxes(-1, -2), self.lo.swapaxes(-1, -2))

    def __getitem__(self, key: Any) -> Twofold:
        return Twofold(self.hi[key], self.lo[key])

    def __setitem__(self, key: Any, value: Twofold | Array | float) -> None:
        value = _twofold(value)
        self.hi[key], self.lo[key] = value.hi, value.lo

    def copy(self) -> Twofold:
        """A copy."""
        return Twofold(self.hi.copy(), self.lo.copy())

    def __neg__(self) -> Twofold:
        return Twofold(-self.hi, -self.lo)

    def __add__(self, other: Twofold | Array | float) -> Twofold:
        other = _twofold(other)
        return Twofold(*_add(self.hi, self.lo, other.hi, other.lo))

    __radd__ = __add__

    def __sub__(self, other: Twofold | Array | float) -> Twofold:
        return self + -_twofold(other)

    def __rsub__(self, other: Array | float) -> Twofold:
        return _twofold(other) + -self

    def __mul__(self, other: Twofold | Array | float) -> Twofold:
        other = _twofold(other)
        return Twofold(*_normal(*_product(self.hi, self.lo, other.hi, other.lo)))

    __rmul__ = __mul__

    def __truediv__(self, other: Twofold | Array | float) -> Twofold:
        other = _twofold(other)
        first = self.hi / other.hi
        rest = self - other * first
        second = rest.hi / other.hi
        third = (rest - other * second).hi / other.hi
        return Twofold(*_normal(first, second)) + third

    def __rtruediv__(self, other: Array | float) -> Twofold:
        return _twofold(other) / self

    def __matmul__(self, other: Twofold | Array) -> Twofold:
        other = _twofold(other)
        a, b = self[..., :, :, None], other[..., None, :, :]
        return Twofold(*_sum(*_product(a.hi, a.lo, b.hi, b.lo)))

    def times(self, other: Twofold) -> Twofold:
        """The products A Bᵀ, of which it is known that they are symmetric: half is computed."""
        i, j, places = _half(self.shape[-2])
        a, b = self[..., i, :, None], other[..., j, :, None]
        half = Twofold(*_sum(*_product(a.hi, a.lo, b.hi, b.lo)))
        return half[..., places, 0]

    def one_minus(self) -> Twofold:
        """The matrices I − A."""
        return np.eye(self.shape[-1]) - self

    def __lt__(self, other: Twofold | Array | float) -> Mask:
        return (self - other).hi < 0.0

    def __gt__(self, other: Twofold | Array | float) -> Mask:
        return (self - other).hi > 0.0

    def __eq__(self, other: object) -> Mask:  # type: ignore[override]
        equal: Mask = (self - _twofold(other)).hi == 0.0
        return equal

    def __ne__(self, other: object) -> Mask:  # type: ignore[override]
        differ: Mask = (self - _twofold(other)).hi != 0.0
        return differ

    __hash__ = None  # type: ignore[assignment]

    def __abs__(self) -> Twofold:
        return where(self.hi < 0.0, -self, self)

    def apply(self, name: str) -> Twofold:
        """The function of this name: sqrt, log, or rint."""
        with np.errstate(all="ignore"):
            return _FUNCTIONS[name](self)

    @staticmethod
    def choose(truth: Mask, a: Twofold | float, b: Twofold | float) -> Twofold:
        """The number a where a truth holds, b elsewhere."""
        return where(truth, a, b)

    def dot(self, other: Twofold) -> Twofold:
        """The inner products (...) of two stacks of vectors (..., n)."""
        product = self * other
        return Twofold(*_sum(product.hi[..., None], product.lo[..., None]))[..., 0]


@lru_cache(maxsize=64)
def _half(size: int) -> tuple[Integers, Integers, Integers]:
    """Rows and columns of the entries below a diagonal and on it, and the places (n, n) of all."""
    i, j = np.tril_indices(size)
    places = np.empty((size, size), dtype=np.int64)
    places[i, j] = places[j, i] = np.arange(len(i))
    return i, j, places


def where(mask: Mask, a: Twofold | float, b: Twofold | float) -> Twofold:
    """The numbers of `a` where the mask is true, those of `b` elsewhere; all three broadcast."""
    a, b = _twofold(a), _twofold(b)
    return Twofold(np.where(mask, a.hi, b.hi), np.where(mask, a.lo, b.lo))


def sqrt(x: Twofold) -> Twofold:
    """√x to 31 digits: that of float64, with one step of Newton's; as NumPy's of special values."""
    near = np.sqrt(x.hi)
    proper = (near > 0.0) & (near < np.inf)
    unit = np.where(proper, near, 1.0)
    rest = (x - Twofold(unit) * unit).hi / (2.0 * unit)
    return where(proper, Twofold(*_normal(unit, rest)), Twofold(near))


def log(x: Twofold) -> Twofold:
    """The natural logarithm ln x to 30 digits; as NumPy's of special values.

    With x = 2ᵏ m it is k ln 2 + 2 (s + s³/3 + s⁵/5 + ...), s = (m − 1) / (m + 1), |s| < .18.
    """
    near = np.log(x.hi)
    proper = (x.hi > 0.0) & (x.hi < np.inf)
    power = np.where(proper, np.rint(np.log2(np.where(proper, x.hi, 1.0))), 0.0)
    half = np.floor(0.5 * power)
    first, second = _power_of_two(-half), _power_of_two(half - power)
    m = Twofold(x.hi * first * second, x.lo * first * second)
    m = where(proper, m, 1.0)
    s = (m - 1.0) / (m + 1.0)
    square, total = s * s, Twofold(np.zeros_like(s.hi))
    for k in range(_LAST_TERM, -1, -1):
        total = total * square + 1.0 / _twofold(2.0 * k + 1.0)
    return where(proper, _LN_2 * power + 2.0 * (s * total), Twofold(near))


def _power_of_two(exponent: Array) -> Array:
    """2ᵏ of whole numbers up to 540 or so, exactly, whatever digits the exponential has."""
    near = np.exp2(exponent)
    cut = (2.0**52 + 1.0) * near
    rounded: Array = cut - (cut - near)
    return rounded


def eye(shape: tuple[int, ...]) -> Twofold:
    """Unit matrices of the shape (..., n, n)."""
    return Twofold(np.broadcast_to(np.eye(shape[-1]), shape).copy())


def _eye_like(matrix: Twofold) -> Twofold:
    """Unit matrices of the shape of others, and of their kind of numbers."""
    found = Twofold(np.zeros_like(matrix.hi))
    for k in range(matrix.shape[-1]):
        found.hi[..., k, k] = 1.0
    return found


def _rint(x: Twofold) -> Twofold:
    """The nearest whole number; of two, the even one."""
    whole = np.rint(x.hi)
    low = np.rint(x.lo)  # of whole numbers beyond 2⁵³
    half = np.abs(x.hi - np.trunc(x.hi)) == 0.5
    nearest = np.where(half & (x.lo != 0.0), np.floor(x.hi) + (x.lo > 0.0), whole)
    return Twofold(nearest) + np.where(nearest == x.hi, low, 0.0)


_FUNCTIONS = {"sqrt": sqrt, "log": log, "rint": _rint}


def eliminated(
    matrix: Array | Twofold, negligible: float, rounding: Array | None = None
) -> tuple[Twofold, Twofold]:
    """The factors U (..., n, n) and D (..., n) of symmetric A = U diag(D) Uᵀ, A = `matrix`.

    U is lower triangular with ones on its diagonal; the D_j are the pivots. A pivot of
    |D_j| ≤ `negligible` · |A_jj| is rounding: it becomes zero, and so do the entries of U below
    U_jj. If `rounding` (..., n) is given, it has bounds ρ_j of the rounding in the entries A_jj,
    and the limit is `negligible` · ρ_j instead. The elimination of each earlier pivot k then adds
    U_jk² ρ_k to ρ_j.
    """
    left = _twofold(matrix).copy()
    size = left.shape[-1]
    diagonal = np.abs(np.einsum("...ii->...i", left.hi)) if rounding is None else rounding.copy()
    unit = _eye_like(left)
    pivots = Twofold(np.zeros_like(left.hi[..., 0]))
    for j in range(size):
        pivot = left[..., j, j]
        proper = np.abs(pivot.hi) > negligible * diagonal[..., j]
        pivots[..., j] = where(proper, pivot, 0.0)
        if j + 1 == size:
            break
        below = left[..., j + 1 :, j]
        divisor = where(proper, pivot, 1.0)
        factor = where(proper[..., None], below / divisor[..., None], 0.0)
        unit[..., j + 1 :, j] = factor
        if rounding is not None:
            diagonal[..., j + 1 :] += factor.hi**2 * diagonal[..., j, None]
        left[..., j + 1 :, j + 1 :] = (
            left[..., j + 1 :, j + 1 :] - factor[..., :, None] * below[..., None, :]
        )
    return unit, pivots


def solve_unit(unit: Twofold, right: Twofold) -> Twofold:
    """The X with U X = B, (..., n, m), for a lower triangular U with ones on its diagonal."""
    solution = right.copy()
    for j in range(1, unit.shape[-1]):
        known = unit[..., j : j + 1, :j] @ solution[..., :j, :]
        solution[..., j, :] = solution[..., j, :] - known[..., 0, :]
    return solution


def solve(unit: Twofold, pivots: Twofold, right: Twofold) -> Twofold:
    """A solution X of U diag(D) Uᵀ X = B, (..., n, m), for a B in the range of U diag(D) Uᵀ.

    U (..., n, n) is unit lower triangular, D = `pivots` (..., n), as `eliminated` gives them. X
    keeps the digits that a product with the inverse, whose entries are larger, would lose.
    """
    solution = _divided(solve_unit(unit, right), pivots)
    upper = unit.T
    for j in range(unit.shape[-1] - 2, -1, -1):
        known = upper[..., j : j + 1, j + 1 :] @ solution[..., j + 1 :, :]
        solution[..., j, :] = solution[..., j, :] - known[..., 0, :]
    return solution


def inverse_unit(unit: Twofold) -> Twofold:
    """The inverse (..., n, n) of a lower triangular U with ones on its diagonal."""
    return solve_unit(unit, _eye_like(unit))


def inverse(unit: Twofold, pivots: Twofold) -> Twofold:
    """A generalised inverse U⁻ᵀ D⁺ U⁻¹ of A = U diag(D) Uᵀ, (..., n, n), exact on A's range.

    U = `unit` (..., n, n) is lower triangular with ones on its diagonal, D is `pivots` (..., n). D⁺
    has the reciprocals of D, and zero where D is zero.
    """
    back = inverse_unit(unit)
    return back.T @ _divided(back, pivots)


def _divided(rows: Twofold, pivots: Twofold) -> Twofold:
    """Rows (..., n, m) over their pivots (..., n); zero where a pivot is zero."""
    known = (pivots.hi != 0.0)[..., None]
    return where(known, rows / where(known, pivots[..., None], 1.0), 0.0)


def _twofold(value: Any) -> Twofold:
    if isinstance(value, Twofold):
        return value
    traced = isinstance(value, np.ndarray) and value.dtype == object
    return Twofold(value if traced else np.asarray(value, dtype=np.float64))


def _normal(high: Array, low: Array) -> tuple[Array, Array]:
    """The sum of two floats as high and low parts that do not overlap, if |high| ≥ |low|."""
    total = high + low
    return total, low - (total - high)


def _exact_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """The rounded sum a + b and its rounding error, exactly (TwoSum; Knuth, 1969)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def _halves(a: Array) -> tuple[Array, Array]:
    """A number as a sum of two of 26 bits each, whose products are exact (Veltkamp, 1968)."""
    cut = _CUT * a
    high = cut - (cut - a)
    return high, a - high


def _product(a: Array, a_low: Array, b: Array, b_low: Array) -> tuple[Array, Array]:
    """The product (a + a_low) (b + b_low), rounded, and its error to first order (Dekker, 1971).

    The error of a b is exact; a_low b_low is below the digits kept.
    """
    product = a * b
    return product, _rounding(a, b, product) + (a * b_low + a_low * b)


def _rounding(a: Array, b: Array, product: Array) -> Array:
    """The error a b − `product`, exactly, of a rounded product."""
    if product.dtype == object:  # processors have an operation for it
        traced: Any = product
        found: Array = traced.fused(a, b)
        return found
    a_head, a_tail = _halves(a)
    b_head, b_tail = _halves(b)
    return ((a_head * b_head - product) + a_head * b_tail + a_tail * b_head) + a_tail * b_tail


def _add(a: Array, a_low: Array, b: Array, b_low: Array) -> tuple[Array, Array]:
    """The sum (a + a_low) + (b + b_low), as high and low parts."""
    total, error = _exact_sum(a, b)
    return _normal(total, error + (a_low + b_low))


def _sum(high: Array, low: Array) -> tuple[Array, Array]:
    """Sums of high + low, (..., k, m), over the last axis but one, as high and low parts (..., m).

    Halves of the axis are added to one another, so that errors grow with log₂ of the number of
    summands.
    """
    while (count := high.shape[-2]) > 1:
        half = count // 2
        first, second = (..., slice(half), slice(None)), (..., slice(half, 2 * half), slice(None))
        parts = [_add(high[first], low[first], high[second], low[second])]
        if count % 2:
            parts.append((high[..., -1:, :], low[..., -1:, :]))
        high, low = (np.concatenate(each, axis=-2) for each in zip(*parts, strict=True))
    if not high.shape[-2]:
        empty = np.zeros((*high.shape[:-2], high.shape[-1]))
        return empty, empty.copy()
    return _normal(high[..., 0, :], low[..., 0, :])


# ln 2, to 32 digits.
_LN_2 = Twofold(np.array(0.6931471805599453), np.array(2.3190468138462996e-17))
