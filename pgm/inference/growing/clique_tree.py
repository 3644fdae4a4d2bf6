"""The cliques of a growing map as clusters, with their potentials, messages and beliefs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from pgm.boundary import is_whole
from pgm.clustergraph import Cluster
from pgm.display import Shown, Summary, count
from pgm.errors import GraphError
from pgm.factors import CanonicalForm, Gaussian
from pgm.factors.scope import Scope
from pgm.immutable import Immutable
from pgm.inference.growing.added import Contents
from pgm.inference.growing.cliques import Clique, columns, spread
from pgm.inference.growing.covariances import Covariances
from pgm.inference.growing.eliminating import Posed, eliminated
from pgm.inference.growing.means import Means
from pgm.inference.growing.vectors import Vector
from pgm.kernels.arrays import Array
from pgm.variables import Variable

Edge = tuple[int, int]
# Rows [A b], and the columns of a clique that A is over.
Block = tuple[list[int], Array]


class CliqueTree(Shown, Immutable):
    r"""The tree of cliques of a `GrowingMap`, as it was last eliminated.

    A clique's *potential* is the product of the CPDs that were eliminated there, linearised:
    exp(−½ ‖R x − c‖²) of their whitened rows. What it left to the clique above is its message
    upwards; the message downwards is what that clique knows of their sepset without it. Potential
    times messages received is proportional to the belief, at means that lag behind by no more than
    the map's tolerance. Factors have no constants, and no log-evidence comes of them.

    Attributes
    ----------
    clusters : tuple of Cluster
        The cliques, each with its pivots and separators, the observed variables of its CPDs, and
        these CPDs (flat priors say nothing, and are in none). Those that the last addition touched
        come first, and else those nearer to a root; a clique's parent stands before it.
    sepsets : mapping of (int, int) to tuple of Variable
        By parent and child the separators of the child.
    pivots : tuple of tuple of Variable
        The variables that each clique eliminates.
    touched : frozenset of int
        The cliques that the last addition eliminated.
    roots : frozenset of int
        The cliques without a parent.

    Examples
    --------
    >>> a, b, z = pgm.variables("a b z")
    >>> grown = pgm.GrowingMap().add([pgm.GaussianCPD(a, 0, 1), pgm.GaussianCPD(b, 0, 1)])
    >>> grown = grown.add(pgm.LinearGaussianCPD(z, {a: 1.0, b: 1.0}, cov=1.0), {z: 3.0})
    >>> tree = grown.cliques
    >>> [cluster.scope for cluster in tree.clusters], tree.pivots
    ([(a, b, z)], ((a, b),))
    >>> tree.potential(0).gaussian().mean
    array([1., 1.])
    """

    clusters: tuple[Cluster, ...]
    sepsets: Mapping[Edge, Scope]
    pivots: tuple[Scope, ...]
    touched: frozenset[int]
    roots: frozenset[int]
    _cliques: Sequence[Clique]
    _parent: Sequence[int]
    _children: Sequence[Sequence[int]]
    _means: Means
    _covariances: Covariances
    _contents: Contents
    _touched: Scope
    _down: dict[int, Array]

    def __init__(
        self, means: Means, covariances: Covariances, contents: Contents, touched: Scope
    ) -> None:
        tree, named = covariances.tree, contents.variables
        fresh = {tree.homes[contents.numbers[v]].lead for v in touched}
        cliques = _nearest_first({c.lead: c for c in tree.homes}, tree.parents, fresh)
        place = {clique.lead: k for k, clique in enumerate(cliques)}
        parent = [place.get(tree.parents[clique.lead], -1) for clique in cliques]
        children: list[list[int]] = [[] for _ in cliques]
        for k, above in enumerate(parent):
            if above >= 0:
                children[above].append(k)
        self._set(
            clusters=tuple(_cluster(k, clique, contents) for k, clique in enumerate(cliques)),
            sepsets=MappingProxyType(
                {
                    (above, k): tuple(named.some(cliques[k].separators))
                    for k, above in enumerate(parent)
                    if above >= 0
                }
            ),
            pivots=tuple(tuple(named.some(clique.pivots)) for clique in cliques),
            touched=frozenset(place[lead] for lead in fresh),
            roots=frozenset(k for k, above in enumerate(parent) if above < 0),
            _cliques=cliques,
            _parent=parent,
            _children=children,
            _means=means,
            _covariances=covariances,
            _contents=contents,
            _touched=touched,
            _down={},
        )

    def __reduce__(self) -> tuple[Any, ...]:
        # Cliques hold those below them, to any depth.
        return CliqueTree, (self._means, self._covariances, self._contents, self._touched)

    def __len__(self) -> int:
        return len(self.clusters)

    def neighbours(self, cluster: int | Cluster) -> tuple[int, ...]:
        """The numbers of the cliques joined to one, its parent first."""
        k = self._index(cluster)
        above = (self._parent[k],) if self._parent[k] >= 0 else ()
        return (*above, *self._children[k])

    def scope(self, cluster: int | Cluster) -> Scope:
        """The hidden variables of a clique: its pivots, and then its separators."""
        clique = self._cliques[self._index(cluster)]
        return tuple(self._contents.variables.some((*clique.pivots, *clique.separators)))

    def potential(self, cluster: int | Cluster) -> CanonicalForm:
        """The product of a clique's CPDs with their evidence, but for a constant factor."""
        k = self._index(cluster)
        return self._form(self._members(k), self._own(k))

    def message(self, sender: int | Cluster, receiver: int | Cluster) -> CanonicalForm:
        """The message from a clique to one joined to it, but for a constant factor."""
        i, j = self._index(sender), self._index(receiver)
        if self._parent[i] == j:
            rows, child = self._cliques[i].left, i
        elif self._parent[j] == i:
            rows, child = self._downwards(j), j
        else:
            raise GraphError(
                f"cliques {i} and {j} are not joined; {i} is joined to {list(self.neighbours(i))}"
            )
        separators = self._cliques[child].separators
        width = sum(map(self._covariances.tree.size, separators))
        return self._form(separators, [(list(range(width)), rows)])

    def belief(self, cluster: int | Cluster) -> CanonicalForm:
        """The product of a clique's potential and the messages that it received."""
        k = self._index(cluster)
        return self._form(self._members(k), [*self._own(k), *self._received(k, -1)])

    def joint(self, *variables: Variable) -> Gaussian:
        """The map's joint belief in some hidden variables; see `GrowingMap.joint`."""
        numbers = [self._contents.numbers[v] for v in variables]
        mean = np.concatenate(self._means.some(numbers))
        return Gaussian._make(variables, mean, self._covariances.joint(numbers))

    def entered(self) -> Mapping[Variable, Array]:
        """The evidence of the map, (d,) each."""
        return {v: np.atleast_1d(value) for v, value in self._contents.evidence.items()}

    def _index(self, cluster: int | Cluster) -> int:
        found = cluster.index if isinstance(cluster, Cluster) else cluster
        if not is_whole(found) or not 0 <= found < len(self):
            raise GraphError(
                f"there is no clique {cluster!r}; the map has {count(len(self), 'clique')}, "
                "numbered from 0",
                cluster=cluster,
            )
        return int(found)

    def _members(self, k: int) -> tuple[int, ...]:
        return (*self._cliques[k].pivots, *self._cliques[k].separators)

    def _own(self, k: int) -> list[Block]:
        """The rows of a clique's CPDs, over its columns."""
        clique, size = self._cliques[k], self._sizes(k)
        column = columns(clique.pivots, clique.separators, size)
        return [(spread(f.scope, column), rows) for f, rows in clique.factors]

    def _received(self, k: int, but: int) -> list[Block]:
        """The rows of the messages that a clique received, but for one child's."""
        clique, size = self._cliques[k], self._sizes(k)
        column = columns(clique.pivots, clique.separators, size)
        below = [self._cliques[j] for j in self._children[k] if j != but]
        found = [(spread(child.separators, column), child.left) for child in below]
        if clique.separators:
            found.append((spread(clique.separators, column), self._downwards(k)))
        return found

    def _sizes(self, k: int) -> dict[int, int]:
        return {v: self._covariances.tree.size(v) for v in self._members(k)}

    def _downwards(self, k: int) -> Array:
        """The rows over a clique's separators that its parent sends."""
        way = [k]
        while (above := self._parent[way[-1]]) not in self.roots and above not in self._down:
            way.append(above)
        for child in reversed(way):
            if child not in self._down:
                self._down[child] = self._sent(self._parent[child], child)
        return self._down[k]

    def _sent(self, k: int, child: int) -> Array:
        """The rows that a clique leaves of all but one child's, over that one's separators."""
        size, kept = self._sizes(k), self._cliques[child].separators
        column = columns(self._cliques[k].pivots, self._cliques[k].separators, size)
        gone = [v for v in self._members(k) if v not in kept]
        # Variables in the order of a front that eliminates those that the child does not share.
        order = np.argsort(spread([*gone, *kept], column))
        blocks = [
            (order[where].tolist(), rows)
            for where, rows in (*self._own(k), *self._received(k, child))
            if rows.size
        ]
        own, total = sum(size[v] for v in gone), len(order)
        found = eliminated([Posed(own, total, blocks, -1, [])], machine=False)
        assert not isinstance(found, int)  # a clique is determined without what a child shares
        return found[0].left

    def _form(self, numbers: Sequence[int], blocks: Sequence[Block]) -> CanonicalForm:
        """The factor exp(−½ ‖A (x − x̂) − b‖²) of rows [A b] at the points x̂, over x."""
        tree = self._covariances.tree
        point = np.concatenate([tree.points[number].at for number in numbers])
        matrix, right = [np.zeros((0, len(point)))], [np.zeros(0)]
        for where, rows in blocks:
            wide = np.zeros((len(rows), len(point)))
            wide[:, where] = rows[:, :-1]
            matrix.append(wide)
            right.append(rows[:, -1] + wide @ point)
        A, b = np.concatenate(matrix), np.concatenate(right)
        scope = tuple(self._contents.variables.some(numbers))
        return CanonicalForm._make(scope, A.T @ A, A.T @ b, np.asarray(-0.5 * (b @ b)))

    @property
    def _title(self) -> str:
        return f"CliqueTree({count(len(self), 'clique')}, {len(self.touched)} touched)"

    def _summary(self) -> Summary:
        return Summary(self._title)


def _cluster(k: int, clique: Clique, contents: Contents) -> Cluster:
    cpds = tuple(factor.given.cpd for factor, _ in clique.factors)
    hidden = contents.variables.some((*clique.pivots, *clique.separators))
    scope = dict.fromkeys([*hidden, *(v for cpd in cpds for v in cpd.scope)])
    return Cluster(k, tuple(scope), cpds, tuple(cpd.scope for cpd in cpds))


def _nearest_first(
    cliques: Mapping[int, Clique], parents: Vector[int], fresh: set[int]
) -> list[Clique]:
    """Cliques by depth, `fresh` ones before others: above a fresh one all are fresh."""
    level = [clique for lead, clique in cliques.items() if parents[lead] < 0]
    order: list[Clique] = []
    while level:
        order += level
        level = [child for clique in level for child, _ in clique.children]
    return sorted(order, key=lambda clique: clique.lead not in fresh)
