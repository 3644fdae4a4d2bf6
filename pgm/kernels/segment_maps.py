"""Segments of a chain without evidence, which compose: conditionals, and linear maps of values."""

from __future__ import annotations

from typing import NamedTuple

from pgm.kernels import moments
from pgm.kernels.arrays import (
    Array,
    apply,
    multiply,
    sandwich,
    symmetric,
)
from pgm.kernels.moments import Conditional


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
    """The composition of two maps: `then` applied to the result of `first`."""
    return Map(multiply(then.matrix, first.matrix), apply(then.matrix, first.offset) + then.offset)


class Value(NamedTuple):
    """A vector, (..., n)."""

    value: Array


def send(value: Value, through: Map) -> Value:
    """The map of a vector."""
    return Value(apply(through.matrix, value.value) + through.offset)
