"""A parallel prefix scan over segments of a chain, in 2 log₂ T rounds, each one batched call.

A segment maps the value at its left end, such as a belief, to the value at its right end; two
neighbours *compose* to one segment. Up a balanced tree neighbours are composed; down again, on each
level, the values at left ends are pushed through every second segment (Blelloch, 1990).

Segments and values are named tuples of stacks (T, R, ...) of T steps and R runs; a member is None
if it is not wanted.
In memory the axes of components come first, so that each component is a row of steps and runs,
along which kernels go.
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

# Steps times runs that a kernel works on at once: their arrays stay in the processor's cache.
_CHUNK = 3072


def by_rows(array: Array, *, copy: bool = False) -> Array:
    """A stack (T, R, ...) with each component a row of steps and runs in memory.

    The array itself is returned if it is already laid out in this way and `copy` is false; else a
    copy is.
    """
    axes = array.ndim
    along, across = array.strides[:2]
    item = array.itemsize
    if not copy and along == item * array.shape[1] and (across == item or array.shape[1] == 1):
        return array
    memory = np.array(array.transpose(*range(2, axes), 0, 1), order="C")
    return memory.transpose(axes - 2, axes - 1, *range(axes - 2))


def gather(array: Array, steps: Integers) -> Array:
    """A copy (k, R, ...) of the steps of a stack (T, R, ...) at the indices `steps` (k,).

    It has components first in memory.
    """
    axes = array.ndim
    memory = array.transpose(*range(2, axes), 0, 1).take(steps, axis=axes - 2)
    return memory.transpose(axes - 2, axes - 1, *range(axes - 2))


def take(parts: Segments, steps: slice) -> Segments:
    """The named tuple of stacks cut to some steps; None stays None."""
    return _made(parts, [None if part is None else part[steps] for part in parts])  # type: ignore[no-any-return]


def in_chunks(kernel: Callable[..., Any], *stacks: Any) -> Any:
    """Results of a kernel for named tuples of stacks, computed a chunk of steps at a time.

    A chunk is so short that its arrays stay in the processor's cache. `stacks` are named tuples of
    the same steps and runs; `kernel` takes them all, cut to a chunk, and returns one named tuple.
    The result is such a tuple for all steps. The first member of the first of `stacks` must not be
    None: its shape gives the numbers of steps and runs.
    """
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
    """Up the tree: row k of level l is the composition of the segments k 2ˡ to (k + 1) 2ˡ − 1.

    ``compose(first, then)`` composes stacks of left and of right neighbours. Returns the levels,
    from 0, which is `segments`, up to one of a single row; a segment without a right neighbour, at
    the end of a level, is in no level above.
    """
    tree = [segments]
    while (pairs := tree[-1][0].shape[0] // 2) > 0:
        first = take(tree[-1], slice(0, 2 * pairs, 2))
        tree.append(in_chunks(compose, first, take(tree[-1], slice(1, None, 2))))
    return tree


def prefixes(
    start: Beliefs, tree: Sequence[Segments], push: Callable[[Beliefs, Segments], Beliefs]
) -> Beliefs:
    """Down the tree of compositions: the values at the right ends of all segments, (T, R, ...).

    `tree` has the levels of the tree, from the T segments themselves up to a single row. `start`
    (1, R, ...) is the value at the left end of the first segment. From values at the left ends of
    segments, ``push(values, segments)`` gives the values at their right ends.
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
    """A named tuple of stacks cut to some steps, each component a row in memory.

    What is None stays None.
    """
    return _made(parts, [None if part is None else by_rows(part[steps]) for part in parts])


def _merge(first: Any, second: Any, steps: int, here: slice, there: slice) -> Any:
    """Two named tuples of stacks as one of `steps` steps: `first` at `here`, `second` at `there`.

    `here` and `there` are slices of the steps. A member that is None in either tuple is None.
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
    """The parts as a named tuple of the class of `like`."""
    return type(like)(*parts)
