"""The associations of open sightings, averaged over the beliefs of a grid.

A sighting is a measurement of some thing, a parent of its sensor. It is open where that parent is
unknown: it is then of one of k candidates, spurious, or of a new thing. Its associations are the k
+ 2 probabilities of these cases, in this order. A `Reading` has all measurements of one sensor,
sorted by step: a row is one measurement, in all runs. The lattice has an axis of cells for each
component of the states. Beliefs are the probabilities of its cells, (runs, T + 1, *cells).
"""

from __future__ import annotations

from collections.abc import Iterator
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.grid.dependence import centres
from pgm.beliefs.grid.lattice import Lattice
from pgm.beliefs.grid.values import at_a_time, known_at
from pgm.cpds.mixture import UnidentifiedCPD
from pgm.evidence import BoundEvidence, Reading
from pgm.kernels.arrays import Array
from pgm.posteriors.associations import Found, collected

# Cells that are less probable than this share of the most probable one count for nothing.
_NEGLIGIBLE = 1e-12


def associations(lattice: Lattice, bound: BoundEvidence, values: npt.NDArray[Any]) -> Found:
    """By sensor, an `Associations` record of its open sightings in all runs.

    The record has the steps of the M sightings, the probabilities (*runs, M, k + 2) of their
    associations, and the likeliest candidate of each. Sensors without open sightings are left out.

    bound: The evidence, with a `Reading` for each sensor.
    values: The beliefs over which associations are averaged, (runs, T + 1, *cells), the user's axes
        of runs being flattened to one.
    """
    every, lead = ((reading, reading.cpd) for reading in bound.readings), bound.lead
    open_ = [(reading, cpd) for reading, cpd in every if isinstance(cpd, UnidentifiedCPD)]
    return MappingProxyType(
        dict(
            collected(reading, _by_row(lattice, reading, cpd, values), len(cpd.candidates), lead)
            for reading, cpd in open_
        )
    )


def _by_row(
    lattice: Lattice, reading: Reading, cpd: UnidentifiedCPD, values: npt.NDArray[Any]
) -> Iterator[Array]:
    """Yield, for each row of a reading, the associations of that sighting, (runs, k + 2).

    `cpd` is the sensor's CPD, and `values` are the beliefs (runs, T + 1, *cells).
    """
    for row, step in enumerate(reading.step.tolist()):
        yield np.stack(
            [_responsible(lattice, reading, cpd, row, k, v[step]) for k, v in enumerate(values)]
        )


def _responsible(
    lattice: Lattice,
    reading: Reading,
    cpd: UnidentifiedCPD,
    row: int,
    run: int,
    belief: npt.NDArray[Any],
) -> Array:
    """The associations (k + 2,) of one sighting of a run, averaged over the belief (*cells).

    They are Σ_c b(c) p(association | z, c), normalised, b(c) being the belief at the sighting's
    step in the cell c, and z the sighting; NaN where nothing was measured. The sighting is the
    `row` of the `reading`, whose sensor has the CPD `cpd`.
    """

    def of(rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The entry (...) at `row` and `run` of an array (rows, runs or 1, ...) of the reading."""
        return np.asarray(rows[row, run if rows.shape[1] > 1 else 0])

    total = np.zeros(len(cpd.candidates) + 2)
    if not of(reading.taken).any():
        return np.full(len(total), np.nan)
    child = np.where(of(reading.taken), of(reading.values), np.nan)
    inputs = {parent: of(rows) for parent, rows in reading.inputs.items()}
    flat = np.flatnonzero(belief > _NEGLIGIBLE * belief.max())
    length, step = at_a_time(cpd), int(reading.step[row])
    for first in range(0, len(flat), length):
        some = flat[first : first + length]
        cells = np.stack(np.unravel_index(some, lattice.shape), axis=-1)
        points = lattice.values(centres(lattice, cells))
        wide, known = known_at(cpd, child, points, inputs, step)
        total += cpd.responsibilities(wide, known) @ belief.flat[some].astype(np.float64)
    total /= total.sum()
    return total
