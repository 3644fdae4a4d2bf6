"""Clusters, the nodes of a cluster graph: their sizes, and the work they make."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pgm.cpds import CPD
from pgm.display import Listing, Shown, Summary, few
from pgm.factors.scope import MOST, Scope, dimension, listed
from pgm.variables import Discrete, Variable

if TYPE_CHECKING:
    from pgm.clustergraph.structure import ClusterGraph


@dataclass(frozen=True, eq=False, repr=False)
class Cluster(Shown):
    """A set of variables, with the CPDs whose product is its potential.

    Attributes
    ----------
    index : int
    scope : tuple of Variable
    cpds : tuple of CPD
    families : tuple of tuple of Variable
        The family of each CPD, child first, all inside the scope.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> cluster = pgm.compile(pair).clusters[0]
    >>> cluster
    Cluster(0: (a, b))
    >>> cluster.cpds
    (GaussianCPD(a), LinearGaussianCPD(b | a))
    """

    index: int
    scope: Scope
    cpds: tuple[CPD, ...]
    families: tuple[Scope, ...]

    @property
    def size(self) -> int:
        """Components of its continuous variables, or entries of its discrete ones' table."""
        return size(self.scope)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Cluster) and (self.index, self.scope, self.cpds) == (
            other.index,
            other.scope,
            other.cpds,
        )

    def __hash__(self) -> int:
        return hash((self.index, self.scope))

    @property
    def _title(self) -> str:
        return f"Cluster({self.index}: ({listed(self.scope)}))"

    def _summary(self) -> Summary:
        """The variables, and the CPDs in the notebook; in a terminal clusters stand in lists."""
        return Summary(self._title, [cpd._title for cpd in self.cpds[:MOST]])

    def __repr__(self) -> str:
        return self._title


def extent(variable: Variable) -> int:
    """Number of states of a discrete variable, of components of a continuous one."""
    return variable.size if isinstance(variable, Discrete) else variable.dimension


def size(scope: Scope) -> int:
    """Entries of a table over discrete variables, or components of continuous ones."""
    if is_discrete(scope):
        return math.prod(map(extent, scope))
    return dimension(scope)


def work(scope: Scope) -> int:
    """Entries of a table, or the cube of the components, as of a Cholesky factor."""
    return size(scope) if is_discrete(scope) else size(scope) ** 3


def is_discrete(scope: Iterable[Variable]) -> bool:
    """Whether a factor over these variables is a table."""
    return any(isinstance(variable, Discrete) for variable in scope)


def amount(number: int) -> str:
    """A number for messages: a power of ten, where its digits would not be read."""
    return str(number) if number < 10**9 else f"10^{math.log10(number):.1f}"


# Sepsets of a cluster, and variables of a sepset, that are shown.
FEW = 3


def neighbourhoods(graph: ClusterGraph) -> Listing:
    """The first and last clusters, each with its variables and its neighbours."""
    rows: list[Sequence[str] | None] = []
    for k in few(len(graph)):
        if k is None:
            rows.append(None)
            continue
        joined = graph.neighbours(k)
        each = [f"{j} by {listed(graph.sepsets[min(k, j), max(k, j)], FEW)}" for j in joined[:FEW]]
        more = [f"... {len(joined)} in all"] * (len(joined) > FEW)
        scope = listed(graph.clusters[k].scope)
        rows.append([str(k), scope, "; ".join(each + more)])
    heads = ("cluster", "variables", "joined to")
    return Listing(heads, rows, names=3)
