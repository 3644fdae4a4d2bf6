r"""Exact readings of the components of a variable that were observed.

A variable x some components of which were observed is hidden, and has a child of its own,

    y = S x,    S a selection of rows of the identity,

without noise, whose evidence is what was observed: the belief of the other components is the
conditional one, and ln p(y) the density of those observed.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.compile.methods import JunctionTree
from pgm.cpds import LinearGaussianCPD
from pgm.kernels.arrays import Mask
from pgm.networks import BayesianNetwork, MarkovNetwork
from pgm.variables import Variable


def with_readings(
    graph: ClusterGraph, parts: Mapping[Variable, Mask]
) -> tuple[ClusterGraph, dict[Variable, Variable]]:
    """A graph with an exact reading of each variable observed in part, and these by variable.

    `parts` has the mask of the components observed, (d,). A reading stands in the smallest cluster
    that has its variable.
    """
    key = tuple((v, tuple(np.flatnonzero(mask).tolist())) for v, mask in parts.items())
    return graph.derived(_with_readings, key)


def _with_readings(
    graph: ClusterGraph, key: tuple[tuple[Variable, tuple[int, ...]], ...]
) -> tuple[ClusterGraph, dict[Variable, Variable]]:
    network = graph.network
    taken = {v.name for v in network.variables}
    cpds = [_reading(variable, places, taken) for variable, places in key]
    readings = {variable: cpd.child for (variable, _), cpd in zip(key, cpds, strict=True)}
    made = _appended(network, cpds)
    if network.mixed:  # which is solved part by part, whatever its clusters
        return JunctionTree()(made), readings
    moved = [made._places[v] for v in network._factorised.variables]
    members = [[moved[k] for k in held] for held in graph._members]
    assigned = [list(own) for own in graph._assigned]
    homes = [
        min(
            (k for k, held in enumerate(members) if made._places[v] in held),
            key=lambda k: graph.sizes[k],
        )
        for v in readings
    ]
    for number, (home, cpd) in enumerate(zip(homes, cpds, strict=True), len(network.factors)):
        members[home].append(made._places[cpd.child])
        assigned[home].append(number)
    shared = {edge: tuple(sorted(moved[k] for k in held)) for edge, held in graph._shared.items()}
    held = [tuple(sorted(places)) for places in members]
    return graph._with(made, held, shared, assigned), readings


def _appended(network: MarkovNetwork, cpds: list[LinearGaussianCPD]) -> MarkovNetwork:
    """The network with some CPDs of new variables after all its factors."""
    if isinstance(network, BayesianNetwork):
        return BayesianNetwork._made([*network.cpds, *cpds])
    return network._of([*network.factors, *cpds])


def _reading(variable: Variable, places: tuple[int, ...], taken: set[str]) -> LinearGaussianCPD:
    """The exact reading of some components of a variable, by their places."""
    name = f"{variable!r} in part"
    while name in taken:
        name += "′"
    taken.add(name)
    components = tuple(variable.components[k] for k in places)
    child = Variable(name, components, tuple(c for c in components if c in variable.angles))
    return LinearGaussianCPD(child, {variable: np.eye(variable.dimension)[list(places)]}, cov=0.0)
