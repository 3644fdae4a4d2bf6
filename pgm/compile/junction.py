"""Junction trees: the exact way to compile a network without time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from pgm.boundary import as_tuple, is_unordered
from pgm.clustergraph import ClusterGraph
from pgm.clustergraph.checks import Edge
from pgm.compile.elimination import clique_tree, moral
from pgm.compile.orders import Order, StochasticMinFill, places
from pgm.errors import GraphError
from pgm.networks import BayesianNetwork
from pgm.variables import Variable


@dataclass(frozen=True)
class JunctionTree:
    """Compile to a tree of the cliques of the triangulated moral graph.

    Calibrating it is exact; what it costs grows with the largest clique. A network whose parts
    are not connected gives several trees.

    Parameters
    ----------
    order : Order or iterable of Variable, optional
        Of elimination: `StochasticMinFill()`, if not given, `MinFill()`, `WeightedMinFill()`,
        `NestedDissection()`, a function from networks to variables, or the variables themselves,
        each once. What it decides is what calibrating costs: compare `graph.cost`.

    Raises
    ------
    GraphError
        If the order is none.

    References
    ----------
    Lauritzen and Spiegelhalter (1988), Local computations with probabilities on graphical
    structures and their application to expert systems.

    Examples
    --------
    >>> JunctionTree()
    JunctionTree(order=StochasticMinFill(tries=200, seed=0))
    """

    order: Order | Iterable[Variable] = field(default_factory=StochasticMinFill)

    def __post_init__(self) -> None:
        order = self.order
        listed = None if callable(order) or is_unordered(order) else as_tuple(order)
        if isinstance(order, type) or (listed is None and not callable(order)):
            raise GraphError(
                f"{order!r} is no elimination order; give a value like pgm.MinFill() or "
                "pgm.WeightedMinFill(), or the network's variables"
            )
        if listed is not None:
            object.__setattr__(self, "order", listed)

    def __call__(self, network: BayesianNetwork) -> ClusterGraph:
        """Compile a network.

        Raises
        ------
        GraphError
            If the order is not of the variables of the network, each once.
        """
        tree = clique_tree(moral(network), places(self.order, network))
        return graph_of(network, tree.cliques, tree.sepsets)


def graph_of(
    network: BayesianNetwork,
    clusters: Iterable[set[int]],
    sepsets: Mapping[Edge, set[int]],
) -> ClusterGraph:
    """The cluster graph of sets of places in `network.variables`."""
    variables = network.variables
    return ClusterGraph(
        network,
        [[variables[k] for k in cluster] for cluster in clusters],
        {edge: [variables[k] for k in shared] for edge, shared in sepsets.items()},
    )
