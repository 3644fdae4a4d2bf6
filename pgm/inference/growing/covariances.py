"""Covariances of the variables of a tree of cliques, found when they are asked for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from pgm.inference.growing.cliques import Clique, columns, spread
from pgm.inference.growing.tree import Tree
from pgm.kernels import dense, step
from pgm.kernels.arrays import Array, Integers


class Covariances:
    """The covariances of a tree's cliques, each found from that of the clique above it.

    With R₁₁ x + R₁₂ s = c and the separators' covariance P: cov(x, s) = G P and cov(x) = R₁₁⁻¹
    R₁₁⁻ᵀ + G P Gᵀ, with the gain G = −R₁₁⁻¹ R₁₂.
    """

    def __init__(self, tree: Tree) -> None:
        self.tree = tree
        self._found: dict[int, Array] = {}
        # By lead, the columns at which the variables of a clique begin.
        self._columns: dict[int, dict[int, range]] = {}

    def of(self, variable: int) -> Array:
        """The covariance of one variable, (d, d)."""
        clique = self.tree.homes[variable]
        places = self._places(clique, [variable])
        found: Array = self._of_clique(clique)[np.ix_(places, places)]
        return found

    def joint(self, variables: Sequence[int]) -> Array:
        """The covariance of several variables, (n, n)."""
        homes = [self.tree.homes[v] for v in variables]
        for clique in homes:
            held = {*clique.pivots, *clique.separators}
            if held.issuperset(variables):
                places = self._places(clique, variables)
                found: Array = self._of_clique(clique)[np.ix_(places, places)]
                return found
        found = self.across(variables, variables)
        return np.asarray(0.5 * (found + found.T))

    def _places(self, clique: Clique, variables: Iterable[int]) -> Integers:
        found = self._columns.get(clique.lead)
        if found is None:
            sizes = {v: self.tree.size(v) for v in (*clique.pivots, *clique.separators)}
            found = self._columns[clique.lead] = columns(clique.pivots, clique.separators, sizes)
        return np.array(spread(variables, found), dtype=np.intp)

    def _of_clique(self, clique: Clique) -> Array:
        tree, path = self.tree, [clique]
        while path[-1].lead not in self._found and tree.parents[path[-1].lead] >= 0:
            path.append(tree.homes[tree.parents[path[-1].lead]])
        for own in reversed(path):
            if own.lead not in self._found:
                self._found[own.lead] = self._made(own)
        return self._found[clique.lead]

    def _made(self, clique: Clique) -> Array:
        from scipy.linalg import solve_triangular  # here, since it is slow to import

        own = len(clique.triangle)
        inverse = solve_triangular(clique.triangle[:, :own], np.eye(own))
        gain = clique.gain
        known = np.zeros((0, 0))
        if clique.separators:
            above = self.tree.homes[self.tree.parents[clique.lead]]
            at = self._places(above, clique.separators)
            known = self._found[above.lead][np.ix_(at, at)]
        parts = dense.Stack(known, True), dense.Stack(gain), dense.Stack(inverse @ inverse.T)
        cross, cov = (each.array for each in step.crossed(*parts))
        return np.block([[cov, cross], [cross.T, known]])

    def across(self, rows: Sequence[int], others: Sequence[int]) -> Array:
        """The covariances of some variables with others, (rows, others), in one pass.

        Columns of the identity go up from the cliques that eliminate the `others` by Rᵀ, and down
        to those that eliminate the `rows` by R.
        """
        from scipy.linalg import solve_triangular  # here, since it is slow to import

        tree, size = self.tree, self.tree.size
        homes = [tree.homes[v] for v in others]
        below, up = tree.upwards(tree.homes[v] for v in rows), tree.upwards(homes)
        path = below | up
        order = _children_first(tree, path)
        total = sum(size(v) for v in others)
        asked, column = {lead: np.zeros((_size(path[lead]), total)) for lead in order}, 0
        for variable, clique in zip(others, homes, strict=True):
            for place in self._places(clique, [variable]).tolist():
                asked[clique.lead][place, column] = 1.0
                column += 1
        for lead in order:
            if lead not in up:  # where all is zero
                continue
            clique, own = path[lead], len(path[lead].triangle)
            white = solve_triangular(clique.triangle[:, :own], asked[lead][:own], trans="T")
            rest = asked[lead][own:] - clique.triangle[:, own:-1].T @ white
            asked[lead][:own] = white
            if clique.separators:
                above = path[tree.parents[lead]]
                asked[above.lead][self._places(above, clique.separators)] += rest
        for lead in reversed(order):
            if lead not in below:  # where nothing is asked for
                continue
            clique, own = path[lead], len(path[lead].triangle)
            if clique.separators:
                above = path[tree.parents[lead]]
                at = self._places(above, clique.separators)
                asked[lead][own:] = asked[above.lead][at]
            known = clique.triangle[:, own:-1] @ asked[lead][own:]
            asked[lead][:own] = solve_triangular(
                clique.triangle[:, :own], asked[lead][:own] - known
            )
        found = [asked[tree.homes[v].lead][self._places(tree.homes[v], [v])] for v in rows]
        return np.concatenate(found)


def _children_first(tree: Tree, path: Mapping[int, Clique]) -> list[int]:
    """The leads of cliques, and all cliques above them, in an order in which they may be solved."""
    depth: dict[int, int] = {}
    for lead in path:
        way = [lead]
        while way[-1] not in depth and tree.parents[way[-1]] >= 0:
            way.append(tree.parents[way[-1]])
        for each in reversed(way):
            depth.setdefault(each, depth.get(tree.parents[each], -1) + 1)
    return sorted(path, key=lambda lead: -depth[lead])


def _size(clique: Clique) -> int:
    return int(clique.triangle.shape[1]) - 1
