"""The rounding of a sweep there and back, by bounds that cost little: whether it surely counts not.

They are those of `digits.certificate`, `digits.reversal_rounding` and `digits.last_places`, which
look more closely where one of these does not suffice.
"""

from __future__ import annotations

from operator import and_, or_
from typing import Any

from pgm.kernels import step
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import most, where
from pgm.kernels.step import AnyMatrix

# Shares of variances that leave the digits that are promised, the squared deviations from zero at
# which the last digit of a mean may count, the part of a variance that rounding may be, and its
# unit.
MODERATE = 1.0 / 2e7
_FAR, _TOLD, _EPS = 1e16, 1e-7, 2.0**-52


class Rounding:
    """The rounding of smoothed covariances, of each run, summed up on the way back."""

    def __init__(self, w: Writer) -> None:
        self._w, self._total = w, w.code.varying(0.0)

    def counts_not(
        self, known: AnyMatrix, later: AnyMatrix, root: Any, smoothed: AnyMatrix
    ) -> Number:
        """Whether a step's smoothed covariance surely has the digits that are promised.

        `known` is the covariance before later measurements, and `later` the predicted one of the
        step after it, with its root. Steps come from the last one on.
        """
        w = self._w
        inflation = step.inflation(later, root)
        self._total.set(self._total.get() + inflation * inflation)
        held = hold(w, known, smoothed)
        if known.shape[0] > 1:
            both = _variances(w, known, smoothed)
            falls = [where(left > 0.0, was / left, 1.0) for was, left in both]
            fallen = most(w.together(most, falls), 1.0)
            held = held & (_EPS * self._total.get() * fallen <= _TOLD)
        found: Number = w.true & held
        return found


def hold(w: Writer, before: AnyMatrix, after: AnyMatrix) -> Any:
    """Whether no variance falls to rounding."""
    both = _variances(w, before, after)
    return w.together(and_, [(left >= MODERATE * was) | (left == 0.0) for was, left in both])


def is_far(w: Writer, mean: AnyMatrix, cov: AnyMatrix) -> Any:
    """Whether the last digit of a mean might count."""
    both = zip(w.matrices.beside(mean), w.matrices.diagonal(cov), strict=True)
    return w.together(or_, [(x * x > _FAR * left) & (left > 0.0) for x, left in both])


def _variances(w: Writer, before: AnyMatrix, after: AnyMatrix) -> list[tuple[Any, Any]]:
    """Variances before and after, side by side."""
    return list(zip(w.matrices.diagonal(before), w.matrices.diagonal(after), strict=True))
