"""Clusters: what the nodes of a cluster graph are."""

from __future__ import annotations

from dataclasses import dataclass

from pgm.clustergraph.size import size
from pgm.cpds import CPD
from pgm.display import Shown, Summary
from pgm.factors.scope import MOST, Scope, listed


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
