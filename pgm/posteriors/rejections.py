"""The record of a gate, as users see it: which measurements of a sensor it has rejected."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgm.display import Listing, Shown, Summary, number, places, whereabouts
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.posteriors.by_sensor import EachSensor
from pgm.posteriors.gate_record import GateRecord
from pgm.variables import Variable


class Rejections(Shown, Immutable):
    """The decisions of one sensor's gate about its M measurements, in the order of the evidence.

    Attributes
    ----------
    gate : float
        The gate's probability: a measurement was taken in if `square` was within its χ² quantile.
    step : ndarray of int
        (M,): the steps of the measurements.
    rejected : ndarray of bool
        (..., M): whether a measurement was left out. Leading axes are runs.
    square : ndarray
        (..., M): νᵀS⁻¹ν, the squared length of the innovation at the predicted belief; NaN where
        nothing was measured.

    Examples
    --------
    >>> import pgm
    >>> from pgm.examples import walk, z
    >>> found = pgm.filter(walk, {z: [[1.0], [30.0]]}, gate=0.99).rejected[z]
    >>> found.rejected
    array([False,  True])
    >>> print(found)
    Rejections(1 of 2 sightings, gate 0.99, steps 2..2)
      step  squared innovation
      2                    218
    """

    gate: float
    step: Integers
    rejected: Mask
    square: Array

    def __init__(self, gate: float, step: Integers, rejected: Mask, square: Array) -> None:
        for array in (step, rejected, square):
            array.flags.writeable = False
        self._set(gate=gate, step=step, rejected=rejected, square=square)

    @classmethod
    def of(
        cls, record: GateRecord, step: Integers, order: Integers, lead: tuple[int, ...]
    ) -> Rejections:
        """The decisions in a record (M, runs), put in the order of the evidence.

        Row k of the record, at the k-th step of `step`, is measurement ``order[k]`` of the
        evidence; `lead` is the shape of the user's leading axes of runs.
        """
        back = np.argsort(order)
        shape = *lead, len(order)
        rejected, square = record.rejected[back].T, record.square[back].T
        return cls(
            record.gate, step[back], rejected.reshape(shape).copy(), square.reshape(shape).copy()
        )

    @property
    def _title(self) -> str:
        measured, found = int((~np.isnan(self.square)).sum()), int(self.rejected.sum())
        steps = self.step[self.rejected.reshape(-1, len(self.step)).any(axis=0)]
        where = f", steps {steps.min()}..{steps.max()}" if found else ""
        return f"Rejections({found:,} of {measured:,} sightings, gate {self.gate:g}{where})"

    def _summary(self) -> Summary:
        each = np.argwhere(self.rejected)
        heads, where = whereabouts(self.rejected.shape, self.step)
        rows: list[Sequence[str] | None] = []
        for at in places((len(each),)):
            if at is None:
                rows.append(None)
                continue
            place = tuple(int(k) for k in each[at[0]])
            rows.append([*where(place), number(self.square[place], 3)])
        heads = [*heads, "squared innovation"]
        return Summary(self._title, [Listing(heads, rows, names=len(heads) - 1)] if rows else [])


class RejectionsBySensor(EachSensor[Rejections]):
    """The gate's decisions (`Rejections`) by sensor, of each that has a gate and measurements."""

    def _absent(self, variable: Variable) -> str:
        told = f"gates were those of {list(self)}" if self else "give gate=0.99 or so"
        return f"no gate has decided about {variable!r}; {told}"

    def _summary(self) -> Summary:
        return Summary(self._title, [f"{v!r}: {found._title}" for v, found in self.items()])
