"""Vectors that are never changed: one with other entries shares almost all memory with it.

Entries stand in leaves of 64, which stand in nodes of 64, and so on to one root. A vector with k
other entries has new leaves and nodes on the way to these, k log n of them at the most (Bagwell,
2001, Ideal hash trees; as the vectors of Clojure).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Generic, TypeVar

T = TypeVar("T")

_BITS = 6
_WIDE = 1 << _BITS


class Vector(Generic[T]):
    """A vector of any objects; entries that were never written are None."""

    __slots__ = ("_depth", "_root", "count")

    def __init__(self, count: int = 0, depth: int = 0, root: list[Any] | None = None) -> None:
        self.count, self._depth = count, depth
        self._root: list[Any] = [None] * _WIDE if root is None else root

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> T:
        node = self._root
        for shift in range(self._depth * _BITS, 0, -_BITS):
            node = node[(index >> shift) & (_WIDE - 1)]
        found: T = node[index & (_WIDE - 1)]
        return found

    def get(self, index: int) -> T | None:
        """The entry of an index; None also beyond the end."""
        if index >= self.count:
            return None
        node: Any = self._root
        for shift in range(self._depth * _BITS, 0, -_BITS):
            node = node[(index >> shift) & (_WIDE - 1)]
            if node is None:
                return None
        found: T | None = node[index & (_WIDE - 1)]
        return found

    def some(self, indices: Iterable[int]) -> list[T]:
        """The entries of some indices."""
        if not self._depth:
            return [self._root[index] for index in indices]
        return [self._leaf(index >> _BITS)[index & (_WIDE - 1)] for index in indices]

    def _leaf(self, place: int) -> list[Any]:
        node = self._root
        for shift in range((self._depth - 1) * _BITS, -1, -_BITS):
            node = node[(place >> shift) & (_WIDE - 1)]
        return node

    def __iter__(self) -> Iterator[T]:
        for place in range(-(-self.count // _WIDE)):
            yield from self._leaf(place)[: self.count - place * _WIDE]

    def extended(self, more: Iterable[T]) -> Vector[T]:
        """The vector with more entries at its end."""
        return self.replaced(dict(enumerate(more, self.count)))

    def replaced(self, entries: Mapping[int, T]) -> Vector[T]:
        """The vector with other entries at some indices, or more; it grows to hold them all."""
        if not entries:
            return self
        count = max(self.count, max(entries) + 1)
        depth, root = self._depth, self._root
        while count > _WIDE << (depth * _BITS):
            depth, root = depth + 1, [root] + [None] * (_WIDE - 1)
        below: dict[int, Any] = dict(entries)
        for level in range(depth + 1):
            nodes: dict[int, list[Any]] = {}
            for index, entry in below.items():
                place = index >> _BITS
                node = nodes.get(place)
                if node is None:
                    node = nodes[place] = _copied(root, depth - level, place)
                node[index & (_WIDE - 1)] = entry
            below = dict(nodes)
        return Vector(count, depth, below[0])


def _copied(root: list[Any], height: int, place: int) -> list[Any]:
    """A copy of a node, by the number of nodes above it and its place among those beside it."""
    node: Any = root
    for shift in range((height - 1) * _BITS, -1, -_BITS):
        node = node[(place >> shift) & (_WIDE - 1)]
        if node is None:
            return [None] * _WIDE
    return list(node)
