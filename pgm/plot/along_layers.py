"""Where the nodes of ordered layers stand along them, so that links are short and straight."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from pgm.kernels.arrays import Array
from pgm.plot.programme import least

# What a link's slope costs, by how many of its ends are nodes: long arrows are to be straight.
_WEIGHTS = (8.0, 2.0, 1.0)
_LEAN = 1e-4


def along(
    layers: Sequence[Sequence[int]],
    links: Sequence[tuple[int, int]],
    room: Array,
    nodes: int,
) -> Array:
    r"""Places along the layers, which least slope of links asks for.

    .. math:: \min \sum_{ij} w_{ij} |x_i - x_j|
        \quad\text{with}\quad x_j - x_i \ge \tfrac12 (r_i + r_j) \text{ for neighbours in a layer}

    Parameters
    ----------
    layers : sequence of sequence of int
        In order.
    links : sequence of (int, int)
    room : ndarray
        (n,): what each takes of its layer.
    nodes : int
        Numbers below are nodes, the others places where an arrow passes.

    Returns
    -------
    ndarray
        (n,).

    References
    ----------
    Gansner, Koutsofios, North & Vo, A technique for drawing directed graphs, 1993.
    """
    total = len(room)
    beside = [pair for layer in layers for pair in pairwise(layer)]
    minus = [(i, j, k) for k, (i, j) in enumerate(links)]
    minus += [(j, i, k) for i, j, k in minus]
    limit = [0.0] * len(minus) + [-0.5 * (room[i] + room[j]) for i, j in beside]
    minus += [(i, j, -1) for i, j in beside]
    weights = [_WEIGHTS[(i < nodes) + (j < nodes)] for i, j in links]

    def solve(lean: float, end: float | None = None) -> Array:
        cost = np.array([lean] * total + weights)
        return least(cost, np.array(minus, dtype=int).reshape(-1, 3), np.array(limit), end)[:total]

    # Of all the best places, the middle between those furthest left and furthest right.
    left = solve(_LEAN)
    return 0.5 * (left + solve(-_LEAN, float(left.max()) + 1e-6))
