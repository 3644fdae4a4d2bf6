"""Searching for a cheap elimination order: greedy choices, with some chance in them."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from itertools import chain, cycle, islice

from pgm.compile.elimination import Adjacency, Filling, clique_tree, fill_order, min_fill

# A fill is multiplied by E**SPREAD, where E is exponential with mean one: so a vertex is the next
# with a probability in proportion to its fill to the power of −1/SPREAD.
SPREAD = 0.2
# Table entries of the cheapest order, for each try and vertex. A pass of messages computes about a
# thousand in the time that a try takes for a vertex: the search takes as long as some thirty.
ENTRIES = 30
# Vertices of a network, above which there are fewer tries, so that all of them take no longer.
VERTICES = 160
# Table entries that no search brings down to what fits in memory.
HOPELESS = 2**33


def cheapest(adjacent: Adjacency, sizes: Sequence[int], tries: int, seed: int) -> list[int]:
    """The order of min-fill, or one that was drawn and whose cliques have fewer entries.

    There is a try for each `ENTRIES` entries and vertex of the cheapest order so far, but no more
    than `tries`, of large networks fewer, and none without hope.

    Parameters
    ----------
    adjacent : sequence of set of int
    sizes : sequence of int
        Numbers of states.
    tries, seed : int
    """
    weightings = [1] * len(sizes), sizes, [round(8 * math.log(size)) for size in sizes]
    draw = random.Random(seed)

    def noise() -> float:
        return math.pow(draw.expovariate(1.0), SPREAD)

    best = min_fill(adjacent, weightings[0])
    least = _entries(adjacent, best, sizes)
    if least > HOPELESS:
        return best
    tries = min(tries, tries * VERTICES // len(sizes))
    plain = ((weights, None) for weights in weightings[1:])
    drawn = ((weights, noise) for weights in cycle(weightings))
    for count, (weights, chance) in enumerate(islice(chain(plain, drawn), tries)):
        if (count + 1) * ENTRIES * len(sizes) > least:
            break
        found = _try(adjacent, sizes, weights, chance, 2 * least)
        if found and (entries := _entries(adjacent, found, sizes)) < least:
            best, least = found, entries
    return best


def _try(
    adjacent: Adjacency,
    sizes: Sequence[int],
    weights: Sequence[int],
    noise: Callable[[], float] | None,
    bound: int,
) -> list[int]:
    """An order, or none as soon as it is seen to be dearer.

    Cliques that lie inside another are counted too, each with at most half the entries of one that
    it lies in: all have twice those of the maximal ones at the most.
    """
    graph = Filling(adjacent, weights)
    order = []
    entries = 0
    for vertex in fill_order(graph, [0] * len(sizes), noise):
        entries += math.prod(map(sizes.__getitem__, (vertex, *graph.adjacent[vertex])))
        if entries > bound:
            return []
        order.append(vertex)
    return order


def _entries(adjacent: Adjacency, order: Sequence[int], sizes: Sequence[int]) -> int:
    """The table entries of the maximal cliques."""
    cliques = clique_tree(adjacent, order).cliques
    return sum(math.prod(map(sizes.__getitem__, clique)) for clique in cliques)
