"""Elements: segments of a chain with their evidence, which compose.

The parallel form of a Kalman smoother: a segment from the variables x at its left end to those y at
its right end has the element

    p(y | x, evidence) p(evidence | x) = N(y; F x + b, Σ) exp(−½ xᵀK x + hᵀx + g),

so that a transition has K = 0, a likelihood of x has F = I and Σ = 0, and any Σ, singular or zero,
will do: with Σ = L Lᵀ, (I + ΣK)⁻¹Σ = L (I + LᵀKL)⁻¹ Lᵀ (Särkkä & García-Fernández, 2021, section
IV). An indefinite Σ gives NaN; the callers, who know the names of variables, raise. `prefixes`
composes elements in rounds.
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
    """The likelihood exp(−½ xᵀK x + hᵀx + g): K (..., n, n), h (..., n), g (...) or None."""

    K: Array
    h: Array
    g: Array | None = None


class Belief(NamedTuple):
    """A belief N(mean, cov), (..., n) and (..., n, n), times exp(log_weight), (...) or None.

    `log_weight` is ln p(evidence so far); None where it is not wanted.
    """

    mean: Array
    cov: Array
    log_weight: Array | None = None


def compose(first: Element, then: Element) -> Element:
    """The element of two segments as one, the second beginning where the first ends.

    Subscript 1 is for `first`, 2 for `then`. With M = (I + Σ₁K₂)⁻¹ the result is F = F₂MF₁,
    b = F₂M(b₁ + Σ₁h₂) + b₂, Σ = F₂MΣ₁F₂ᵀ + Σ₂, K = F₁ᵀK₂MF₁ + K₁ and h = F₁ᵀMᵀ(h₂ − K₂b₁) + h₁.
    With Σ₁ = L Lᵀ, the lower triangular root U of I + LᵀK₂L = U Uᵀ, and X = U⁻¹Lᵀ, MΣ₁ is XᵀX, M is
    I − XᵀXK₂, and K₂M is MᵀK₂M + GᵀG with G = U⁻ᵀXK₂: sums of semidefinite terms, so that sharp
    evidence after a vague noise costs no digits. g is None if the g of either segment is.
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
    """The matrices X = U⁻¹Lᵀ and U, (..., n, n) both; U is the lower triangular root of I + LᵀKL.

    L is the lower triangular root of a covariance P = `cov`, and K = `precision` the information of
    a likelihood, both (..., n, n); U Uᵀ = I + LᵀKL. The product of N(m, P) and the likelihood has
    the covariance XᵀX = (I + PK)⁻¹P.
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

    m is `mean` and `rest` h − K m, (..., n) as `h`. `upper` is the lower triangular root U of
    I + LᵀKL = U Uᵀ, (..., n, n), and `white` is X (h − K m), (..., n), with X = U⁻¹Lᵀ.
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
    """The product of a belief N(m, P) and a likelihood with K and h: its mean, its covariance XᵀX.

    `mean` is (..., n). With P = L Lᵀ, U is the lower triangular root of I + LᵀKL = U Uᵀ, and X =
    U⁻¹Lᵀ, (..., n, n) both; `white` is X (h − K m), (..., n). `log_weight` (...) is the logarithm
    of the product's integral; None if the belief has no `log_weight` or the likelihood no g.
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

    With P = L Lᵀ, the lower triangular root U of I + LᵀKL, and X = U⁻¹Lᵀ, the product has the
    covariance C = XᵀX = (I + PK)⁻¹P and the mean m + C (h − K m). The result has this mean, X, U,
    the vector X (h − K m), and the logarithm of the product's integral, None if an argument has no
    log-scale.
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
