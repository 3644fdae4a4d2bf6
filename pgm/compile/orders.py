"""Orders in which the variables of a network are eliminated: rules, and searches among them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_tuple, is_unordered, is_whole
from pgm.clustergraph.cluster import extent
from pgm.compile.dissection import dissect, stages
from pgm.compile.elimination import Adjacency, Filling, cheapest, fill_order, min_fill, moral
from pgm.compile.sparse import SparseGraph
from pgm.display import InCode
from pgm.errors import GraphError
from pgm.factors.scope import Scope, listed, unknown_name
from pgm.kernels.arrays import Mask
from pgm.networks import BayesianNetwork, MarkovNetwork
from pgm.variables import Variable


class Order(Protocol):
    """A rule that names the variables of a network in the order of their elimination."""

    def __call__(self, network: MarkovNetwork) -> Sequence[Variable]:
        """All variables of a network, each once."""


class Rule(InCode, ABC):
    """An elimination order found by a rule in the moral graph."""

    def __call__(self, network: MarkovNetwork) -> Scope:
        """The variables of a network in this order."""
        inside = network._factorised
        found = (inside.variables[k] for k in self._places(inside, moral(inside)))
        return tuple(variable for variable in found if variable in network._places)

    @abstractmethod
    def _places(self, network: MarkovNetwork, adjacent: Adjacency) -> list[int]:
        """The order as places in `network.variables`, given the moral graph."""


@dataclass(frozen=True)
class MinFill(Rule):
    """Next is the variable whose elimination adds the fewest edges, the first of equals.

    References
    ----------
    Koller and Friedman (2009), Probabilistic Graphical Models, section 9.4.3.

    Examples
    --------
    >>> from pgm.examples import chain
    >>> tree = pgm.JunctionTree(order=pgm.MinFill())
    >>> pgm.compile(chain, method=tree).cost
    396
    """

    def _places(self, network: MarkovNetwork, adjacent: Adjacency) -> list[int]:
        return min_fill(adjacent, [1] * len(adjacent))


@dataclass(frozen=True)
class WeightedMinFill(Rule):
    """Next is the variable whose elimination adds edges of the least weight, the first of equals.

    An edge weighs the product of its two variables' numbers of states, or of components if they
    are continuous. Better than `MinFill` where these differ much.

    Examples
    --------
    >>> from pgm.examples import chain
    >>> tree = pgm.JunctionTree(order=pgm.WeightedMinFill())
    >>> pgm.compile(chain, method=tree).cost
    396
    """

    def _places(self, network: MarkovNetwork, adjacent: Adjacency) -> list[int]:
        return min_fill(adjacent, _weights(network))


@dataclass(frozen=True)
class MinDegree(Rule):
    """Next is a variable with the fewest neighbours, after all that are no parents.

    Nothing has to be counted but neighbours: the 90,000 pixels of a field are ordered in a third of
    a second, where `MinFill` takes half a minute. It leads to more operations: on a field of that
    size a third, on smaller ones and pose graphs a tenth to a fifth.

    References
    ----------
    Liu (1985), Modification of the minimum-degree algorithm by multiple elimination; as in SuperLU,
    which comes with SciPy.

    Examples
    --------
    >>> from pgm.examples import chain
    >>> tree = pgm.JunctionTree(order=pgm.MinDegree())
    >>> pgm.compile(chain, method=tree).cost
    396
    """

    def _places(self, network: MarkovNetwork, adjacent: Adjacency) -> list[int]:
        inner = _parents(network)
        order = np.flatnonzero(inner)[SparseGraph.of(adjacent).part(inner).by_degree()]
        return [*np.flatnonzero(~inner).tolist(), *order.tolist()]


# A continuous network with more parents than this is ordered by degrees.
LARGE = 5000


@public
@dataclass(frozen=True)
class StochasticMinFill(Rule):
    """The order of `MinFill`, or the cheapest of many that are drawn, if that is cheaper.

    For a discrete network whose tables are large, there are tries with other weights, then with
    fills that are multiplied by random numbers near one, and the order whose tables have the fewest
    entries is taken, the same each time. The search takes about as long as two first passes of
    messages over the tables, and with 200 tries less than a second. There is none where a try would
    cost more than it could spare or nothing would make the tables fit in memory, nor of a
    continuous network. That of more than 5,000 variables that are parents has the order of
    `MinDegree`.

    Parameters
    ----------
    tries : int
        At the most; of networks of more than 160 variables in proportion fewer.
    seed : int
        Seed of the random tries.

    References
    ----------
    Kask, Gelfand, Otten and Dechter (2011), Pushing the power of stochastic greedy ordering schemes
    for inference in graphical models.

    Examples
    --------
    >>> from pgm.examples import chain
    >>> tree = pgm.JunctionTree(order=pgm.StochasticMinFill(tries=10))
    >>> pgm.compile(chain, method=tree).cost
    396
    """

    tries: int = 200
    seed: int = 0

    def __post_init__(self) -> None:
        for name, given in (("tries", self.tries), ("seed", self.seed)):
            if not is_whole(given) or given < 0:
                raise GraphError(
                    f"StochasticMinFill takes a whole number of {name}, 0 or more, not {given!r}"
                )

    def _places(self, network: MarkovNetwork, adjacent: Adjacency) -> list[int]:
        if not network.discrete:
            rule = MinDegree() if _is_large(network) else MinFill()
            return rule._places(network, adjacent)
        return cheapest(adjacent, _weights(network), self.tries, self.seed)


@public
@dataclass(frozen=True)
class NestedDissection(Rule):
    """Last is a small set of variables that parts the network into halves; so in each half.

    The set is the smallest middle level of a breadth-first search from the edge of the network.
    The tree is shallow, about log₂ n clusters deep for a chain of n variables where `MinFill` gives
    n. On fields it costs as `MinFill` does, a third less than `MinDegree` with 90,000 variables; on
    pose graphs two to three times as much, and by powers of ten more on networks that branch.
    Inside a set, and in small parts, the next variable is the one of least weighted fill; of more
    than 5,000 variables that are parents, one with the fewest neighbours.

    Parameters
    ----------
    small : int
        Parts of at most this many variables are not divided.

    References
    ----------
    George and Liu (1981), Computer Solution of Large Sparse Positive Definite Systems, section 8.1.

    Examples
    --------
    >>> from pgm.examples import chain
    >>> tree = pgm.JunctionTree(order=pgm.NestedDissection())
    >>> pgm.compile(chain, method=tree).cost
    700
    """

    small: int = 8

    def __post_init__(self) -> None:
        if not is_whole(self.small) or self.small < 1:
            raise GraphError(
                f"NestedDissection divides parts of more than `small` variables, a whole number, "
                f"1 or more, not {self.small!r}"
            )

    def _places(self, network: MarkovNetwork, adjacent: Adjacency) -> list[int]:
        if not _is_large(network):
            return min_fill(adjacent, _weights(network), dissect(adjacent, self.small))
        inner = _parents(network)
        graph = SparseGraph.of(adjacent).part(inner)
        stage = stages(graph, self.small)
        apart = graph.without(stage[graph.tails] != stage[graph.heads])
        by_degree = apart.by_degree()
        order = by_degree[np.argsort(stage[by_degree], kind="stable")]
        return [*np.flatnonzero(~inner).tolist(), *np.flatnonzero(inner)[order].tolist()]


def places(
    order: Order | Iterable[Variable], network: MarkovNetwork, adjacent: Adjacency
) -> list[int]:
    """An elimination order as places among the variables of the network in its factors.

    `adjacent` is the moral graph of these. A user's order has the variables of the network itself.
    """
    inside = network._factorised
    if isinstance(order, Rule):
        return order._places(inside, adjacent)
    given = order(network) if callable(order) else order
    found = None if is_unordered(given) else as_tuple(given)
    if found is None:
        raise GraphError(
            f"the elimination order {order!r} returned {given!r} where the network's variables "
            "were due, each once"
        )
    place = network._places
    strangers = [v for v in found if not isinstance(v, Variable) or v not in place]
    if strangers:
        raise GraphError(
            f"the elimination order holds {strangers[0]!r}, {unknown_name(strangers[0], place)}",
            variable=strangers[0],
        )
    order_ = [place[variable] for variable in found]
    lost = sorted(set(range(len(place))).difference(order_))
    if lost:
        missing = [network.variables[k] for k in lost]
        raise GraphError(
            f"the elimination order lacks ({listed(missing)}); it names each variable once",
            variable=missing[0],
        )
    if len(order_) > len(place):
        twice = next(variable for variable in found if found.count(variable) > 1)
        raise GraphError(f"the elimination order names {twice!r} twice", variable=twice)
    return order_ if inside is network else _with_intermediate(found, inside, adjacent)


def _with_intermediate(
    order: Sequence[Variable], inside: MarkovNetwork, adjacent: Adjacency
) -> list[int]:
    """A user's order with the intermediate variables of independent causes.

    Each leaves as soon as that joins nothing, which widens no cluster; those that are left, last.
    """
    place, graph = inside._places, Filling(adjacent, [1] * len(adjacent))
    found: list[int] = []
    left = set(place.values()).difference(place[variable] for variable in order)
    for variable in order:
        near = graph.eliminate(place[variable])
        found.append(place[variable])
        while free := [k for k in sorted(near & left) if not graph.fill[k]]:
            for k in free:
                if not graph.fill[k]:
                    near |= graph.eliminate(k)
                    found.append(k)
                    left.discard(k)
    return found + [k for k in fill_order(graph, [0] * len(adjacent)) if k in left]


def _is_large(network: MarkovNetwork) -> bool:
    """Whether more than `LARGE` variables are parents."""
    most = len(network.variables)
    return most > LARGE and int(np.count_nonzero(_parents(network))) > LARGE


def _parents(network: MarkovNetwork) -> Mask:
    """Which variables are parents; the others' neighbours are a family, joined to each other.

    Where factors have no direction, all may be.
    """
    if not isinstance(network, BayesianNetwork):
        return np.ones(len(network.variables), dtype=bool)
    found = np.zeros(len(network.variables), dtype=bool)
    found[list({place for _, *parents in network._families for place in parents})] = True
    return found


def _weights(network: MarkovNetwork) -> list[int]:
    return list(map(extent, network.variables))
