"""Compiling: from a network to a cluster graph, or to the balanced tree of a dynamic one.

A *segment* is the states at the steps from a to b > a. Its middle is the multiple of the highest
power of two between its ends: there it falls into two segments, these into theirs, down to single
transitions. So edges are arithmetic on indices, and nothing has to be stored.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, overload

from pgm.arguments import public
from pgm.boundary import is_whole
from pgm.clustergraph import Cluster, ClusterGraph
from pgm.compile.dynamic import DynamicGraph, SliceGraph
from pgm.compile.machine import Choice, as_choice, without_machine_code
from pgm.compile.methods import JunctionTree
from pgm.cpds import by_step
from pgm.display import InCode, titled
from pgm.errors import GraphError, ModelError
from pgm.factors.scope import Scope
from pgm.networks import DynamicBayesianNetwork, MarkovNetwork
from pgm.resources import require_memory
from pgm.variables import Discrete


@dataclass(frozen=True)
class Balanced(InCode):
    r"""Compile a dynamic network to a balanced tree of its segments, of logarithmic depth.

    All clusters of a level can send at once, in a batched call: solving takes about 2 log₂ T rounds
    where the chain of slices takes 2 T. It serves linear models, and nonlinear ones whose
    linearisations are given, as in iterated smoothing: the first is along ``start=``, or else dead
    reckoning, so that one iteration with `Taylor` is a single Gauss–Newton step from there, where
    the chain of slices gives the extended RTS smoother. Nonlinear models are not filtered on it.

    A segment of the steps from a to b, with m in the middle, is a cluster

    .. math:: \{x_a, x_m, x_b\}, \quad m = \text{the multiple of the highest } 2^k
              \text{ between } a \text{ and } b,

    whose sepset with the segment above is :math:`\{x_a, x_b\}`. Leaves are the clusters of the
    chain, with its CPDs.

    References
    ----------
    Särkkä and García-Fernández (2021), Temporal parallelization of Bayesian smoothers. George and
    Liu (1981), Computer Solution of Large Sparse Positive Definite Systems, section 8.1.

    Examples
    --------
    >>> Balanced()
    Balanced()
    """


class BalancedGraph(DynamicGraph):
    """The balanced cluster tree of a dynamic network.

    Clusters 0..T are its leaves, those of the chain of slices. Cluster T + m, for m in 1..T−1,
    holds the states at both ends of a segment and at m, its middle; no CPD is its own. Its children
    are the segments before and after m, and the sepset between a segment and its parent is the
    states at its ends. Cluster 0 hangs on the root.
    """

    @cached_property
    def root(self) -> int:
        """The cluster of the whole chain."""
        return self._over(0, self.steps) if self.steps else 0

    @property
    def depth(self) -> int:
        """Edges between the root and the deepest leaf: the rounds of messages up, or down."""
        return max((self.steps - 1).bit_length(), 1) if self.steps else 0

    def segment(self, cluster: int | Cluster) -> tuple[int, int]:
        """The steps a and b at the ends of a cluster's segment; of cluster 0 both are 0."""
        return self._segment(self.index(cluster))

    def parent(self, cluster: int | Cluster) -> int | None:
        """The cluster above one; None of the root."""
        return self._parent(self.index(cluster))

    def children(self, cluster: int | Cluster) -> tuple[int, ...]:
        """The clusters below one, in the order of their steps."""
        return self._children(self.index(cluster))

    def _segment(self, index: int) -> tuple[int, int]:
        if index <= self.steps:
            return max(index - 1, 0), index
        middle = index - self.steps
        half = middle & -middle
        return middle - half, min(middle + half, self.steps)

    def _over(self, first: int, last: int) -> int:
        if last - first == 1:
            return last
        return self.steps + first + (1 << (last - first - 1).bit_length() - 1)

    def _parent(self, index: int) -> int | None:
        if index == self.root:
            return None
        first, last = self._segment(index)
        if not last:
            return self.root
        # One end is the middle of the segment above, the other an end of that one too.
        ends = [end for end in (first, last) if 0 < end < self.steps]
        return self.steps + min(ends, key=lambda end: end & -end)

    def _children(self, index: int) -> tuple[int, ...]:
        below: tuple[int, ...] = ()
        if index > self.steps:
            first, last = self._segment(index)
            middle = index - self.steps
            below = self._over(first, middle), self._over(middle, last)
        return (0, *below) if index == self.root and self.steps else below

    def _view(self, index: int) -> Cluster:
        if index <= self.steps:
            return super()._view(index)
        first, last = self._segment(index)
        return Cluster(index, self.states_at(first, index - self.steps, last), (), ())

    def within(self, steps: int) -> list[int]:
        """The indices of the clusters whose variables are at the steps 0..steps."""
        leaves = range(min(steps, self.steps) + 1)
        middles = (self.steps + middle for middle in leaves[1:-1])
        return [*leaves, *(index for index in middles if self._segment(index)[1] <= steps)]

    @property
    def _count(self) -> int:
        return max(2 * self.steps, 1)

    def _joined(self, index: int) -> tuple[int, ...]:
        above = self._parent(index)
        return tuple(sorted([*self._children(index), *(() if above is None else (above,))]))

    def _sepset(self, i: int, j: int) -> Scope:
        child = i if self._parent(i) == j else j
        return self.states_at(*dict.fromkeys(self._segment(child)))

    @property
    def _alike(self) -> Iterator[tuple[Cluster, int]]:
        yield self._view(0), 1
        for first, count in ((1, self.steps), (self.steps + 1, self.steps - 1)):
            if count > 0:
                yield self._view(first), count

    @property
    def _title(self) -> str:
        return (
            f"BalancedGraph(clusters 0..{self._count - 1} over steps 0..{self.steps}, depth "
            f"{self.depth}, sepsets of {list(self.model.states)})"
        )


TREE = JunctionTree()


class Method(Protocol):
    """A method that makes a cluster graph of a network without time."""

    def __call__(self, network: MarkovNetwork) -> ClusterGraph:
        """Compile a network."""


@overload
def compile(
    model: DynamicBayesianNetwork,
    steps: int | None = None,
    method: None = None,
    *,
    compiled: Choice = None,
) -> SliceGraph: ...


@overload
def compile(
    model: DynamicBayesianNetwork,
    steps: int | None = None,
    *,
    method: Balanced,
    compiled: Choice = None,
) -> BalancedGraph: ...


@overload
def compile(
    model: MarkovNetwork,
    steps: None = None,
    method: Method | None = None,
    *,
    compiled: Choice = None,
) -> ClusterGraph: ...


@public
def compile(
    model: DynamicBayesianNetwork | MarkovNetwork,
    steps: int | None = None,
    method: Method | Balanced | None = None,
    *,
    compiled: Choice = None,
) -> ClusterGraph:
    """Compile a network into a cluster graph.

    Parameters
    ----------
    model : DynamicBayesianNetwork, BayesianNetwork or MarkovNetwork
    steps : int
        T, of a dynamic network: its states are at the steps 0..T.
    method : Method or Balanced, optional
        For a dynamic network: `Balanced()` makes a balanced tree; without, it is a chain of slices.
        For a network without time: `JunctionTree()`, if not given, `Bethe()`, `LTRIP()`,
        `JoinGraph(max_size)`, or a function from networks to their cluster graphs. One made by hand
        is a `ClusterGraph(network, clusters)`. Methods and elimination orders differ much in what
        their graphs cost: compare `graph.cost`.
    compiled : bool or Compiled, optional
        Whether sweeps along the chain of a dynamic network, or over the tree of a Gaussian network
        without time, run in machine code, by LLVM, with equal results to rounding. Of a chain
        ``graph.compilation`` tells which CPDs can be: a function that
        cannot is called in the middle of it; with some other CPDs, all of it runs without. If not
        given, that is where llvmlite is installed and NumPy would take longer than compiling does,
        which is from some 2,500 steps of one run on, or 230 of a thousand, and in trees of some
        hundred clusters.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> graph = pgm.compile(pair, method=pgm.JunctionTree(order=pgm.WeightedMinFill()))
    >>> graph.check()
    >>> graph.clusters
    (Cluster(0: (a, b)),)
    """
    if isinstance(model, DynamicBayesianNetwork):
        return _dynamic(model, steps, method, compiled)
    if not isinstance(model, MarkovNetwork):
        raise ModelError(f"compile takes a network, not {titled(model)}")
    if steps is not None:
        raise GraphError(
            f"{titled(model)} has no time, so it is not compiled for steps; leave out steps"
        )
    choice = as_choice(compiled, "pgm.compile(...)")
    if method is None:
        return _chosen(TREE(model), choice)
    if isinstance(method, Balanced):
        raise GraphError(
            f"{method!r} dissects the chain of a dynamic network, and {titled(model)} has no time; "
            "give method=pgm.JunctionTree(order=pgm.NestedDissection())"
        )
    if not callable(method) or isinstance(method, type):
        raise GraphError(
            f"{method!r} is no method; give one like pgm.JunctionTree() or pgm.Bethe()"
        )
    graph = method(model)
    if not isinstance(graph, ClusterGraph):
        raise GraphError(f"{method!r} returned {titled(graph)} where a ClusterGraph was due")
    if graph.network is not model:
        raise GraphError(
            f"{method!r} returned a graph of {titled(graph.network)}, not of the network it was "
            f"given, {titled(model)}; a method compiles the network that it is given"
        )
    return _chosen(graph, choice)


def _chosen(graph: ClusterGraph, choice: Choice) -> ClusterGraph:
    """The graph of a network without time, with the user's choice of machine code."""
    if choice is None:
        return graph
    if choice and any(isinstance(v, Discrete) for v in graph.network.variables):
        raise without_machine_code("tables", graph.network)
    if choice and not graph.is_tree:
        raise without_machine_code("rounds", graph)
    found = copy(graph)
    found._set(compiled=choice)
    return found


def _dynamic(model: DynamicBayesianNetwork, steps: Any, method: Any, compiled: Any) -> DynamicGraph:
    if method is not None and not isinstance(method, Balanced):
        raise GraphError(
            f"a dynamic network is compiled to a chain of slices, or by pgm.Balanced() to a tree, "
            f"not by {method!r}; leave out the method, or compile model.unroll(steps)"
        )
    if not is_whole(steps) or steps < 0:
        raise GraphError(
            f"a dynamic network is compiled for steps 0..T; give steps=T, 0 or more, not {steps!r}"
        )
    require_memory(
        int(steps) * sum(cpd.child.dimension for cpd in model.transition),
        f"the means at {steps} steps",
        "compile for fewer",
        error=GraphError,
    )
    by_step.require_last(model._changing, int(steps), GraphError)
    choice = as_choice(compiled, "pgm.compile(...)", card=True)
    if choice and model.discrete:
        raise without_machine_code("tables", model)
    if method is None:
        return SliceGraph(model, int(steps), choice)
    if choice:
        raise without_machine_code("rounds", method)
    return BalancedGraph(model, int(steps), False)
