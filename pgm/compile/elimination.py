"""Eliminating the vertices of a graph one after the other, and searches for cheap orders.

Vertices are whole numbers, and a graph is a list of sets of neighbours. Eliminating a vertex joins
its neighbours to each other; the edges that this adds are its *fill*.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from heapq import heapify, heappop, heappush
from itertools import chain, cycle, islice, repeat

from pgm.networks import MarkovNetwork
from pgm.resources import uncollected

Adjacency = Sequence[set[int]]


def moral(network: MarkovNetwork) -> list[set[int]]:
    """The moral graph: every family is a clique; vertices are places in `network.variables`."""
    families = network._families
    with uncollected(len(families)):
        adjacent: list[set[int]] = [set() for _ in network.variables]
        for family in families:
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
        """A copy of the graph, to be eliminated separately."""
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
    There the later neighbours are the other's, less the vertex: the set is handed on.

    Source: Blair and Peyton (1993), An introduction to chordal graphs and clique trees.
    """
    position = [0] * len(order)
    for k, vertex in enumerate(order):
        position[vertex] = k
    tree = CliqueTree([], {})
    # By the first of their later neighbours: cliques, each with the neighbours that are left of it.
    hanging: dict[int, list[tuple[int, set[int]]]] = {}
    for k, vertex in enumerate(order):
        near = {other for other in adjacent[vertex] if position[other] > k}
        below = hanging.pop(vertex, None)
        if below is None:
            own, reach = len(tree.cliques), near
            tree.cliques.append({vertex, *reach})
        else:
            own, reach = max(below, key=_extent)
            if all(reach.issuperset(other) for _, other in below) and reach.issuperset(near):
                reach.discard(vertex)
            else:
                own, reach = len(tree.cliques), near.union(*[other for _, other in below])
                tree.cliques.append(reach.copy())
                reach.discard(vertex)
            for other, shared in below:
                if other != own:
                    tree.sepsets[(other, own) if other < own else (own, other)] = shared
        if reach:
            parent = order[min([position[other] for other in reach])]
            hanging.setdefault(parent, []).append((own, reach))
    return tree


def _extent(hung: tuple[int, set[int]]) -> int:
    return len(hung[1])


# The fills of a vertex are multiplied by E**SPREAD, where E is exponential with mean one: so it is
# the next with a probability in proportion to its fill to the power of −1/SPREAD. A narrow spread
# finds a cheaper order in fewer tries, a wide one a still cheaper one in many: FEW are narrow.
NARROW, WIDE = 0.1, 0.2
FEW = 12
# Table entries of the cheapest order, for each try and vertex that is left to choose: the search
# takes about as long as two first passes of messages over the tables.
ENTRIES = 300
# Vertices of a network, above which there are fewer tries, so that all of them take no longer.
VERTICES = 160
# Table entries that no search brings down to what fits in memory.
HOPELESS = 2**33


def cheapest(adjacent: Adjacency, sizes: Sequence[int], tries: int, seed: int) -> list[int]:
    """The order of min-fill, or one that was drawn and whose cliques have fewer entries.

    Vertices without fill are eliminated first in all of them: that joins nothing. What is left is
    drawn, with a try for each `ENTRIES` entries and vertex left of the cheapest order so far, but
    no more than `tries`, of large networks fewer, and none without hope.
    """
    graph = Filling(adjacent, [1] * len(sizes))
    order: list[int] = []
    cliques: list[set[int]] = []  # of each vertex, without itself
    core: Core | None = None
    for vertex in fill_order(graph, [0] * len(sizes)):
        if core is None and graph.fill[vertex]:
            core = Core.of(graph, order, sizes)
        order.append(vertex)
        cliques.append(graph.adjacent[vertex])
    if core is None:
        return order
    least, before = MaximalCliques(sizes).of(order, cliques), len(core.before)
    if least > HOPELESS:
        return order
    bound = MaximalCliques(sizes).of(order[before:], cliques[before:])
    searched = Search(core, random.Random(seed))
    tries = min(tries, tries * VERTICES // len(sizes))
    for count, draw in enumerate(islice(searched.tries(), tries)):
        if (count + 1) * ENTRIES * len(core.vertices) > least:
            break
        found = draw(bound)
        if found and (entries := _entries(adjacent, found, sizes)) < least:
            order, least, bound = found, entries, core.entries(found)
    return order


class MaximalCliques:
    """The table entries of the maximal cliques of a graph, as its vertices are eliminated in turn.

    entries: Those of the cliques so far.
    """

    def __init__(self, sizes: Sequence[int]) -> None:
        self.sizes, self.entries = sizes, 0
        # The vertices eliminated so far that each was joined to, and with how many others.
        self._joined: list[list[int]] = [[] for _ in sizes]
        self._reach: list[int] = [0] * len(sizes)

    def of(self, order: Iterable[int], cliques: Iterable[Collection[int]]) -> int:
        """The entries, after vertices in this order, each with its neighbours."""
        for vertex, near in zip(order, cliques, strict=True):
            self.add(vertex, near)
        return self.entries

    def add(self, vertex: int, near: Collection[int]) -> None:
        """Count the clique of a vertex, which is eliminated next, with its neighbours."""
        reach, sizes = self._reach, self.sizes
        count = reach[vertex] = len(near)
        # A clique is maximal but where it is all that an earlier one has left.
        maximal = True
        for child in self._joined[vertex]:
            if reach[child] == count + 1:
                maximal = False
            reach[child] = 0
        if maximal:
            self.entries += math.prod(map(sizes.__getitem__, near)) * sizes[vertex]
        for other in near:
            self._joined[other].append(vertex)


@dataclass(frozen=True, eq=False)
class Core:
    """The rest of a graph when vertices without fill have been eliminated, by places in it."""

    before: list[int]
    vertices: list[int]
    adjacent: list[set[int]]
    sizes: list[int]

    @classmethod
    def of(cls, graph: Filling, before: Sequence[int], sizes: Sequence[int]) -> Core:
        """The vertices that remain of a graph after the first eliminations."""
        vertices = sorted(set(range(len(sizes))).difference(before))
        place = {vertex: k for k, vertex in enumerate(vertices)}
        adjacent = [set(map(place.__getitem__, graph.adjacent[vertex])) for vertex in vertices]
        return cls(list(before), vertices, adjacent, [sizes[vertex] for vertex in vertices])

    def whole(self, order: Iterable[int]) -> list[int]:
        """An order of the core as one of the graph."""
        return [*self.before, *map(self.vertices.__getitem__, order)]

    def entries(self, order: Sequence[int]) -> int:
        """The table entries of the maximal cliques of the core, by an order of the graph."""
        place = {vertex: k for k, vertex in enumerate(self.vertices)}
        own = [place[vertex] for vertex in order[len(self.before) :]]
        return _entries(self.adjacent, own, self.sizes)


class Search:
    """Orders of a core that are drawn, with several weights of its fills in turn."""

    def __init__(self, core: Core, draw: random.Random) -> None:
        self.core, self.random = core, draw
        sizes = core.sizes
        weightings = [[1] * len(sizes)]
        if len(set(sizes)) > 1:
            weightings += [sizes, [round(8 * math.log(size)) for size in sizes]]
        self.weightings = weightings
        self._graphs: dict[int, Filling] = {}

    def tries(self) -> Iterator[Callable[[int], list[int]]]:
        """An endless series of tries: functions of a bound that each draw one elimination order.

        A try returns an order of the whole graph's vertices, empty where the order's cliques in the
        core have more table entries than the bound. The first try, where states differ in number,
        weighs fills by logarithms of them and draws nothing; then a few follow with a little chance
        in the choice of the next vertex, and then without end with more, by all weightings in turn.
        """
        count = len(self.weightings)
        # Weights of sizes tell more than none, where they differ.
        narrow = zip(cycle(reversed(range(min(1, count - 1), count))), repeat(NARROW, FEW))
        wide = zip(cycle(range(count)), repeat(WIDE))
        plain = [(2, 0.0)] if count > 1 else []
        return (partial(self._try, *each) for each in chain(plain, narrow, wide))

    def _try(self, which: int, spread: float, bound: int) -> list[int]:
        """An order of the graph, or none as soon as its cliques have more entries than a bound."""
        core, sizes = self.core, self.core.sizes
        if which not in self._graphs:
            self._graphs[which] = Filling(core.adjacent, self.weightings[which])
        graph = self._graphs[which].copy()
        draw = self.random.expovariate
        noise = [math.pow(draw(1.0), spread) for _ in sizes] if spread else None
        order: list[int] = []
        cliques = MaximalCliques(sizes)
        for vertex in fill_order(graph, [0] * len(sizes), noise):
            cliques.add(vertex, graph.adjacent[vertex])
            if cliques.entries > bound:
                return []
            order.append(vertex)
        return core.whole(order)


def _entries(adjacent: Adjacency, order: Sequence[int], sizes: Sequence[int]) -> int:
    cliques = clique_tree(adjacent, order).cliques
    return sum(math.prod(map(sizes.__getitem__, clique)) for clique in cliques)
