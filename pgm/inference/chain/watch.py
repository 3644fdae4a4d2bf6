"""The ratios of the certificate, measured during a sweep of many runs that keeps no predictions."""

from __future__ import annotations

import numpy as np

from pgm.kernels import along_runs
from pgm.kernels.arrays import Array

# Between readings that are mild, beliefs are looked at every so many steps, at the last, and where
# a variance has grown by so much since.
_EVERY, _GROWN = 8, 1e2


class Watch:
    """How close components come to being determined by others.

    Attributes
    ----------
    closest : float
        The smallest share of a variance that the components before it leave open, or that a sharp
        reading leaves. Beliefs are looked at before and after sharp readings, where variances have
        grown, and at some steps between.
    """

    def __init__(self) -> None:
        self.closest, self._step = 1.0, 0
        self._level: Array | float = np.inf

    def look(self, predicted: Array, known: Array, mild: bool, *, last: bool) -> None:
        """Look at the covariances (n, n, runs) of a step, before and after its readings."""
        spread = np.einsum("iir->ir", predicted)
        regular = mild and not (spread > _GROWN * self._level).any()
        if not regular:
            self._level = spread.copy()
            self._see(along_runs.open_share(predicted.copy()))
        if not mild:
            self._see(along_runs.least_left(predicted, known))
        if not self._step:
            self._level = np.einsum("iir->ir", known).copy()
        if not regular or last or (self._step and self._step % _EVERY == 0):
            self._level = np.minimum(self._level, np.einsum("iir->ir", known))
            self._see(along_runs.open_share(known.copy()))
        self._step += 1

    def _see(self, share: float) -> None:
        self.closest = min(self.closest, share)
