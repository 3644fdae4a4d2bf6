"""Joint tables of variables of one cluster, or of several clusters of a tree.

`tables` are the calibrated beliefs of all clusters in one flat array, (entries, [runs]), in which
`storage` tells the place of each; [runs] is an axis that a single run lacks.
"""

import math
from collections.abc import Sequence

import numpy as np

from pgm.beliefs.discrete.storage import Storage, sepset_between
from pgm.clustergraph.structure import Forest
from pgm.elimination import Plan, TableAlgebra, by_fill, eliminate
from pgm.errors import GraphError
from pgm.factors.axes import States, require_axes, sizes
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import SUM_PRODUCT
from pgm.resources import gibibytes
from pgm.schedules import limits
from pgm.variables import Discrete


def holder(storage: Storage, wanted: States) -> int | None:
    """The number of the cluster with the fewest entries that holds all wanted variables.

    None if no cluster holds them all.
    """
    members: set[Discrete] = set(wanted)
    fits = [k for k, scope in enumerate(storage.scopes) if members.issubset(scope)]
    return min(fits, key=storage.graph.sizes.__getitem__, default=None)


def joint(storage: Storage, tables: Array, scope: States) -> Array:
    """The joint probabilities of the variables of a scope, in its order, (sizes..., [runs]).

    If one cluster holds all the variables, its belief is summed to them. If none does, the graph
    must have no loops. In each tree the smallest subtree that joins clusters which hold the
    variables has as its top their lowest common ancestor, and

        p(scope) = Σ p(top) Π p(cluster | sepset),

    where the product is over the other clusters of the subtrees, each given its sepset with its
    parent, and the sum is over all variables not in the scope. A product that would be too large
    raises `GraphError`.
    """
    one = holder(storage, scope)
    clusters = _joining(storage, scope) if one is None else {one: ()}
    members = tuple(dict.fromkeys(v for k in clusters for v in storage.scopes[k]))
    label = {v: k for k, v in enumerate(members)}
    scopes = [tuple([label[v] for v in storage.scopes[k]]) for k in clusters]
    order, plan = by_fill(scopes, sizes(members), [label[v] for v in scope])
    ordered = [members[k] for k in order]
    place = {v: k for k, v in enumerate(ordered)}
    runs = tables.shape[1:]
    _require_room(plan, ordered, math.prod(runs))
    factors = []
    for cluster, shared in clusters.items():
        own = storage.scopes[cluster]
        turned = sorted(range(len(own)), key=lambda k: place[own[k]])
        conditional = _given(own, storage.table(tables, cluster), shared)
        factors.append(conditional.transpose(*turned, *range(len(own), conditional.ndim)))
    algebra = TableAlgebra(SUM_PRODUCT, plan.sizes, aligned=len(runs), watched=False)
    found: Array = eliminate(plan, factors, algebra)
    asked = ordered[len(ordered) - len(scope) :]
    return found.transpose(*[asked.index(v) for v in scope], *range(len(scope), found.ndim))


def _joining(storage: Storage, scope: States) -> dict[int, States]:
    """The clusters that join the variables of a scope in their trees, each with what it is given.

    That is its sepset with its parent; nothing, for the top of the clusters of each tree.
    """
    forest = storage.graph.derived(Forest.of)
    homes = {v: storage.homes[v] for v in scope}
    parent, tree = forest.parent, forest.roots
    found: dict[int, States] = {}
    for root in dict.fromkeys(tree[list(homes.values())].tolist()):
        mine = {home for home in homes.values() if tree[home] == root}
        below: dict[int, int] = {}
        for k in mine:
            while k >= 0:
                below[k] = below.get(k, 0) + 1
                k = int(parent[k])
        common = [k for k, count in below.items() if count == len(mine)]
        top = max(common, key=lambda k: forest.depth[k])
        for k in below.keys() - (set(common) - {top}):
            found[k] = () if k == top else sepset_between(storage.graph, k, int(parent[k]))
    return found


def _given(scope: States, values: Array, sepset: States) -> Array:
    """The values p(cluster | sepset), of a cluster's belief, (sizes of `scope`..., [runs]).

    The belief is divided by its sums over all variables outside the sepset; the result is zero
    where p(sepset) is zero.
    """
    if not sepset:
        return values
    axes = tuple(k for k, v in enumerate(scope) if v not in sepset)
    total = values.sum(axis=axes, keepdims=True)
    conditional: Array = values / np.where(total == 0.0, 1.0, total)
    return conditional


def _require_room(plan: Plan, variables: Sequence[Discrete], runs: int) -> None:
    """Refuse, by a GraphError, a product of more than a gibibyte, or over too many variables."""
    for step, entries in zip(plan.steps, plan.products, strict=True):
        if len(step.factors) > 1:
            scope = [variables[x] for x in step.scope]
            if entries * runs > limits.LIMIT:
                raise GraphError(
                    f"the joint needs a table that is too large: over ({listed(scope)}), "
                    f"{gibibytes(entries * runs)}, where {gibibytes(limits.LIMIT)} is the limit. "
                    "Ask for fewer variables at once, with fewer runs, or by pgm.query, which may "
                    "need less"
                )
            require_axes(tuple(scope), "the joint", "ask for fewer at once, or ")
