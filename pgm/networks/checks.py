"""What networks check of their CPDs, whatever their kind."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import networkx as nx

from pgm.cpds import CPD
from pgm.errors import ModelError
from pgm.factors.scope import Scope
from pgm.variables import Variable

C = TypeVar("C", bound=CPD)


def as_cpds(cpds: CPD | Iterable[CPD], where: str) -> tuple[CPD, ...]:
    """CPDs as a tuple; refuses anything else."""
    if not isinstance(cpds, CPD | Iterable):
        raise ModelError(f"{where} is a sequence of CPDs, not {cpds!r}")
    result = (cpds,) if isinstance(cpds, CPD) else tuple(cpds)
    for cpd in result:
        if not isinstance(cpd, CPD):
            raise ModelError(f"{where} holds CPDs, not {cpd!r}")
    return result


def one_name_each(variables: Iterable[Variable]) -> None:
    """Refuse two different variables of one name."""
    seen: dict[str, Variable] = {}
    for variable in variables:
        template = variable.template
        first = seen.setdefault(variable.name, template)
        if first != template:
            raise ModelError(
                f"two different variables are called {variable.name!r}: one with components "
                f"{first.components} (angles {first.angles}), one with {template.components} "
                f"(angles {template.angles}); rename one",
                variable=template,
            )


def one_cpd_each(cpds: Iterable[CPD]) -> None:
    """Refuse a second CPD for a child."""
    seen: dict[Variable, CPD] = {}
    for cpd in cpds:
        if cpd.child in seen:
            raise ModelError(
                f"{cpd.child!r} has two CPDs, {seen[cpd.child]!r} and {cpd!r}; keep one",
                variable=cpd.child,
                cpd=cpd,
            )
        seen[cpd.child] = cpd


def in_order(cpds: Sequence[C], parents: Callable[[C], Scope]) -> tuple[C, ...]:
    """CPDs with parents before children, in the given order where that leaves a choice."""
    by_child = {cpd.child: cpd for cpd in cpds}
    graph = nx.DiGraph()
    graph.add_nodes_from(by_child)
    graph.add_edges_from((p, cpd.child) for cpd in cpds for p in parents(cpd) if p in by_child)
    place = {child: k for k, child in enumerate(by_child)}
    try:
        order = list(nx.lexicographical_topological_sort(graph, key=place.__getitem__))
    except nx.NetworkXUnfeasible:
        loop = [edge[0] for edge in nx.find_cycle(graph)]
        path = " -> ".join(map(repr, [*loop, loop[0]]))
        raise ModelError(
            f"the CPDs form a cycle, {path}; a variable may depend on itself only through "
            "the step before (.previous)",
            variable=loop[0],
            cpd=by_child[loop[0]],
        ) from None
    return tuple(by_child[child] for child in order)
