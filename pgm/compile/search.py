"""A search for a cheap elimination order, among orders that are drawn."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, cycle, islice, repeat

from pgm.compile.elimination import Adjacency, Filling, clique_tree, fill_order

# The fills of a vertex are multiplied by E**SPREAD, where E is exponential with mean one: so it is
# the next with a probability in proportion to its fill to the power of −1/SPREAD. A narrow spread
# finds a cheaper order in fewer tries, a wide one a still cheaper one in many.
NARROW, WIDE = 0.1, 0.2
# Tries with the narrow spread, before those with the wide one.
FEW = 12
# Table entries of the cheapest order, for each try and vertex that is left to choose. The search
# then takes about as long as two first passes of messages over the tables.
ENTRIES = 300
# Vertices of a network, above which there are fewer tries, so that all of them take no longer.
VERTICES = 160
# Table entries that no search brings down to what fits in memory.
HOPELESS = 2**33


def cheapest(adjacent: Adjacency, sizes: Sequence[int], tries: int, seed: int) -> list[int]:
    """The order of min-fill, or one that was drawn and whose cliques have fewer entries.

    Vertices without fill are eliminated first in all of them: that joins nothing. What is left is
    drawn. There is a try for each `ENTRIES` entries and vertex left of the cheapest order so far,
    but no more than `tries`, of large networks fewer, and none without hope.

    """
    graph = Filling(adjacent, [1] * len(sizes))
    order: list[int] = []
    core: Core | None = None
    for vertex in fill_order(graph, [0] * len(sizes)):
        if core is None and graph.fill[vertex]:
            core = Core.of(graph, order, sizes)
        order.append(vertex)
    if core is None:
        return order
    least = _entries(adjacent, order, sizes)
    if least > HOPELESS:
        return order
    bound = core.entries(order)
    searched = Search(core, random.Random(seed))
    tries = min(tries, tries * VERTICES // len(sizes))
    for count, draw in enumerate(islice(searched.tries(), tries)):
        if (count + 1) * ENTRIES * len(core.vertices) > least:
            break
        found = draw(bound)
        if found and (entries := _entries(adjacent, found, sizes)) < least:
            order, least, bound = found, entries, core.entries(found)
    return order


@dataclass(frozen=True, eq=False)
class Core:
    """What is left of a graph when vertices without fill have been eliminated, by places in it."""

    before: list[int]
    vertices: list[int]
    adjacent: list[set[int]]
    sizes: list[int]

    @classmethod
    def of(cls, graph: Filling, before: Sequence[int], sizes: Sequence[int]) -> Core:
        """The vertices that a graph has left."""
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
        """Tries, each to be called with a bound: first those that need no chance."""
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
        entries = 0
        # The vertices eliminated so far that each was joined to, and with how many others.
        joined: list[list[int]] = [[] for _ in sizes]
        reach: list[int] = [0] * len(sizes)
        for vertex in fill_order(graph, [0] * len(sizes), noise):
            near = graph.adjacent[vertex]
            reach[vertex] = len(near)
            # A clique is maximal but where it is all that an earlier one has left.
            maximal = True
            for child in joined[vertex]:
                if reach[child] == len(near) + 1:
                    maximal = False
                reach[child] = 0
            if maximal:
                entries += math.prod(map(sizes.__getitem__, near)) * sizes[vertex]
                if entries > bound:
                    return []
            for other in near:
                joined[other].append(vertex)
            order.append(vertex)
        return core.whole(order)


def _entries(adjacent: Adjacency, order: Sequence[int], sizes: Sequence[int]) -> int:
    cliques = clique_tree(adjacent, order).cliques
    return sum(math.prod(map(sizes.__getitem__, clique)) for clique in cliques)
