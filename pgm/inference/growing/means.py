"""The means of a tree's cliques, found where they are asked for, or all of them at once.

From a root down, the mean of a clique's pivots is G s + o, s being that of its separators. Where s
has hardly moved since a clique's mean was found last, that mean stays.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from pgm.inference.growing.cliques import Clique
from pgm.inference.growing.tree import Mean, Tree
from pgm.kernels.arrays import Array


class Means:
    """The means of variables, found by the cliques from their own up to the root.

    Separators may have moved by `tolerance`, as one vector, without that a mean is found anew.
    """

    def __init__(self, tree: Tree, tolerance: float) -> None:
        self.tree, self.tolerance = tree, tolerance
        self._found: dict[int, Mean] = {}

    def of(self, variable: int) -> Array:
        """The mean of one variable, (d,)."""
        return self.some([variable])[0]

    def some(self, variables: Sequence[int]) -> list[Array]:
        """The means of variables, (d,) each."""
        pairs = zip(self.tree.points.some(variables), self.distances(variables), strict=True)
        return [point.at + distance for point, distance in pairs]

    def distances(self, variables: Sequence[int]) -> list[Array]:
        """The means of variables, counted from their points, (d,) each."""
        homes = self.tree.homes.some(variables)
        self._find(homes)
        found = []
        for variable, clique in zip(variables, homes, strict=True):
            k = clique.pivots.index(variable)
            begin, *end = clique.first[k : k + 2]
            value = self._found[clique.lead].value
            found.append(value[begin : end[0] if end else len(clique.offset)])
        return found

    def _find(self, cliques: Iterable[Clique]) -> None:
        """Find the means of cliques, and of all above them."""
        tree, found, least = self.tree, self._found, self.tolerance**2
        missing: dict[int, Clique] = {}
        waiting: list[tuple[Clique, Array]] = []
        for clique in cliques:
            lead = clique.lead
            while lead not in found and lead not in missing:
                missing[lead] = clique
                above = tree.parents[lead]
                if above < 0:
                    waiting.append((clique, np.zeros(0)))
                    break
                clique, below, lead = tree.homes[above], clique, above
                if lead in found:
                    at = next(at for child, at in clique.children if child is below)
                    waiting.append((below, found[lead].value.take(at)))
        while waiting:
            clique, known = waiting.pop()
            lead = clique.lead
            mean = found[lead] = _mean(tree.means.get(lead), clique, known, least)
            waiting += [
                (child, mean.value.take(at))
                for child, at in clique.children
                if child.pivots[0] in missing
            ]


def everywhere(tree: Tree, tolerance: float) -> tuple[Tree, dict[int, Array]]:
    """The tree with all means found; and how far variables are from their points, (d,) each.

    These are the variables that are beyond their limits.
    """
    found: dict[int, Mean] = {}
    cliques: list[Clique] = []
    least, join, before = tolerance**2, np.concatenate, tree.means.get
    waiting = [(tree.homes[root], np.zeros(0)) for root in tree.renewed]
    while waiting:
        clique, known = waiting.pop()
        lead = clique.pivots[0]
        last = before(lead)
        mean = _mean(last, clique, known, least)
        if mean is not last:
            found[lead] = mean
            cliques.append(clique)
            waiting += [(child, mean.value.take(at)) for child, at in clique.children]
    tree = replace(tree, means=tree.means.replaced(found), renewed=frozenset())
    if not found:
        return tree, {}
    owns = [mean.value[: len(mean.offset)] for mean in found.values()]
    far = np.abs(join(owns)) > join([clique.limits for clique in cliques])
    moved = dict.fromkeys(join([clique.owners for clique in cliques])[far].tolist())
    return tree, dict(zip(moved, Means(tree, tolerance).distances(list(moved)), strict=True))


def _mean(last: Mean | None, clique: Clique, known: Array, least: float) -> Mean:
    """The mean of a clique by that of its separators; the one found last, where that stands."""
    if last is not None and last.offset is clique.offset:
        away = known - last.value[len(clique.offset) :]
        if away.dot(away) <= least:
            return last
    own = clique.gain.dot(known)
    own += clique.offset
    return Mean(clique.offset, np.concatenate((own, known)))
