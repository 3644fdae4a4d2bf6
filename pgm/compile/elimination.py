"""Eliminating the vertices of a graph one after the other.

Vertices are whole numbers, and a graph is a list of sets of neighbours. Eliminating a vertex joins
its neighbours to each other; the edges that this adds are its *fill*.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush

from pgm.networks import BayesianNetwork

Adjacency = Sequence[set[int]]


def moral(network: BayesianNetwork) -> list[set[int]]:
    """The moral graph: every family is a clique; vertices are places in `network.variables`."""
    adjacent: list[set[int]] = [set() for _ in network.variables]
    for family in network._families:
        for vertex in family:
            adjacent[vertex].update(family)
    for vertex, near in enumerate(adjacent):
        near.discard(vertex)
    return adjacent


class Filling:
    """A graph under elimination: the fill of v is Σ w_a w_b over unjoined pairs of neighbours."""

    def __init__(self, adjacent: Adjacency, weights: Sequence[int]) -> None:
        self.adjacent = [set(near) for near in adjacent]
        self.weights = weights
        self._weight: Callable[[Collection[int]], int] = len if set(weights) == {1} else self._sum
        self._around = [self._weight(near) for near in adjacent]
        # Vertices of one closed neighbourhood have one fill: a family of a thousand costs little.
        known: dict[frozenset[int], int] = {}
        self.fill: list[int] = []
        for vertex, near in enumerate(adjacent):
            if len(near) < 2:
                self.fill.append(0)
                continue
            closed = frozenset((vertex, *near))
            if closed not in known:
                known[closed] = self._apart(closed)
            self.fill.append(known[closed])

    def copy(self) -> Filling:
        """A copy, to be eliminated while this one stays as it is."""
        twin = Filling.__new__(Filling)
        twin.adjacent, twin.weights = [set(near) for near in self.adjacent], self.weights
        twin._weight = len if self._weight is len else twin._sum
        twin._around, twin.fill = list(self._around), list(self.fill)
        return twin

    def _sum(self, vertices: Iterable[int]) -> int:
        return sum(map(self.weights.__getitem__, vertices))

    def _apart(self, vertices: frozenset[int]) -> int:
        """Σ w_a w_b over the pairs that are not joined."""
        total = self._weight(vertices)
        twice = 0
        for vertex in vertices:
            joined = vertices & self.adjacent[vertex]
            if len(joined) < len(vertices) - 1:
                weight = self.weights[vertex]
                twice += weight * (total - weight - self._weight(joined))
        return twice // 2

    def eliminate(self, vertex: int) -> set[int]:
        """Join a vertex's neighbours and remove it: the vertices whose fill may have changed."""
        near, weights = self.adjacent[vertex], self.weights
        touched = set(near)
        if self.fill[vertex]:
            for a in near:
                for b in near - self.adjacent[a]:
                    if a != b:
                        touched |= self._join(a, b)
        total = self._around[vertex]
        for a in near:
            # The pairs of the vertex with those neighbours of a that it was not joined to.
            beyond = self._around[a] - weights[vertex] - (total - weights[a])
            self.fill[a] -= weights[vertex] * beyond
            self._around[a] -= weights[vertex]
            self.adjacent[a].discard(vertex)
        self.adjacent[vertex] = set()
        touched.discard(vertex)
        return touched

    def _join(self, a: int, b: int) -> set[int]:
        """Add an edge: the vertices whose fill it changes."""
        adjacent, weights, fill = self.adjacent, self.weights, self.fill
        common = adjacent[a] & adjacent[b]
        pair = weights[a] * weights[b]
        for vertex in common:
            fill[vertex] -= pair
        shared = self._weight(common)
        for end, other in ((a, b), (b, a)):
            fill[end] += weights[other] * (self._around[end] - shared)
            self._around[end] += weights[other]
            adjacent[end].add(other)
        return common


def min_fill(
    adjacent: Adjacency, weights: Sequence[int], stages: Sequence[int] | None = None
) -> list[int]:
    """Eliminate a vertex of least fill, by stages, the first of equals, until none is left."""
    return list(fill_order(Filling(adjacent, weights), stages or [0] * len(adjacent)))


def fill_order(
    graph: Filling, stages: Sequence[int], noise: Sequence[float] | None = None
) -> Iterator[int]:
    """Vertices in the order of `min_fill`, each while its neighbours are there; uses up the graph.

    `noise` are factors of the vertices' fills.
    """
    factors: Sequence[float] = noise or [1] * len(graph.fill)
    queued = list(graph.fill)
    # Entries that a change of fill made out of date stay until they come up.
    heap = [
        (stages[vertex], fill * factors[vertex], vertex, fill) for vertex, fill in enumerate(queued)
    ]
    heapify(heap)
    left = [True] * len(queued)
    while heap:
        _, _, vertex, fill = heappop(heap)
        if not left[vertex] or fill != graph.fill[vertex]:
            continue
        left[vertex] = False
        yield vertex
        for other in graph.eliminate(vertex):
            fill = graph.fill[other]
            if fill != queued[other]:
                queued[other] = fill
                heappush(heap, (stages[other], fill * factors[other], other, fill))


@dataclass(frozen=True)
class CliqueTree:
    """The maximal cliques, by their first elimination, joined by sepsets to a tree, or several."""

    cliques: list[set[int]]
    sepsets: dict[tuple[int, int], set[int]]


def clique_tree(adjacent: Adjacency, order: Sequence[int]) -> CliqueTree:
    """The clique tree of an elimination order, in time linear in its cliques' sizes.

    The clique of a vertex is the vertex with its *later* neighbours in the filled graph; it hangs
    on the clique of the first of these. One that lies inside a clique hanging on it is that one.

    Source: Blair and Peyton (1993), An introduction to chordal graphs and clique trees.
    """
    position = [0] * len(order)
    for k, vertex in enumerate(order):
        position[vertex] = k
    later = [
        {other for other in near if position[other] > position[vertex]}
        for vertex, near in enumerate(adjacent)
    ]
    hanging: list[list[int]] = [[] for _ in order]
    home = [0] * len(order)
    tree = CliqueTree([], {})
    for vertex in order:
        reach = later[vertex]
        own = -1
        for child in hanging[vertex]:
            if len(later[child]) == len(reach) + 1:
                own = home[child]
                break
        if own < 0:
            own = len(tree.cliques)
            tree.cliques.append({vertex, *reach})
        home[vertex] = own
        for child in hanging[vertex]:
            other = home[child]
            if other != own:
                tree.sepsets[(other, own) if other < own else (own, other)] = later[child]
        if reach:
            parent = min(reach, key=position.__getitem__)
            hanging[parent].append(vertex)
            later[parent] |= reach
            later[parent].discard(parent)
    return tree
