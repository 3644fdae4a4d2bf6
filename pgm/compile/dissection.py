"""Nested dissection: small sets of vertices that part a graph into halves, and these again."""

from __future__ import annotations

import numpy as np

from pgm.compile.elimination import Adjacency
from pgm.compile.sparse import SparseGraph
from pgm.kernels.arrays import Array, Integers, Mask


def dissect(adjacent: Adjacency, small: int) -> list[int]:
    """The stage at which each vertex is eliminated: minus the number of separators around it.

    Vertices of one stage are those of a part that is not divided further, or of one separator;
    two such sets of one stage are not joined, and stay so.

    Parts of at most `small` vertices are not divided.
    """
    found: list[int] = stages(SparseGraph.of(adjacent), small).tolist()
    return found


def stages(graph: SparseGraph, small: int) -> Integers:
    """The stage of each vertex, (count,); see `dissect`. All parts are divided at once."""
    found = np.zeros(graph.count, dtype=np.intp)
    left, degrees, depth = np.arange(graph.count), graph.degrees, 0
    while left.size:
        found[left] = -depth
        part = graph.components()
        large = (np.bincount(part) > small)[part]
        graph, left, part = graph.part(large), left[large], part[large]
        if left.size:
            part = np.unique(part, return_inverse=True)[1]
            inside = _inside(graph, part, degrees[left])
            graph, left = graph.part(inside), left[inside]
            depth += 1
    return found


def _inside(graph: SparseGraph, part: Integers, degrees: Integers) -> Mask:
    """Which vertices are to be divided further: of no separator, in no part that has none.

    The separator of a part is the smallest level of a breadth-first search that leaves neither side
    more than two thirds, without idle vertices. Where there is none, as around a hub, it is the one
    that leaves the least.
    """
    level = _peripheral(graph, part, degrees)
    far = _furthest(part, level)
    # The levels of all parts, one after the other.
    first = np.concatenate([[0], np.cumsum(far + 1)])
    key, of = first[part] + level, np.repeat(np.arange(far.size), far + 1)
    number = np.arange(of.size) - first[of]
    touching = np.zeros(part.size, dtype=bool)
    touching[graph.tails[level[graph.heads] == level[graph.tails] + 1]] = True
    sizes = np.bincount(key, minlength=of.size)
    before = np.cumsum(sizes) - sizes
    before -= before[first[of]]
    total = np.bincount(part)[of]
    sides = np.maximum(before, total - before - sizes)
    inner = (number > 0) & (number < far[of])
    fair = inner & (3 * sides <= 2 * total)
    width = np.where(fair, np.bincount(key[touching], minlength=of.size), part.size)
    best = np.lexsort((number, sides, width, ~inner, of))[first[:-1]]
    inside: Mask = (far > 1)[part] & ~(touching & (key == best[part]))
    return inside


def _furthest(part: Integers, level: Integers) -> Integers:
    """The last level of each part."""
    found = np.zeros(int(part.max()) + 1, dtype=np.intp)
    np.maximum.at(found, part, level)
    return found


def _peripheral(graph: SparseGraph, part: Integers, degrees: Integers) -> Integers:
    """Breadth-first levels from a pseudo-peripheral vertex of each part."""
    level = graph.levels(_least(part, np.zeros(part.size)))
    while True:
        far = _furthest(part, level)
        ends = _least(part, np.where(level == far[part], degrees, np.inf))
        other = graph.levels(ends)
        further = (_furthest(part, other) > far)[part]
        if not further.any():
            return level
        level = np.where(further, other, level)


def _least(part: Integers, value: Integers | Array) -> Integers:
    """The vertex of least value of each part, the first of equals."""
    order = np.lexsort((value, part))
    found: Integers = order[np.searchsorted(part[order], np.arange(int(part.max()) + 1))]
    return found
