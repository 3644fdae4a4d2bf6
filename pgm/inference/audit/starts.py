"""Points from which smoothers look for other modes: mirror images, and points of the prior."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array
from pgm.linearisers.sampled import normal, scrambled_net

# Components of which the mirror image of one alone is a start of its own, at the most.
ALONE = 4
# Dimensions of Sobol's net; further ones are random.
NET = 64


def white_points(count: int, dimension: int) -> Array:
    """Points that fill N(0, I), (C, n), the same in each call.

    They are the normal quantiles of Sobol's net, each point in the middle of its cell.
    """
    known = min(dimension, NET)
    cell = 2.0 ** -(count - 1).bit_length()
    net = scrambled_net(np.zeros(known), count, known) + 0.5 * cell
    rest = np.random.default_rng(0).random((count, dimension - known))
    return normal(np.concatenate([net, rest], axis=1))


def images(answer: Array, about: Array) -> list[Array]:
    """Mirror images 2ρ − μ of means μ (..., n) about others ρ: of all components, then of each.

    Where no more than one component is there, or a network's `ALONE` first are used up, there is
    only the first.
    """
    image, size = 2.0 * about - answer, answer.shape[-1]
    everywhere = np.arange(size)
    alone = range(min(size, ALONE) if size > 1 else 0)
    return [image, *(np.where(everywhere == k, image, answer) for k in alone)]
