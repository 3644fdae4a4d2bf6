"""The first and last places of long axes: what is shown of many runs and steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

# Rows of which all are shown, and the most that are shown of more.
ALL = 12
# Of two axes: the places at either end of an inner one, and of an outer one.
INNER, OUTER = 2, 1

Place = tuple[int, ...]


def few(count: int, most: int = ALL) -> list[int | None]:
    """The places along one axis, the middle of a long one left out; None stands for it."""
    if count <= most:
        return list(range(count))
    first = (most + 1) // 2
    return [*range(first), None, *range(count - (most - first), count)]


def places(shape: Sequence[int], most: int = ALL) -> list[Place | None]:
    """The places along several axes, those in the middle left out; None stands for them."""
    if math.prod(shape) <= most:
        return list(product(*map(range, shape)))
    if len(shape) == 1:
        return [None if place is None else (place,) for place in few(shape[0], most - 1)]
    rows = [size for size in shape[:-1] if size > 1]
    inner = few(shape[-1], 2 * INNER if rows else most - 1)
    outer: list[Place | None] = [(0,) * (len(shape) - 1)]
    if rows:
        if math.prod(shape[:-1]) > 2 * OUTER:
            outer.append(None)
        outer.append(tuple(size - 1 for size in shape[:-1]))
    found: list[Place | None] = []
    for run in outer:
        if run is None:
            found.append(None)
        else:
            found += [None if step is None else (*run, step) for step in inner]
    return found
