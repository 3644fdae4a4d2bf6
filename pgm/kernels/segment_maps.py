"""Segments of a chain without evidence, which compose: affine conditionals, and affine maps.

A segment leads from the variables at its left end to the variables at its right end; `prefixes`
composes many segments. An affine conditional maps the moments at the left end to those at the right
end (`compose_conditionals`, `push_moments`), an affine map does so for vectors (`after`, `send`).
"""

from __future__ import annotations

from typing import NamedTuple

from pgm.kernels import moments
from pgm.kernels.arrays import Array, apply, multiply
from pgm.kernels.moments import Conditional


class Moments(NamedTuple):
    """The mean (..., n) and covariance (..., n, n) of a belief."""

    mean: Array
    cov: Array


def compose_conditionals(first: Conditional, then: Conditional) -> Conditional:
    """The conditional p(z | x) = ∫ p(y | x) p(z | y) dy; `first` is p(y | x), `then` p(z | y)."""
    mean, cov = moments.push(first.offset, first.cov, then)
    return Conditional(multiply(then.matrix, first.matrix), mean, cov)


def push_moments(belief: Moments, conditional: Conditional) -> Moments:
    """The moments of y = F x + b + e, e ~ N(0, Σ), for an x with the moments `belief`.

    F, b and Σ are the `matrix`, `offset` and `cov` of the conditional p(y | x).
    """
    return Moments(*moments.push(*belief, conditional))


class Map(NamedTuple):
    """The map F x + b: `matrix` F (..., n, n) and `offset` b (..., n)."""

    matrix: Array
    offset: Array


def after(first: Map, then: Map) -> Map:
    """The composition of two maps: `then` applied to the result of `first`."""
    return Map(multiply(then.matrix, first.matrix), apply(then.matrix, first.offset) + then.offset)


class Value(NamedTuple):
    """A vector, (..., n), as the only member of a named tuple, the form that `prefixes` takes."""

    value: Array


def send(value: Value, through: Map) -> Value:
    """The vector F x + b, (..., n), to which the map `through` takes the vector x, `value`."""
    return Value(apply(through.matrix, value.value) + through.offset)
