"""Exact order statistics of more numbers than memory holds, found digit by digit.

The bits of a float64, its sign turned, are in the order of the numbers. Each pass over the numbers
counts one digit of 16 bits of those that share the digits found before: four passes find a number
of any rank, exactly, whatever the order in which the numbers come.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Keys = npt.NDArray[np.uint64]

_BITS, PASSES = 16, 4
_SIGN = np.uint64(1 << 63)


def _keys(values: Array) -> Keys:
    bits = (values + 0.0).view(np.uint64)  # of −0 as of 0
    return np.where(bits & _SIGN, ~bits, bits | _SIGN)


def _value(key: int) -> float:
    sign = int(_SIGN)
    bits = key ^ sign if key & sign else key ^ (2**64 - 1)
    return float(np.array(bits, np.uint64).view(np.float64))


@dataclass
class Quantiles:
    """Quantiles of numbers that come in pieces, in four passes over all of them.

    Parameters
    ----------
    probabilities : sequence of float
        From 0, the least number, to 1.
    """

    probabilities: Sequence[float]
    _pass: int = 0
    _ranks: dict[int, tuple[int, int]] = field(default_factory=dict)  # digits and rank among them
    _counts: dict[int, npt.NDArray[np.int64]] = field(default_factory=dict)
    _count: int = 0

    def add(self, values: Array) -> None:
        """A piece of the numbers, of this pass; none is NaN."""
        keys = _keys(values)
        shift = np.uint64(_BITS * (PASSES - 1 - self._pass))
        digits = (keys >> shift) & np.uint64(2**_BITS - 1)
        if not self._pass:
            self._count += len(values)
            self._tally(0, digits)
            return
        leading = keys >> (shift + np.uint64(_BITS))
        for found in {found for found, _ in self._ranks.values()}:
            self._tally(found, digits[leading == np.uint64(found)])

    def end_pass(self) -> None:
        """All numbers have come once more."""
        if not self._pass:
            ranks = {rank for each in self.probabilities for rank in self._between(each)[:2]}
            self._ranks = {rank: (0, rank) for rank in ranks} if self._count else {}
        for rank, (found, among) in self._ranks.items():
            below = np.cumsum(self._counts[found])
            digit = int(np.searchsorted(below, among, side="right"))
            left = among - (int(below[digit - 1]) if digit else 0)
            self._ranks[rank] = (found << _BITS | digit, left)
        self._counts = {}
        self._pass += 1

    def values(self) -> Array:
        """The quantiles, linear between ranks, after four passes; NaN of no numbers."""
        if not self._count:
            return np.full(len(self.probabilities), np.nan)
        found = []
        for each in self.probabilities:
            low, high, part = self._between(each)
            a, b = _value(self._ranks[low][0]), _value(self._ranks[high][0])
            found.append(a + (b - a) * part if part < 0.5 else b - (b - a) * (1.0 - part))
        return np.array(found)

    def _tally(self, found: int, digits: Keys) -> None:
        counts = np.bincount(digits.astype(np.int64), minlength=2**_BITS)
        self._counts[found] = self._counts.get(found, 0) + counts

    def _between(self, probability: float) -> tuple[int, int, float]:
        at = probability * (self._count - 1)
        low = int(np.floor(at))
        return low, min(low + 1, self._count - 1), at - low
