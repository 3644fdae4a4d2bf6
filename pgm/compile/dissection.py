"""Nested dissection: separators that halve a graph, and its halves, and so on."""

from __future__ import annotations

from collections.abc import Sequence

from pgm.compile.elimination import Adjacency


def dissect(adjacent: Adjacency, small: int) -> list[int]:
    """The stage at which each vertex is eliminated: minus the number of separators around it.

    Vertices of one stage are those of a part that is not divided further, or of one separator;
    two such sets of one stage are not joined, and stay so.

    Parameters
    ----------
    adjacent : sequence of set of int
    small : int
        Parts of at most this many vertices are not divided.

    References
    ----------
    George and Liu (1981), Computer Solution of Large Sparse Positive Definite Systems, section 8.1.
    """
    stages = [0] * len(adjacent)
    parts = [(set(range(len(adjacent))), 0)]
    while parts:
        left, depth = parts.pop()
        for start in sorted(left):
            if start not in left:
                continue
            levels = _peripheral(adjacent, start, left)
            piece = {vertex for level in levels for vertex in level}
            left -= piece
            for vertex in piece:
                stages[vertex] = -depth
            if len(piece) > small and len(levels) > 2:
                parts.append((piece - _separator(adjacent, levels, len(piece)), depth + 1))
    return stages


def _levels(adjacent: Adjacency, start: int, inside: set[int]) -> list[list[int]]:
    """The vertices by their distance from one, breadth first."""
    seen = {start}
    levels = [[start]]
    while levels[-1]:
        following = []
        for vertex in levels[-1]:
            for other in adjacent[vertex]:
                if other in inside and other not in seen:
                    seen.add(other)
                    following.append(other)
        levels.append(following)
    return levels[:-1]


def _peripheral(adjacent: Adjacency, start: int, inside: set[int]) -> list[list[int]]:
    """The levels of a vertex that is about as far from another as any two are."""
    levels = _levels(adjacent, start, inside)
    while True:
        end = min(levels[-1], key=lambda vertex: (len(adjacent[vertex]), vertex))
        further = _levels(adjacent, end, inside)
        if len(further) <= len(levels):
            return levels
        levels = further


def _separator(adjacent: Adjacency, levels: Sequence[list[int]], total: int) -> set[int]:
    """The smallest level that leaves neither side more than two thirds, without idle vertices.

    Where there is none, as around a hub, the one that leaves the least.
    """
    sides = []
    before = 0
    for level in levels:
        sides.append(max(before, total - before - len(level)))
        before += len(level)

    def touching(k: int) -> set[int]:
        """The vertices of a level that are joined to the next."""
        beyond = set(levels[k + 1])
        return {vertex for vertex in levels[k] if not beyond.isdisjoint(adjacent[vertex])}

    inner = range(1, len(levels) - 1)
    fair = {k: touching(k) for k in inner if 3 * sides[k] <= 2 * total}
    if fair:
        return fair[min(fair, key=lambda k: (len(fair[k]), sides[k], k))]
    return touching(min(inner, key=lambda k: (sides[k], k)))
