"""Vertices of a pose graph whose file has edges alone, placed along a tree of these."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order

from pgm.kernels import rigid, twists
from pgm.kernels.arrays import Array, Mask
from pgm.recordings.drives.pose_graph import Edges


def poses(edges: Edges, count: int, root: int) -> tuple[Array, Mask]:
    """Poses (N, 3) composed along edges from a root at (0, 0, 0), and the mask of those reached.

    An edge that measures the motion z = (p, φ) leads from x = (q, θ) on to its second end at

        x ⊕ z = (q + R(θ) p, θ + φ),

    and from its second end back to x by ⊖z. The tree is breadth-first, so that no other composes
    fewer motions to a pose; of several edges between two poses the file's first is taken.
    """
    ends = np.column_stack([edges.first, edges.second])
    # Edges are numbered from 1: an entry of 0 would be none.
    pairs, row = np.unique(np.sort(ends, axis=1), axis=0, return_index=True)
    joined = coo_array((row + 1, (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()
    order, parents = breadth_first_order(joined, root, directed=False)
    back, _ = twists.inverse(edges.motions)
    found = np.zeros((count, 3))
    edge_of = dict(zip(map(tuple, pairs.tolist()), row.tolist(), strict=True))
    for child in order[1:].tolist():
        parent = int(parents[child])
        edge = edge_of[min(parent, child), max(parent, child)]
        motion = edges.motions[edge] if edges.first[edge] == parent else back[edge]
        found[child, :2] = found[parent, :2] + rigid.turned(motion[:2], found[parent, 2])
        found[child, 2] = found[parent, 2] + motion[2]
    reached = np.zeros(count, dtype=bool)
    reached[order] = True
    return found, reached


def landmarks(poses: Array, sightings: Edges, count: int) -> Array:
    """Places (L, 2) of landmarks by the first sighting of each, q + R(θ) p."""
    found = np.zeros((count, 2))
    seen, row = np.unique(sightings.second, return_index=True)
    at = poses[sightings.first[row]]
    found[seen] = at[:, :2] + rigid.turned(sightings.motions[row], at[:, 2])
    return found
