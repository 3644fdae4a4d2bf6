"""Memory in which arrays lie, and how that is divided by runs.

Memory is *by runs* where it consists of blocks, of all runs each: a run's bytes of a block are
side by side, and so far apart from the next run's. A filter's moments are so many blocks of a
float for each run; evidence (runs, T, d) is one block, of T d floats for each run.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy.typing as npt
from numpy.lib.array_utils import byte_bounds

Anything = npt.NDArray[Any]


class ByRuns(NamedTuple):
    """Memory by runs: how many blocks and runs, bytes from a run to the next, and bytes of one."""

    blocks: int
    runs: int
    apart: int
    own: int

    @property
    def pitch(self) -> int:
        """Bytes from a block to the next."""
        return self.runs * self.apart

    def of(self, runs: int) -> ByRuns:
        """The memory of so many runs alone, close together."""
        return self._replace(runs=runs)

    @property
    def width(self) -> int:
        """Bytes of a block, from its first run's first to its last run's last."""
        return (self.runs - 1) * self.apart + self.own

    @property
    def length(self) -> int:
        """Bytes from the first to the last."""
        return (self.blocks - 1) * self.pitch + self.width

    def moved(self, distance: int, runs: int) -> int:
        """A distance in bytes, as it is in blocks of so many runs."""
        blocks, rest = divmod(abs(distance), self.pitch)
        there = blocks * runs * self.apart + rest
        return there if distance >= 0 else -there


class Span(NamedTuple):
    """Memory in which arrays lie: its first address, its bytes, and whether one may be written.

    `by_runs` says how it is divided by runs, None where it is not.
    """

    first: int
    length: int
    written: bool
    by_runs: ByRuns | None = None

    def room(self, runs: int) -> int:
        """The bytes that so many of its runs take."""
        return self.length if self.by_runs is None else self.by_runs.of(runs).length


def spans_of(arrays: Iterable[Anything], runs: int = 1) -> list[Span]:
    """The memory of arrays (rows, runs or 1, ...), in order; those that share some are one span."""
    found: list[Span] = []
    within: list[list[Anything]] = []
    edges = [(*byte_bounds(each), each) for each in arrays]
    for low, high, array in sorted(edges, key=lambda edge: edge[:2]):
        written = bool(array.flags.writeable)
        if found and low < found[-1].first + found[-1].length:
            before = found.pop()
            end = max(before.first + before.length, high)
            found.append(Span(before.first, end - before.first, before.written or written))
            within[-1].append(array)
        else:
            found.append(Span(low, high - low, written))
            within.append([array])
    pairs = zip(found, within, strict=True)
    return [span._replace(by_runs=_by_runs(span.first, own, runs)) for span, own in pairs]


def _by_runs(first: int, arrays: list[Anything], runs: int) -> ByRuns | None:
    """How the memory of arrays is divided by runs; None where no division is that of all."""
    apart = {_apart(array, runs) for array in arrays}
    if len(apart) > 1 or not (step := apart.pop()):
        return None
    pitch, count, own = runs * step, 1, 0
    for array in arrays:
        begin, inside = divmod(byte_bounds(array)[0] - first, pitch)
        inside += array.itemsize
        axes = zip(array.strides, array.shape, strict=True)
        for axis, (distance, length) in enumerate(axes):
            if axis == 1 or length == 1:
                continue
            blocks, rest = divmod(abs(distance), pitch)
            begin, inside = begin + blocks * (length - 1), inside + rest * (length - 1)
            if blocks and rest:
                return None
        if inside > step:
            return None
        count, own = max(count, begin + 1), max(own, inside)
    return ByRuns(count, runs, step, own)


def _apart(array: Anything, runs: int) -> int:
    """Bytes from a run of an array to the next; zero where it is not divided by runs."""
    if runs == 1 or array.ndim < 2 or array.shape[1] != runs or not array.size:
        return 0
    return max(array.strides[1], 0)
