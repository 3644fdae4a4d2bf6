"""The beliefs of a mixed chain's readings given all readings but their own.

The modes of later steps are not independent of a reading given the state of its step and its mode:
a Gaussian of a step stands for all that may follow, and no likelihood can be divided out of it. So
the chain is smoothed again without each reading, with many of them at a time as runs: copies of the
evidence, each without one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.hypotheses.cases import Given
from pgm.beliefs.hypotheses.measurements import Members, of_rows
from pgm.beliefs.hypotheses.regimes import Regimes
from pgm.compile import SliceLayout
from pgm.evidence import BoundEvidence, Reading
from pgm.factors import Gaussian, GaussianMixture, Table
from pgm.kernels.arrays import Array, Integers, frozen, independent
from pgm.progress import counted

# Runs that are smoothed at a time.
_RUNS = 256

Smoother = Callable[[BoundEvidence], tuple[Given, Members]]


def without_each(
    layout: SliceLayout, regimes: Regimes, bound: BoundEvidence, place: int, smoothed: Smoother
) -> Table | GaussianMixture:
    """The beliefs of a sensor's readings, each left out, in the order of the evidence.

    `place` is that of the sensor among the readings of the evidence, and `smoothed` smooths other
    evidence of the same network.
    """
    reading = bound.readings[place]
    variable, rows = reading.cpd.child, np.argsort(reading.order)
    size, found = max(_RUNS // max(bound.runs, 1), 1), []
    for first in counted(range(0, max(len(rows), 1), size), "readings left out"):
        some = rows[first : first + size]
        copies = bound.repeated(len(some))
        own = _without(copies.readings[place], some, bound.runs)
        readings = (*copies.readings[:place], own, *copies.readings[place + 1 :])
        given, members = smoothed(replace(copies, readings=readings))
        found.append(of_rows(layout, given, regimes, members, variable, own, some))
    if isinstance(found[0], Table):
        values = [_own(each.values, len(bound.lead)) for each in found if isinstance(each, Table)]
        return Table._plain(found[0].scope, frozen(np.concatenate(values, axis=-2)))
    return _joined(found, bound, reading.step[rows])


def _without(reading: Reading, rows: Integers, runs: int) -> Reading:
    """A sensor's readings in copies of all runs, of which each lacks one of some rows."""

    def wide(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        shape = len(array), len(rows) * runs, *array.shape[2:]
        return np.broadcast_to(array, shape).copy()

    values, taken = wide(reading.values), wide(reading.taken)
    for copy, row in enumerate(rows.tolist()):
        values[row, copy * runs : (copy + 1) * runs] = 0
        taken[row, copy * runs : (copy + 1) * runs] = False
    return replace(reading, values=values, taken=taken)


def _own(values: Array, lead: int) -> Array:
    """Of values (copies, *lead, rows, ...), as many rows as copies, each row of its own copy."""
    rows = np.arange(len(values))
    chosen = np.moveaxis(values, lead + 1, 1)[rows, rows]
    return np.moveaxis(chosen, 0, lead)


def _joined(found: Sequence[Any], bound: BoundEvidence, steps: Integers) -> GaussianMixture:
    """The mixtures of all rows, from those of some rows each, in copies of the evidence."""
    lead, most = len(bound.lead), max(each.weights.shape[-1] for each in found)

    def joined(parts: Sequence[Array], axes: int) -> Array:
        """Parts with as many Gaussians, the axis before the last `axes`, some of no weight."""
        every = []
        for part in parts:
            own = _own(part, lead)
            width = [(0, 0)] * own.ndim
            width[own.ndim - 1 - axes] = 0, most - own.shape[-1 - axes]
            every.append(np.pad(own, width))
        return np.concatenate(every, axis=lead)

    mean = joined([each.components.mean for each in found], 1)
    cov = joined([each.components.cov for each in found], 2)
    weights = joined([each.weights for each in found], 0)
    scope = found[0].scope
    cov = independent(cov, np.broadcast_to((weights > 0.0)[..., None], cov.shape[:-1]))
    return GaussianMixture._make(weights, Gaussian._make(scope, mean, cov), steps)
