"""Elements: segments of a chain with their evidence, which compose.

The parallel form of a Kalman smoother: a segment from the variables x at its left end to those y at
its right end has the element

    p(y | x, evidence) p(evidence | x) = N(y; F x + b, Σ) exp(−½ xᵀK x + hᵀx + g),

so that a transition has K = 0, a likelihood of x has F = I and Σ = 0, and any Σ, singular or zero,
will do: with Σ = L Lᵀ, (I + ΣK)⁻¹Σ = L (I + LᵀKL)⁻¹ Lᵀ. An indefinite Σ gives NaN; the callers, who
know the names, raise (Särkkä & García-Fernández, 2021, section IV). `prefixes` composes them in
rounds.
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
    """A segment: F x + b + n, n ~ N(0, cov), and its evidence's likelihood; g None if not asked."""

    F: Array
    b: Array
    cov: Array
    K: Array
    h: Array
    g: Array | None = None


class Likelihood(NamedTuple):
    """The function exp(−½ xᵀK x + hᵀx + g): K (..., n, n), h (..., n), g (...) or None."""

    K: Array
    h: Array
    g: Array | None = None


class Belief(NamedTuple):
    """Moments (..., n) and (..., n, n), and the log-weight (...) of the evidence, or None."""

    mean: Array
    cov: Array
    log_weight: Array | None = None


def compose(first: Element, then: Element) -> Element:
    """The element of two segments, the second beginning where the first ends.

    With M = (I + Σ₁K₂)⁻¹: F = F₂MF₁, b = F₂M(b₁ + Σ₁h₂) + b₂, Σ = F₂MΣ₁F₂ᵀ + Σ₂, K = F₁ᵀK₂MF₁ + K₁,
    h = F₁ᵀMᵀ(h₂ − K₂b₁) + h₁. Here MΣ₁ is XᵀX, M is I − XᵀXK₂, and K₂M is MᵀK₂M + GᵀG with G =
    U⁻ᵀXK₂: sums of semidefinite terms, so that sharp evidence after a vague noise costs no digits.
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
    """X = U⁻¹Lᵀ, and U, a root of I + LᵀKL, for a covariance L Lᵀ met by information K."""
    lower = roots.root(cov)
    back = transpose(lower)
    upper = roots.root(multiply(multiply(back, precision), lower) + np.eye(cov.shape[-1]))
    return solving.solve_lower(upper, back), upper


def _gram(a: Array) -> Array:
    """The Gram matrix AᵀA, which is semidefinite whatever rounding does to A."""
    return multiply(transpose(a), a)


def _log_weight(mean: Array, h: Array, rest: Array, white: Array, upper: Array) -> Array:
    """The log-integral of N(x; m, L Lᵀ) exp(−½ xᵀK x + hᵀx), for rest h − K m, and white X rest."""
    level = 0.5 * (inner(h + rest, mean) + inner(white, white))
    return level - 0.5 * solving.log_determinant(upper)


def push(belief: Belief, element: Element) -> Belief:
    """The belief at a segment's right end, from the belief at its left end."""
    known = condition(belief, Likelihood(element.K, element.h, element.g))
    spread = multiply(known.X, transpose(element.F))
    return Belief(
        apply(element.F, known.mean) + element.b, _gram(spread) + element.cov, known.log_weight
    )


class Known(NamedTuple):
    """A belief N(m, P), P = L Lᵀ, after a likelihood: its mean, and its covariance XᵀX.

    U is a root of I + LᵀKL; `white` has the squared length (h − K m)ᵀXᵀX(h − K m); `log_weight` is
    the log-integral of the product, if both factors have one.
    """

    mean: Array
    X: Array
    U: Array
    white: Array
    log_weight: Array | None

    @property
    def moved(self) -> Array:
        """The move of the mean in units of the prior, (..., n), of squared length dᵀP⁺d."""
        return solving.solve_upper(self.U, self.white[..., None])[..., 0]


def condition(belief: Belief, likelihood: Likelihood) -> Known:
    """The belief times a likelihood: P⁺ = (I + PK)⁻¹P, m⁺ = m + P⁺(h − K m)."""
    mean, cov, weight = belief
    precision, h, g = likelihood
    factor, upper = _meet(cov, precision)
    rest = h - apply(precision, mean)
    white = apply(factor, rest)
    total = None
    if weight is not None and g is not None:
        total = weight + g + _log_weight(mean, h, rest, white, upper)
    return Known(mean + apply(transpose(factor), white), factor, upper, white, total)
