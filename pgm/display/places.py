"""The first and last places of long axes: what is shown of many runs and steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

# Rows of which all are shown, and the most that are shown of more.
ALL = 12
# Rows of the ends of one run: its first and last step, and what is between.
ENDS = 3

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
    *outer, inner = shape
    runs, first = math.prod(outer), (0,) * len(outer)
    if runs == 1:
        return [None if step is None else (*first, step) for step in few(inner, most - 1)]
    # The first and the last run, with both ends of their steps; or of the first alone.
    ends: list[Place | None] = [first, None]
    if most >= 2 * ENDS:
        ends = [first, *[None] * (runs > 2), tuple(size - 1 for size in outer)]
    steps = few(inner, 4 if most >= ALL else 2)
    found: list[Place | None] = []
    for run in ends:
        if run is None:
            found.append(None)
        else:
            found += [None if step is None else (*run, step) for step in steps]
    return found
