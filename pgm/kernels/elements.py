"""Segments of a chain, which compose, and their prefixes in 2 log₂ T rounds.

The parallel form of a Kalman smoother: a segment from the variables x at its left end to those y at
its right end has the element

    p(y | x, evidence) p(evidence | x) = N(y; F x + b, Σ) exp(−½ xᵀK x + hᵀx + g),

so that a transition has K = 0, a likelihood of x has F = I and Σ = 0, and any Σ, singular or zero,
will do: with Σ = L Lᵀ, (I + ΣK)⁻¹Σ = L (I + LᵀKL)⁻¹ Lᵀ. An indefinite Σ gives NaN; the callers, who
know the names, raise (Särkkä & García-Fernández, 2021, section IV). Conditionals and maps, without
evidence, compose too.

Up a balanced tree, neighbours are composed; down again, a belief is pushed through every other
segment, each round being one batched call (Blelloch, 1990). Stacks are (T, R, ...), components
first in memory, so that kernels go along rows of steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from pgm.kernels import moments, roots, solving
from pgm.kernels.arrays import (
    Array,
    Integers,
    apply,
    inner,
    multiply,
    room,
    sandwich,
    symmetric,
    transpose,
)
from pgm.kernels.moments import Conditional


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
    return multiply(transpose(a), a)


def _log_weight(mean: Array, h: Array, rest: Array, white: Array, upper: Array) -> Array:
    """The log-integral of N(x; m, L Lᵀ) exp(−½ xᵀK x + hᵀx), for rest h − K m, and white X rest."""
    level = 0.5 * (inner(h + rest, mean) + inner(white, white))
    return level - 0.5 * solving.log_determinant(upper)


def push(belief: Belief, element: Element) -> Belief:
    """The belief at a segment's right end, from that at its left end before its evidence."""
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
        """By how much the mean has moved, in units of P: of squared length dᵀP⁺d, (..., n)."""
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


# Named tuples of stacks, and of None for what is left out.
Segments = TypeVar("Segments", bound=tuple[Any, ...])
Beliefs = TypeVar("Beliefs", bound=tuple[Any, ...])

# Steps times runs that are worked on at once: what stays near the processor.
_CHUNK = 3072


def by_rows(array: Array, *, copy: bool = False) -> Array:
    """A stack with each component a row of steps in memory, copied only where it is not."""
    axes = array.ndim
    along, across = array.strides[:2]
    item = array.itemsize
    if not copy and along == item * array.shape[1] and (across == item or array.shape[1] == 1):
        return array
    memory = np.array(array.transpose(*range(2, axes), 0, 1), order="C")
    return memory.transpose(axes - 2, axes - 1, *range(axes - 2))


def gather(array: Array, steps: Integers) -> Array:
    """Some steps of a stack, in any order, with components first in memory."""
    axes = array.ndim
    memory = array.transpose(*range(2, axes), 0, 1).take(steps, axis=axes - 2)
    return memory.transpose(axes - 2, axes - 1, *range(axes - 2))


def take(parts: Segments, steps: slice) -> Segments:
    """Some steps of all parts."""
    return _made(parts, [None if part is None else part[steps] for part in parts])  # type: ignore[no-any-return]


def in_chunks(kernel: Callable[..., Any], *stacks: Any) -> Any:
    """A kernel of named tuples, a chunk of steps at a time."""
    steps, runs = stacks[0][0].shape[:2]
    size = max(_CHUNK // max(runs, 1), 1)
    if steps <= size:
        return kernel(*(_rows(stack, slice(None)) for stack in stacks))
    out: Any = None
    for first in range(0, steps, size):
        rows = slice(first, first + size)
        result = kernel(*(_rows(stack, rows) for stack in stacks))
        if out is None:
            out = [None if x is None else room((steps, runs), x.shape[2:]) for x in result]
        for kept, new in zip(out, result, strict=True):
            if kept is not None:
                kept[rows] = new
    return _made(result, out)


def levels(segments: Segments, compose: Callable[[Segments, Segments], Segments]) -> list[Segments]:
    """Up the tree: row k of level l is the segment of the steps from k 2ˡ to (k + 1) 2ˡ."""
    tree = [segments]
    while (pairs := tree[-1][0].shape[0] // 2) > 0:
        first = take(tree[-1], slice(0, 2 * pairs, 2))
        tree.append(in_chunks(compose, first, take(tree[-1], slice(1, None, 2))))
    return tree


def prefixes(
    start: Beliefs, tree: Sequence[Segments], push: Callable[[Beliefs, Segments], Beliefs]
) -> Beliefs:
    """Down the tree of `levels`: the beliefs at the right ends of all segments, (T, R, ...).

    `start` (1, R, ...) is that at the left end of the first; `push` takes one across a segment.
    """
    found = in_chunks(push, start, tree[-1])
    for segments in reversed(tree[:-1]):
        steps = segments[0].shape[0]
        pairs = found[0].shape[0]
        # The right ends of odd segments are known: those of pairs.
        before = _merge(start, found, pairs + 1, slice(0, 1), slice(1, None))
        lefts = take(before, slice(0, steps - pairs))
        even = in_chunks(push, lefts, take(segments, slice(0, None, 2)))
        found = _merge(even, found, steps, slice(0, None, 2), slice(1, None, 2))
    return found  # type: ignore[no-any-return]


def _rows(parts: Any, steps: slice) -> Any:
    return _made(parts, [None if part is None else by_rows(part[steps]) for part in parts])


def _merge(first: Any, second: Any, steps: int, here: slice, there: slice) -> Any:
    merged = []
    for a, b in zip(first, second, strict=True):
        both = None
        if a is not None and b is not None:
            both = room((steps, a.shape[1]), a.shape[2:])
            both[here], both[there] = a, b
        merged.append(both)
    return _made(first, merged)


def _made(like: Any, parts: Sequence[Any]) -> Any:
    return type(like)(*parts)


class Moments(NamedTuple):
    """Mean (..., n) and covariance (..., n, n)."""

    mean: Array
    cov: Array


def compose_conditionals(first: Conditional, then: Conditional) -> Conditional:
    """The composition p(z|x) of p(y|x) and p(z|y)."""
    return Conditional(
        multiply(then.matrix, first.matrix),
        apply(then.matrix, first.offset) + then.offset,
        symmetric(sandwich(then.matrix, first.cov) + then.cov),
    )


def push_moments(belief: Moments, conditional: Conditional) -> Moments:
    """Moments of F x + b + n."""
    return Moments(*moments.push(*belief, conditional))


class Map(NamedTuple):
    """The map F x + b."""

    matrix: Array
    offset: Array


def after(first: Map, then: Map) -> Map:
    """The second map of what the first makes."""
    return Map(multiply(then.matrix, first.matrix), apply(then.matrix, first.offset) + then.offset)


class Value(NamedTuple):
    """A vector, (..., n)."""

    value: Array


def send(value: Value, through: Map) -> Value:
    """The map of a vector."""
    return Value(apply(through.matrix, value.value) + through.offset)
