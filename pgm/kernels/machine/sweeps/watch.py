"""A watch over a sweep: how little of a variance is ever left, as the `Watch` of NumPy's passes."""

from __future__ import annotations

from operator import or_

from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.variables import held
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import least, where
from pgm.kernels.step import AnyMatrix

# Beliefs are looked at every so many steps, where measurements leave less than a thousandth, and
# where a variance has grown a hundredfold since.
_EVERY, _MILD, _GROWN = 8, 1e-3, 1e2
# The square of deviations from zero in which the last digit of a mean might count.
_FAR = 1e16


class Watch:
    """The least share of a variance so far, and whether a mean is far from zero, of each run."""

    def __init__(self, w: Writer, size: int) -> None:
        self._w = w
        self._closest, self._far = w.code.varying(1.0), w.code.varying(False)
        self._levels = [held(w.code, x) for x in w.matrices.alike(float("inf"), size)]

    @property
    def closest(self) -> Number:
        """The least share."""
        return self._closest.get()

    @property
    def far(self) -> Number:
        """Whether a mean was far from zero."""
        return self._far.get()

    def look(
        self, at: Whole, last: Whole, mean: AnyMatrix, before: AnyMatrix, after: AnyMatrix
    ) -> None:
        """Look at the covariances of a step, before and after its measurements."""
        w, m = self._w, self._w.matrices
        shares, growths, distances = [w.code.constant(1.0)], [], []
        pairs = list(zip(m.diagonal(before), m.diagonal(after), strict=True))
        for (was, left), level, x in zip(pairs, self._levels, m.beside(mean), strict=True):
            growths.append(was > _GROWN * level.get())
            sharp = (left < _MILD * was) & (left != 0.0) & (was > 0.0)
            shares.append(where(sharp, left / was, 1.0))
            distances.append((x * x > _FAR * left) & (left > 0.0))
        share, grown = w.together(least, shares), w.together(or_, growths)
        self._far.set(self.far | w.together(or_, distances))
        doubtful = grown | (share < 1.0)
        often = (at == last) | (at % _EVERY == 0)
        closest = held(w.code, share)
        for (was, left), level in zip(pairs, self._levels, strict=True):
            known = where(doubtful, was, level.get())
            known = where(at == 0, left, known)
            low = (doubtful | often) & (left < known)
            level.set(where(low, left, known))
        with w.code.when(w.code.some(doubtful)), m.scratch():
            found = w.open_share(before)
            closest.set(where(doubtful & (found < closest.get()), found, closest.get()))
        with w.code.when(w.code.some(doubtful | often)), m.scratch():
            found = w.open_share(after)
            closest.set(where((doubtful | often) & (found < closest.get()), found, closest.get()))
        self._closest.set(least(closest.get(), self.closest))
