"""Joints of variables that no single cluster or front of a tree holds: means and covariances.

A component's *place* is its index in the vector of all hidden components. V is the number of
covariances: 1 if all runs share them, else the number of runs.
"""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np

from pgm.beliefs.gaussian.beliefs import Beliefs
from pgm.beliefs.gaussian.blocks import Blocks
from pgm.beliefs.gaussian.careful import DenseBeliefs
from pgm.beliefs.gaussian.tree import Hanging, TreeBeliefs, TreePlan
from pgm.clustergraph.structure import Forest
from pgm.kernels.arrays import Array, Integers, transpose
from pgm.kernels.solving import regression


def joint_moments(plan: TreePlan, beliefs: Beliefs, wanted: Integers) -> tuple[Array, Array]:
    """Mean (runs, n) and covariance (V, n, n) of components, which any blocks may hold.

    `wanted` (n,) are the components' places. The results are in the user's units. The covariance P
    is collected from the top of the tree down. Given the components s that it shares with the block
    above it, a block's other components f are independent of the components a above it in the tree.
    So their covariance with these is

        P_fa = P_fs P_ss⁺ P_sa,

    P_ss⁺ being the pseudo-inverse of P_ss.
    """
    if isinstance(beliefs, DenseBeliefs):
        return beliefs.moments(wanted, wanted, wanted)
    places, blocks = beliefs.places, beliefs.places.blocks
    tree = plan.hanging if isinstance(beliefs, TreeBeliefs) else plan.forest
    walk = _walk(tree, blocks, wanted)
    held = {k: blocks.components[blocks.starts[k] : blocks.starts[k + 1]].tolist() for k in walk}
    last = {place: at for at, k in enumerate(walk) for place in held[k]}
    asked = set(wanted.tolist())
    known: list[int] = []
    cov = np.zeros((beliefs.cov.shape[0], 0, 0))
    for at, block in enumerate(walk):
        there = set(known)
        shared = [place for place in held[block] if place in there]
        fresh = [place for place in held[block] if place not in there]
        order = np.array([[*shared, *fresh]], dtype=np.intp)
        inside = beliefs.cov[:, places.of(np.array([block]), order)[1][0]]
        index = {place: k for k, place in enumerate(known)}
        along = cov[:, [index[place] for place in shared]]
        cross = _gain(beliefs, block, inside, shared, fresh) @ along
        cov = np.block([[cov, transpose(cross)], [cross, inside[:, len(shared) :, len(shared) :]]])
        known += fresh
        # What neither the user nor a block further down asks for is dropped.
        keep = [k for k, place in enumerate(known) if place in asked or last[place] > at]
        known = [known[k] for k in keep]
        cov = cov[:, keep][:, :, keep]
    order = np.array([known.index(place) for place in wanted.tolist()])
    scale = beliefs.frame.scale[wanted]
    mean, _ = beliefs.components()
    return mean[:, wanted], cov[:, order][:, :, order] * (scale[:, None] * scale)


def _walk(tree: Hanging | Forest, blocks: Blocks, wanted: Integers) -> list[int]:
    """The blocks that connect the components at places `wanted` (n,), parents before children.

    For each component a block is taken that holds it: the one of fewest components. The result is
    the smallest subtree that connects these blocks; where they are in several trees, it is the
    paths from them to the roots.
    """
    home, _ = blocks.homes
    parent, depth = tree.parent, tree.depth
    ends = {int(home[place]) for place in wanted}
    # Climb from the deepest end until one block is left, or only roots.
    found, front = set(ends), [(-int(depth[k]), -k) for k in ends]
    heapify(front)
    while len(front) > 1:
        deepest = -heappop(front)[1]
        above = int(parent[deepest])
        if above < 0:
            break
        if above not in found:
            found.add(above)
            heappush(front, (-int(depth[above]), -above))
    return sorted(found, key=lambda k: (depth[k], k))


def _gain(
    beliefs: Beliefs, block: int, inside: Array, shared: list[int], fresh: list[int]
) -> Array:
    """The regression P_fs P_ss⁺ of a block's components on those that it shares, (V, f, s).

    s counts the components that the block above holds, at the places `shared`, and f the others, at
    the places `fresh`. `inside` is the block's covariance, (V, s + f, s + f), those shared first.
    If `beliefs` are `TreeBeliefs`, they have kept this matrix from the upward pass; it is returned
    with zeros in the rows of components without variance. With other beliefs, or nothing shared, it
    is computed from `inside`, by a pseudo-inverse.
    """
    if not isinstance(beliefs, TreeBeliefs) or not shared:
        count = len(shared)
        return regression(inside[:, count:, :count], inside[:, :count, :count])
    varies = np.diagonal(inside, axis1=-2, axis2=-1)[:, len(shared) :] > 0.0
    return np.where(varies[..., None], beliefs.gain(block), 0.0)
