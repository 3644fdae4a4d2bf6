"""Numbers that random rules draw: keyed by seed, CPD and step, and, if asked, drawn for each run.

Philox is a generator that counts, so that each key has its own stretch of one stream wherever a
call starts: one call for many steps gives what many calls give.
"""

from __future__ import annotations

import zlib
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pgm.kernels.arrays import Array, Integers

Words = npt.NDArray[np.uint64]

# Of a coordinate, as of a uniform number: all that a float below one can hold.
_BITS = 53


def uniform(seed: int, name: str, step: int | Integers, size: int, fresh: bool) -> Array:
    """Numbers in [0, 1), (*axes of step, size).

    Parameters
    ----------
    seed : int
    name : str
        Of the CPD's child.
    step : int or ndarray of int
    size : int
        How many to a step.
    fresh : bool
        Whether entries of equal step get numbers of their own, or the same.
    """
    key = [int(seed), zlib.crc32(name.encode())]
    stretch = -(-size // 4)  # Philox makes four numbers a count

    def draw(counter: int, rows: int) -> Array:
        bits = np.random.Philox(key=key, counter=counter)
        numbers: Array = np.random.Generator(bits).random((rows, 4 * stretch))
        return numbers[:, :size]

    where = np.asarray(step)
    steps, inverse, counts = np.unique(where, return_inverse=True, return_counts=True)
    if not fresh:
        first = int(steps[0])
        drawn = draw(first * stretch, int(steps[-1]) - first + 1)
        return np.asarray(drawn[(steps - first)[inverse.reshape(where.shape)]])
    # Streams of steps lie 2⁶⁴ counts apart, all of them beyond those that runs share. Runs are the
    # last axis and are served one after another, so that more of them change none before.
    streams = [draw((int(s) + 1) << 64, int(n)) for s, n in zip(steps, counts, strict=True)]
    numbers = np.empty((where.size, size))
    by_step = np.argsort(inverse.reshape(where.shape).T, axis=None, kind="stable")
    numbers[by_step] = np.concatenate(streams)
    return np.moveaxis(numbers.reshape(*where.shape[::-1], size), -1, 0).T


def normal(uniforms: Array) -> Array:
    """The standard normal quantile of numbers in [0, 1)."""
    from scipy.special import ndtri  # here, since it is half of the time that importing pgm takes

    quantile: Array = ndtri(np.maximum(uniforms, 2.0**-54))  # zero is none of N(0, 1)
    return quantile


def scrambled_net(uniforms: Array, samples: int, dimension: int) -> Array:
    """Scrambled Sobol points in [0, 1)ⁿ, (..., N, n).

    Each coordinate's binary digits are multiplied by a random lower triangular matrix with ones on
    its diagonal, then shifted by random digits. Every point is uniform, and the points together
    keep the balance of the net.

    Parameters
    ----------
    uniforms : ndarray
        (..., `scrambling_size`), numbers in [0, 1).
    samples, dimension : int

    References
    ----------
    Matoušek, On the L2-discrepancy for anchored boxes, 1998.
    """
    net = _sobol(samples, dimension)
    words = (uniforms * 2.0**_BITS).astype(np.uint64)
    words = words.reshape(*words.shape[:-1], 1, -1, dimension)
    points: Words = np.bitwise_xor(net, words[..., 0, :])
    for digit in range(words.shape[-2] - 1):
        place = np.uint64(_BITS - 1 - digit)
        below = words[..., digit + 1, :] >> np.uint64(digit + 1)
        points ^= ((net >> place) & np.uint64(1)) * below
    return np.asarray(points * 2.0**-_BITS, dtype=np.float64)


def scrambling_size(samples: int, dimension: int) -> int:
    """The number of uniform draws for a scrambling: a shift, and a matrix column for each digit."""
    return (1 + _digits(samples)) * dimension


def _digits(samples: int) -> int:
    """The number of binary digits of a net's coordinates before scrambling."""
    return (int(samples) - 1).bit_length()


@lru_cache(maxsize=16)
def _sobol(samples: int, dimension: int) -> Words:
    from scipy.stats.qmc import Sobol  # here, since scipy.stats is slow to import

    net = Sobol(dimension, scramble=False).random_base2(_digits(samples))[:samples]
    return np.asarray(net * 2.0**_BITS).astype(np.uint64)
