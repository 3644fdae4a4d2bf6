"""Counter-based draws: a random number is a function of a key and a counter, not of a past.

Philox4x64-10 turns a counter of four words and a key of two into four random words, by ten rounds
of multiplication (Salmon, Moraes, Dror & Shaw, Parallel random numbers: as easy as 1, 2, 3, 2011).
A *stream* is the words of successive counters. Whoever knows its first counter can make it anew:
alone or among others, in any order, on any machine. NumPy's own Philox does the work here, so that
other implementations have it as their reference.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from pgm.kernels.arrays import Array

Words = npt.NDArray[np.uint64]
# Words that one counter gives.
BLOCK = 4
# Bits of a word that a uniform leaves out, so that its value and its midpoint are exact.
_SPARE = np.uint64(12)


class Philox:
    """The words of a key's counters.

    The key is NumPy's for the seed, that of ``np.random.Philox(seed)``.
    """

    def __init__(self, seed: int) -> None:
        self._source = np.random.Philox(seed)
        self._state = self._source.state

    @property
    def key(self) -> Words:
        """The key, (2,)."""
        found: Words = self._state["state"]["key"]
        return found

    def words(self, counter: Sequence[int], count: int) -> Words:
        """The first words, (count,), of ``np.random.Philox(key=key, counter=counter)``.

        Setting the counter of one generator takes a sixth of the time of making another.
        """
        self._state["state"]["counter"] = np.array(counter, dtype=np.uint64)
        self._source.state = self._state  # whose buffer is empty, as of a new one
        found: Words = self._source.random_raw(count)
        return found


def uniforms(words: Words) -> Array:
    """Uniform numbers of random words: the midpoints of 2⁵² cells of (0, 1), never 0 or 1."""
    return ((words >> _SPARE).astype(np.float64) + 0.5) * 2.0**-52


def normals(uniform: Array) -> Array:
    """Standard normal numbers of uniform ones in (0, 1), by the inverse of Φ; at most 8.3."""
    from scipy.special import ndtri  # here, since it is slow to import

    found: Array = ndtri(uniform)
    return found


def chi_squares(uniform: Array, dof: float) -> Array:
    """χ² numbers with `dof` degrees of freedom of uniform ones in (0, 1)."""
    from scipy.special import gammaincinv  # here, since it is slow to import

    return np.asarray(2.0 * gammaincinv(0.5 * dof, uniform))
