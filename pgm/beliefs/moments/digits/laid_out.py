"""How beliefs in twice the digits lie in arrays: traced numbers, or rows of a record.

A value of a pass, such as a `Belief`, is a named tuple of arrays and of pairs of them. Machine code
knows it as the list of these arrays, `flat`. What makes an array of a shape is said by the caller.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pgm.beliefs.moments.digits.adjoint_belief import Later
from pgm.beliefs.moments.digits.careful_belief import Belief, Component, Move
from pgm.kernels.arrays import Array
from pgm.kernels.extended import Twofold

# Makes an array of a shape, that of a slice's own axes.
Maker = Callable[[tuple[int, ...]], Array]


def two(make: Maker, *shape: int) -> Twofold:
    """Numbers of twice the digits."""
    return Twofold(make(shape), make(shape))


def belief(make: Maker, size: int, unknown: int) -> Belief:
    """A belief over n = `size` components, of q = `unknown` components of δ."""
    n = size
    return Belief(
        two(make, n, 1 + unknown), two(make, n, n), make((n, n)), make((n, n)), make((n,))
    )


def move(make: Maker, size: int) -> Move:
    """A transition between slices, whose columns, which only a prior has, are left out."""
    n = size
    return Move(two(make, n, n), two(make, n), two(make, n, n), two(make, n, 0))


def component(make: Maker, size: int, unknown: int) -> Component:
    """A scalar measurement that was taken in."""
    n = size
    return Component(
        two(make, n),
        two(make, n, n),
        two(make, 1 + unknown),
        two(make),
        make(()),
        make((n,)),
        make((n,)),
    )


def later(make: Maker, size: int, unknown: int) -> Later:
    """A message of later measurements."""
    n = size
    return Later(two(make, n, 1 + unknown), two(make, n, n), make((n, n)), make((n, n)), make(()))


def flat(value: Any) -> list[Array]:
    """The arrays of a value, in order; none of an empty one."""
    if isinstance(value, Twofold):
        return flat((value.hi, value.lo))
    if isinstance(value, tuple):
        return [array for part in value for array in flat(part)]
    return [value] if value.size else []


def mapped(function: Callable[[Array], Array], value: Any) -> Any:
    """A value with each of its arrays replaced by a function of it."""
    if isinstance(value, Twofold):
        return Twofold(function(value.hi), function(value.lo))
    if isinstance(value, tuple):
        parts = [mapped(function, part) for part in value]
        return type(value)._make(parts) if hasattr(value, "_make") else tuple(parts)
    return function(value)


def piled(values: Sequence[Any], how: Callable[[Sequence[Array]], Array] = np.stack) -> Any:
    """Values of one layout as one: their arrays stacked, or put together in another way."""
    first = values[0]
    if isinstance(first, Twofold):
        return Twofold(how([x.hi for x in values]), how([x.lo for x in values]))
    if isinstance(first, tuple):
        parts = [piled(each, how) for each in zip(*values, strict=True)]
        return type(first)._make(parts) if hasattr(first, "_make") else tuple(parts)
    return how(values)
