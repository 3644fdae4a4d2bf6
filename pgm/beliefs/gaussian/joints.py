"""Joints of variables that no single cluster of a tree holds: their means and covariances.

A component's *place* is its index in the vector of all hidden components. V is the number of
covariances: 1 if all runs share them, else the number of runs.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.gaussian.beliefs import Beliefs
from pgm.beliefs.gaussian.careful import DenseBeliefs
from pgm.beliefs.gaussian.tree import TreeBeliefs, TreePlan
from pgm.kernels.arrays import Array, Integers, transpose
from pgm.kernels.solving import regression


def joint_moments(plan: TreePlan, beliefs: Beliefs, wanted: Integers) -> tuple[Array, Array]:
    """Mean (runs, n) and covariance (V, n, n) of components, which any clusters may hold.

    `wanted` (n,) are the components' places. The results are in the user's units. The covariance P
    is collected from the top of the tree down. Given the components s of its sepset with its
    parent, a cluster's other components f are independent of the components a above it in the tree.
    So their covariance with these is

        P_fa = P_fs P_ss⁺ P_sa,

    P_ss⁺ being the pseudo-inverse of P_ss.
    """
    if isinstance(beliefs, DenseBeliefs):
        return beliefs.moments(wanted, wanted, wanted)
    walk = _walk(plan, wanted)
    places, layout = beliefs.places, plan.layout
    known: list[int] = []
    cov = np.zeros((beliefs.cov.shape[0], 0, 0))
    for k, cluster in enumerate(walk):
        columns = layout.columns[cluster]
        shared = [place for place in known if place in columns]
        fresh = [place for place in columns if place not in shared]
        order = np.array([[*shared, *fresh]], dtype=np.intp)
        inside = beliefs.cov[:, places.of(np.array([cluster]), order)[1][0]]
        along = cov[:, [known.index(place) for place in shared]]
        cross = _gain(plan, beliefs, cluster, inside, shared, fresh) @ along
        cov = np.block([[cov, transpose(cross)], [cross, inside[:, len(shared) :, len(shared) :]]])
        # What neither the user nor a cluster further down asks for is dropped.
        needed = {*wanted.tolist(), *(p for below in walk[k + 1 :] for p in layout.columns[below])}
        known += fresh
        keep = [at for at, place in enumerate(known) if place in needed]
        known = [known[at] for at in keep]
        cov = cov[:, keep][:, :, keep]
    order = np.array([known.index(place) for place in wanted.tolist()])
    scale = beliefs.frame.scale[wanted]
    mean, _ = beliefs.components()
    return mean[:, wanted], cov[:, order][:, :, order] * (scale[:, None] * scale)


def _walk(plan: TreePlan, wanted: Integers) -> list[int]:
    """The clusters that connect the components at places `wanted` (n,), parents before children.

    For each component a cluster is taken that holds it: the one of fewest components. The result is
    the smallest subtree that connects these clusters; where they are in several trees, it is the
    paths from them to the roots.
    """
    home, _ = plan.places.homes
    parent, depth = plan.forest.parent, plan.forest.depth
    ends = {int(home[place]) for place in wanted}
    # Climb from the deepest end until one cluster is left, or only roots.
    found, front = set(ends), set(ends)
    while len(front) > 1:
        deepest = max(front, key=lambda k: (depth[k], k))
        if parent[deepest] < 0:
            break
        front.remove(deepest)
        front.add(int(parent[deepest]))
        found.add(int(parent[deepest]))
    return sorted(found, key=lambda k: (depth[k], k))


def _gain(
    plan: TreePlan,
    beliefs: Beliefs,
    cluster: int,
    inside: Array,
    shared: list[int],
    fresh: list[int],
) -> Array:
    """The regression P_fs P_ss⁺ of a cluster's components on the sepset with its parent, (V, f, s).

    s counts the components of the sepset, at the places `shared`, and f the cluster's others, at
    the places `fresh`. `cluster` is the cluster's number, and `inside` its covariance, (V, s + f,
    s + f), the sepset first. If `beliefs` are `TreeBeliefs`, they have kept this matrix from the
    upward pass; it is returned with zeros in the rows of components without variance. With other
    beliefs, or an empty sepset, it is computed from `inside`, by a pseudo-inverse.
    """
    if not isinstance(beliefs, TreeBeliefs) or not shared:
        count = len(shared)
        return regression(inside[:, count:, :count], inside[:, :count, :count])
    level, stack, row = plan.senders[cluster]
    components = plan.levels[level][stack].components[row].tolist()
    drop = plan.levels[level][stack].drop
    rows = [components[:drop].index(place) for place in fresh]
    columns = [components[drop:].index(place) for place in shared]
    gain = beliefs.gains[level][stack][:, row][:, rows][:, :, columns]
    varies = np.diagonal(inside, axis1=-2, axis2=-1)[:, len(shared) :] > 0.0
    return np.where(varies[..., None], gain, 0.0)
