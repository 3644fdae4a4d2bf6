"""Points from which smoothers look for other modes: mirror images, and points of the prior."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array
from pgm.linearisers.sampled import normal

# At most so many components are mirrored alone, each for a start of its own.
ALONE = 4


def white_points(count: int, dimension: int) -> Array:
    """Points that fill N(0, I) evenly, (C, n), the same in each call: C is `count`, n `dimension`.

    Each component takes each of the C quantiles (k + ½)/C once, in an order of its own: a Latin
    hypercube (McKay, Beckman & Conover, 1979).
    """
    order = np.random.default_rng(0).permuted(np.tile(np.arange(count), (dimension, 1)), axis=1)
    return normal((order.T + 0.5) / count)


def images(answer: Array, about: Array) -> list[Array]:
    """Mirror images 2ρ − μ of means μ, `answer`, about ρ, `about`, all arrays of shape (..., n).

    The first image mirrors all components. Unless n is 1, it is followed by images that mirror one
    component alone, for each of the first four; their other components are those of μ.
    """
    image, size = 2.0 * about - answer, answer.shape[-1]
    everywhere = np.arange(size)
    alone = range(min(size, ALONE) if size > 1 else 0)
    return [image, *(np.where(everywhere == k, image, answer) for k in alone)]
