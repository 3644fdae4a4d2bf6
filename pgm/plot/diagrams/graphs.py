"""Networks as directed graphs of the nodes to draw, with what is observed."""

from __future__ import annotations

from collections.abc import Iterable

import networkx as nx

from pgm.boundary import is_whole
from pgm.errors import EvidenceError, ModelError, PgmError
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork
from pgm.variables import Variable

Network = BayesianNetwork | DynamicBayesianNetwork


def directed(model: Network, steps: int | None, evidence: Iterable[Variable] | None) -> nx.DiGraph:
    """Parents and children as nodes; each has the attribute ``observed``.

    Parameters
    ----------
    model : BayesianNetwork or DynamicBayesianNetwork
    steps : int, optional
        The last slice of a dynamic network; 1 without.
    evidence : iterable of Variable, optional
        What is observed beside the inputs, a template standing for all its steps; without, the
        sensors of a dynamic network.

    Raises
    ------
    ModelError
        If `steps` is no step, or the network has none.
    EvidenceError
        If the evidence names what is no variable of the network.
    """
    if isinstance(model, BayesianNetwork):
        if steps is not None:
            raise ModelError("steps cut a DynamicBayesianNetwork; leave them out")
        graph = model.to_networkx()
        sensors: tuple[Variable, ...] = ()
    else:
        graph = model.to_networkx(1 if steps is None else last(steps, "slice", ModelError))
        sensors = model.sensors
    known = set(graph) | {node.template for node in graph} | set(model.variables)
    observed = {*model.inputs, *(sensors if evidence is None else named(evidence, known))}
    for node in graph:
        graph.nodes[node]["observed"] = node in observed or node.template in observed
    return graph


def named(evidence: Iterable[Variable], known: Iterable[Variable]) -> frozenset[Variable]:
    """The variables that evidence names, each one of those known."""
    found = (evidence,) if isinstance(evidence, Variable) else tuple(evidence)
    known = set(known)
    for variable in found:
        if variable not in known:
            raise EvidenceError(
                f"evidence names {variable!r}, which the network does not have",
                variable=variable if isinstance(variable, Variable) else None,
            )
    return frozenset(found)


def in_slices(graph: nx.DiGraph) -> bool:
    """Whether the nodes are at two steps or more, with parents at their own or the one before."""
    steps = {node.step for node in graph}
    return (
        len(steps) > 1
        and None not in steps
        and all(child.step - parent.step in (0, 1) for parent, child in graph.edges)
    )


def last(steps: int, what: str, error: type[PgmError]) -> int:
    """The last slice or cluster to draw; refuses what is none."""
    if not is_whole(steps) or steps < 0:
        raise error(f"steps must be the last {what} to draw, 0 or more, not {steps!r}")
    return int(steps)
