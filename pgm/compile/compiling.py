"""Compiling: from a network to a cluster graph."""

from __future__ import annotations

from typing import Any, Protocol, overload

from pgm.boundary import is_whole
from pgm.clustergraph import ClusterGraph
from pgm.compile.balanced import Balanced, BalancedGraph
from pgm.compile.dynamic import DynamicGraph, SliceGraph
from pgm.compile.methods import JunctionTree
from pgm.display import titled
from pgm.errors import GraphError, ModelError
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork
from pgm.resources import require_memory

TREE = JunctionTree()


class Method(Protocol):
    """A method that makes a cluster graph of a network without time."""

    def __call__(self, network: BayesianNetwork) -> ClusterGraph:
        """Compile a network."""


@overload
def compile(
    model: DynamicBayesianNetwork, steps: int | None = None, method: None = None
) -> SliceGraph: ...


@overload
def compile(
    model: DynamicBayesianNetwork, steps: int | None = None, *, method: Balanced
) -> BalancedGraph: ...


@overload
def compile(
    model: BayesianNetwork, steps: None = None, method: Method | None = None
) -> ClusterGraph: ...


def compile(
    model: DynamicBayesianNetwork | BayesianNetwork,
    steps: int | None = None,
    method: Method | Balanced | None = None,
) -> ClusterGraph:
    """Compile a network into a cluster graph.

    Parameters
    ----------
    model : DynamicBayesianNetwork or BayesianNetwork
    steps : int
        T, of a dynamic network: its states are at the steps 0..T.
    method : Method or Balanced, optional
        Of a dynamic network: `Balanced()` makes a balanced tree; without, it is a chain of slices.
        Of a network without time: `JunctionTree()`, if not given, `Bethe()`, `LTRIP()`,
        `JoinGraph(max_size)`, or a function from networks to their cluster graphs. One made by hand
        is a `ClusterGraph(network, clusters)`. Methods and elimination orders differ much in what
        their graphs cost: compare `graph.cost`.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> graph = pgm.compile(pair, method=pgm.JunctionTree(order=pgm.WeightedMinFill()))
    >>> graph.check()
    >>> graph.clusters
    (Cluster(0: (a, b)),)
    """
    if isinstance(model, DynamicBayesianNetwork):
        return _dynamic(model, steps, method)
    if not isinstance(model, BayesianNetwork):
        raise ModelError(f"compile takes a network, not {titled(model)}")
    if steps is not None:
        raise GraphError(
            f"{titled(model)} has no time, so it is not compiled for steps; leave out steps"
        )
    if method is None:
        return TREE(model)
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
    return graph


def _dynamic(model: DynamicBayesianNetwork, steps: Any, method: Any) -> DynamicGraph:
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
    return (SliceGraph if method is None else BalancedGraph)(model, int(steps))
