"""Prefixes of segments that compose, in 2 log₂ T rounds, each one batched call.

Up a balanced tree, neighbours are composed; down again, a value at the left end is pushed through
every other segment (Blelloch, 1990). Stacks are (T, R, ...), components first in memory, so that
kernels go along rows of steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from pgm.kernels.arrays import (
    Array,
    Integers,
    room,
)

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
    """The steps of a stack at some indices, with components first in memory."""
    axes = array.ndim
    memory = array.transpose(*range(2, axes), 0, 1).take(steps, axis=axes - 2)
    return memory.transpose(axes - 2, axes - 1, *range(axes - 2))


def take(parts: Segments, steps: slice) -> Segments:
    """Some steps of every part of a stack."""
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
    """Some steps of a stack, each component a row of steps in memory; None stays None."""
    return _made(parts, [None if part is None else by_rows(part[steps]) for part in parts])


def _merge(first: Any, second: Any, steps: int, here: slice, there: slice) -> Any:
    """Two stacks as one of so many steps: the first at the places `here`, the second at `there`.

    A part that either leaves out (None) is left out.
    """
    merged = []
    for a, b in zip(first, second, strict=True):
        both = None
        if a is not None and b is not None:
            both = room((steps, a.shape[1]), a.shape[2:])
            both[here], both[there] = a, b
        merged.append(both)
    return _made(first, merged)


def _made(like: Any, parts: Sequence[Any]) -> Any:
    """Parts as a named tuple of the same kind."""
    return type(like)(*parts)
