"""The rounding of a sweep there and back, by bounds that cost little: whether it surely counts not.

They are those of `digits.certificate`, `digits.reversal_rounding` and `digits.last_places`, which
look more closely where one of these does not suffice.
"""

from __future__ import annotations

from typing import Any

from pgm.kernels import step
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import Matrix, most, where

# Shares of variances that leave the digits that are promised, the squared deviations from zero at
# which the last digit of a mean may count, the part of a variance that rounding may be, and its
# unit.
MODERATE = 1.0 / 2e7
_FAR, _TOLD, _EPS = 1e16, 1e-7, 2.0**-52


class Rounding:
    """The rounding of smoothed covariances, of each run, summed up on the way back."""

    def __init__(self, w: Writer) -> None:
        self._w, self._total = w, w.code.varying(0.0)

    def counts_not(self, known: Matrix, later: Matrix, smoothed: Matrix) -> Number:
        """Whether a step's smoothed covariance surely has the digits that are promised.

        `known` is the covariance before later measurements, and `later` the predicted one of the
        step after it. Steps come from the last one on.
        """
        inflation = step.inflation(later)
        self._total.set(self._total.get() + inflation * inflation)
        fallen: Any = self._w.code.constant(1.0)
        for was, left in zip(known.diagonal, smoothed.diagonal, strict=True):
            fallen = most(where(left > 0.0, was / left, 1.0), fallen)
        held = hold(known, smoothed)
        if len(known.rows) > 1:
            held = held & (_EPS * self._total.get() * fallen <= _TOLD)
        found: Number = self._w.true & held
        return found


def hold(before: Matrix, after: Matrix) -> Any:
    """Whether no variance falls to rounding."""
    found: Any = True
    for was, left in zip(before.diagonal, after.diagonal, strict=True):
        found = ((left >= MODERATE * was) | (left == 0.0)) & found
    return found


def is_far(mean: Matrix, cov: Matrix) -> Any:
    """Whether the last digit of a mean might count."""
    found: Any = False
    for (x,), left in zip(mean.rows, cov.diagonal, strict=True):
        found = ((x * x > _FAR * left) & (left > 0.0)) | found
    return found
