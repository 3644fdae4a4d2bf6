"""Elements: segments of a chain with their evidence, which compose.

This is the parallel form of a Kalman smoother (Särkkä & García-Fernández, 2021, section IV). A
segment leads from the variables x at its left end to the variables y at its right end. Its element
is

    p(y | x, evidence) p(evidence | x) = N(y; F x + b, Σ) exp(−½ xᵀK x + hᵀx + g).

A transition without evidence has K = 0 and h = 0; the likelihood of x alone has F = I and Σ = 0.
`prefixes` composes elements in rounds.

The product of a belief N(m, P) and a likelihood exp(−½ xᵀK x + hᵀx) has the covariance
(I + PK)⁻¹P. It is computed as XᵀX from three matrices: L, the lower triangular root of P = L Lᵀ; U,
the Cholesky factor of I + LᵀKL = U Uᵀ, lower triangular too; and X = U⁻¹Lᵀ. P is not inverted, and
may be singular or zero. An indefinite P gives NaN; the callers, who know the names of variables,
raise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.kernels import roots, solving
from pgm.kernels.arrays import (
    Array,
    apply,
    inner,
    multiply,
    symmetric,
    transpose,
)


class Element(NamedTuple):
    """The element of a segment: y = F x + b + e, e ~ N(0, cov), and exp(−½ xᵀK x + hᵀx + g).

    F, cov and K are (..., n, n), b and h (..., n), g (...); g is None where no log-evidence is
    wanted.
    """

    F: Array
    b: Array
    cov: Array
    K: Array
    h: Array
    g: Array | None = None


class Likelihood(NamedTuple):
    """The likelihood exp(−½ xᵀK x + hᵀx + g) of x: K (..., n, n), h (..., n) and g (...).

    g is None where no log-evidence is wanted.
    """

    K: Array
    h: Array
    g: Array | None = None


class Belief(NamedTuple):
    """A belief N(mean, cov) times exp(log_weight): mean (..., n), covariance (..., n, n).

    `log_weight` (...) is ln p(evidence so far); None where it is not wanted.
    """

    mean: Array
    cov: Array
    log_weight: Array | None = None


def compose(first: Element, then: Element) -> Element:
    """The element of two segments as one, the second beginning where the first ends.

    Subscript 1 is for `first`, 2 for `then`; Σ is `cov`. With M = (I + Σ₁K₂)⁻¹ the result has
    F = F₂MF₁, b = F₂M(b₁ + Σ₁h₂) + b₂, Σ = F₂MΣ₁F₂ᵀ + Σ₂, K = F₁ᵀK₂MF₁ + K₁ and
    h = F₁ᵀMᵀ(h₂ − K₂b₁) + h₁. g is None if the g of either segment is.

    M takes no inverse: with the matrices X and U of the module's docstring for P = Σ₁ and K = K₂,
    MΣ₁ = XᵀX, M = I − XᵀXK₂ and K₂M = MᵀK₂M + GᵀG, where G = U⁻ᵀXK₂. Thus the new Σ and K are sums
    of semidefinite terms, which cost no digits even where the evidence of the second segment is far
    sharper than the noise of the first.
    """
    white, upper = _meet(first.cov, then.K)
    reach = multiply(multiply(white, then.K), first.F)
    kept = first.F - multiply(transpose(white), reach)
    gained = solving.solve_upper(upper, reach)
    rest = then.h - apply(then.K, first.b)
    shift = apply(white, rest)
    spread = multiply(white, transpose(then.F))
    g = None
    if first.g is not None and then.g is not None:
        g = first.g + then.g + _log_weight(first.b, then.h, rest, shift, upper)
    return Element(
        multiply(then.F, kept),
        apply(then.F, first.b + apply(transpose(white), shift)) + then.b,
        _gram(spread) + then.cov,
        symmetric(multiply(transpose(kept), multiply(then.K, kept))) + _gram(gained) + first.K,
        apply(transpose(kept), rest) + first.h,
        g,
    )


def _meet(cov: Array, precision: Array) -> tuple[Array, Array]:
    """The module's matrices X = U⁻¹Lᵀ and U, (..., n, n) both, for P = `cov` and K = `precision`.

    P is the covariance (..., n, n) of a belief and K the information matrix (..., n, n) of a
    likelihood; P = L Lᵀ and I + LᵀKL = U Uᵀ.
    """
    lower = roots.root(cov)
    back = transpose(lower)
    upper = roots.root(multiply(multiply(back, precision), lower) + np.eye(cov.shape[-1]))
    return solving.solve_lower(upper, back), upper


def _gram(a: Array) -> Array:
    """The Gram matrices AᵀA, (..., n, n), of A (..., m, n): semidefinite even with A rounded."""
    return multiply(transpose(a), a)


def _log_weight(mean: Array, h: Array, rest: Array, white: Array, upper: Array) -> Array:
    """The log-integral ln ∫ N(x; m, L Lᵀ) exp(−½ xᵀK x + hᵀx) dx, (...).

    `mean` is m, `h` is h, `rest` is h − K m and `white` is X (h − K m), (..., n) each. `upper` is
    the Cholesky factor U (..., n, n) of I + LᵀKL = U Uᵀ, lower triangular; X is U⁻¹Lᵀ.
    """
    level = 0.5 * (inner(h + rest, mean) + inner(white, white))
    return level - 0.5 * solving.log_determinant(upper)


def push(belief: Belief, element: Element) -> Belief:
    """The belief at a segment's right end, from the belief at its left end.

    The segment's evidence, which its `element` has, is taken into account.
    """
    known = condition(belief, Likelihood(element.K, element.h, element.g))
    spread = multiply(known.X, transpose(element.F))
    return Belief(
        apply(element.F, known.mean) + element.b, _gram(spread) + element.cov, known.log_weight
    )


class Known(NamedTuple):
    """The product of a belief N(m, P) and a likelihood exp(−½ xᵀK x + hᵀx + g) of x.

    mean: The mean of the product, (..., n).
    X: The matrix U⁻¹Lᵀ, (..., n, n), P being L Lᵀ; the covariance of the product is XᵀX.
    U: The lower triangular Cholesky factor of I + LᵀKL = U Uᵀ, (..., n, n).
    white: The vector X (h − K m), (..., n); its product with Xᵀ is the move from m to `mean`.
    log_weight: The logarithm of the product's integral, (...); None if the belief has no
        `log_weight` or the likelihood no g.
    """

    mean: Array
    X: Array
    U: Array
    white: Array
    log_weight: Array | None

    @property
    def moved(self) -> Array:
        """The w with L w = d, (..., n), for the move d of the mean from m to that of the product.

        Its squared length is dᵀP⁺d, P⁺ being the pseudo-inverse of P.
        """
        return solving.solve_upper(self.U, self.white[..., None])[..., 0]


def condition(belief: Belief, likelihood: Likelihood) -> Known:
    """The product of a belief N(m, P) and a likelihood exp(−½ xᵀK x + hᵀx + g).

    The product has the covariance C = XᵀX = (I + PK)⁻¹P and the mean m + C (h − K m). The result
    has this mean; the matrices X and U, defined by P = L Lᵀ, I + LᵀKL = U Uᵀ and X = U⁻¹Lᵀ; the
    vector X (h − K m); and the logarithm of the product's integral, or None if the belief or the
    likelihood has no log-scale.
    """
    mean, cov, weight = belief
    precision, h, g = likelihood
    factor, upper = _meet(cov, precision)
    rest = h - apply(precision, mean)
    white = apply(factor, rest)
    total = None
    if weight is not None and g is not None:
        total = weight + g + _log_weight(mean, h, rest, white, upper)
    return Known(mean + apply(transpose(factor), white), factor, upper, white, total)
