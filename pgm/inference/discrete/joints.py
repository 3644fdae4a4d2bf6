"""Joint tables of variables of one cluster, or of several clusters of a tree.

`tables` are the calibrated beliefs of all clusters in one flat array, (entries, [runs]), in which
`storage` tells the place of each; [runs] is an axis that a single run lacks. `forest` has the
clusters as rooted trees. A *factor* is a pair: its variables, and its values, with an axis for each
variable, (sizes..., [runs]).
"""

import math
from collections.abc import Sequence

import numpy as np

from pgm.clustergraph.structure import Forest
from pgm.errors import GraphError
from pgm.factors.axes import AXES, States, sizes, spread
from pgm.factors.scope import names
from pgm.inference import limits
from pgm.inference.discrete.storage import Storage, sepset_between
from pgm.kernels.arrays import Array
from pgm.resources import gibibytes
from pgm.variables import Discrete

# The variables of a factor, and its values, (sizes..., [runs]).
Factor = tuple[States, Array]


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
    must have no loops: then the conditionals p(cluster | sepset with the parent) are multiplied
    from the leaves up, in a subtree whose clusters hold the variables, and variables outside the
    scope are summed out as soon as no later factor has them. The joints of several trees are
    multiplied. A product that would be too large raises `GraphError`.
    """
    one = holder(storage, scope)
    if one is not None:
        return _sum((storage.scopes[one], storage.table(tables, one)), scope)
    forest = storage.graph.derived(Forest.of)
    homes = {v: storage.homes[v] for v in scope}
    tree = forest.roots
    result: Factor = ((), np.ones(tables.shape[1:]))
    for root in dict.fromkeys(tree[list(homes.values())].tolist()):
        mine = tuple(v for v in scope if tree[homes[v]] == root)
        result = _product(result, _of_tree(storage, forest, tables, mine, {homes[v] for v in mine}))
    return _sum(result, scope)


def _of_tree(
    storage: Storage, forest: Forest, tables: Array, scope: States, homes: set[int]
) -> Factor:
    """The joint of the variables `scope` of one tree, as a factor over them in any order.

    `homes` are clusters of the tree that together hold these variables. The smallest subtree that
    joins the homes has as its top their lowest common ancestor, and

        p(scope) = Σ p(top) Π p(cluster | sepset),

    where the product is over the other clusters of the subtree, each given its sepset with its
    parent, and the sum is over all variables not in `scope`. From the leaves up, each conditional
    is multiplied into the parent's table, and then the variables are summed out that are neither in
    `scope` nor in the parent's sepset with its own parent.
    """
    parent = forest.parent
    below: dict[int, int] = {}
    for home in homes:
        k = home
        while k >= 0:
            below[k] = below.get(k, 0) + 1
            k = int(parent[k])
    common = [k for k, count in below.items() if count == len(homes)]
    top = max(common, key=lambda k: forest.depth[k])
    inside = sorted(below.keys() - (set(common) - {top}), key=lambda k: -forest.depth[k])
    found: dict[int, Factor] = {}
    for k in inside:
        own = storage.scopes[k]
        factor: Factor = own, storage.table(tables, k)
        shared: States = ()
        if k != top:
            shared = sepset_between(storage.graph, k, int(parent[k]))
            factor = own, _given(factor, shared)
        below_it = [found.pop(child) for child in forest.children[k] if child in found]
        found[k] = _combined([factor, *below_it], {*scope, *shared})
    return found[top]


def _combined(factors: Sequence[Factor], keep: set[Discrete]) -> Factor:
    """The product of some factors, summed over all variables except those in `keep`.

    Each variable is summed out as soon as no remaining factor has it.
    """
    result, *others = factors
    while True:
        later = keep.union(*(scope for scope, _ in others))
        left = tuple(v for v in result[0] if v in later)
        result = left, _sum(result, left)
        if not others:
            return result
        result = _product(result, others.pop(0))


def _given(factor: Factor, sepset: States) -> Array:
    """The values p(cluster | sepset), with the axes of a cluster's belief `factor`.

    The belief is divided by its sums over all variables outside the sepset; the result is zero
    where p(sepset) is zero.
    """
    scope, values = factor
    axes = tuple(k for k, v in enumerate(scope) if v not in sepset)
    total = values.sum(axis=axes, keepdims=True)
    conditional: Array = values / np.where(total == 0.0, 1.0, total)
    return conditional


def _product(a: Factor, b: Factor) -> Factor:
    """The product of two factors, over the variables of `a`, then those that `b` alone has.

    A product of more than a gibibyte, in all runs together, or over more variables than an array
    can have axes, raises `GraphError`.
    """
    scope = a[0] + tuple(v for v in b[0] if v not in a[0])
    runs = a[1].shape[len(a[0]) :]
    entries = math.prod(sizes(scope)) * math.prod(runs)
    if entries > limits.LIMIT or len(scope) > AXES:
        raise GraphError(
            f"the joint needs a table over {names(scope)}, {len(scope)} variables and "
            f"{gibibytes(entries)}, where {AXES} variables and "
            f"{gibibytes(limits.LIMIT)} are the limit; ask for fewer variables at once, "
            "with fewer runs, or pgm.query, which may need less"
        )
    return scope, _arranged(a, scope) * _arranged(b, scope)


def _arranged(factor: Factor, scope: States) -> Array:
    """The values of a factor with an axis for each variable of a scope, in its order, [runs] last.

    The axis of a variable that the factor does not have is of length one.
    """
    own, values = factor
    # Turned round, so that runs lead as in tables.
    return spread(values.T, own[::-1], scope[::-1]).T


def _sum(factor: Factor, keep: States) -> Array:
    """A factor's values summed over all variables not in `keep`, (sizes of `keep`..., [runs]).

    The axes are in the order of `keep`.
    """
    scope, values = factor
    total = values.sum(axis=tuple(k for k, v in enumerate(scope) if v not in keep))
    return _arranged((tuple(v for v in scope if v in keep), total), keep)
