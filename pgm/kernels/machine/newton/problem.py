"""A Gauss–Newton step as machine code is told of it; see `pgm.kernels.machine.sweeps.told`."""

from __future__ import annotations

from dataclasses import dataclass

from pgm.kernels.machine.sweeps.told.rows import Row
from pgm.kernels.machine.sweeps.told.table import Array


@dataclass(frozen=True, kw_only=True)
class Squares(Row):
    """A CPD as squares of a least-squares problem, of which some rows are linearised together.

    Rows take the place of runs in its arrays, and runs that of rows. `noise` is the inverse of the
    covariance, zero where nothing is measured, and `parents` are places in a slice, those of the
    next one behind.

    Attributes
    ----------
    child : tuple of int
        The places of a transition's child in the slices; empty of a measurement.
    lanes : int
        How many rows are linearised together; there are as many at least.
    count : int
        The place in the table of the number of rows.
    readings, moved, missing, bounds
        As of `Sensor`.
    steps : int or None
        The place in the table of the address of each row's step; None if each step has one row.
    """

    child: tuple[int, ...]
    lanes: int
    count: int
    readings: Array | None = None
    moved: Array | None = None
    missing: bool = False
    bounds: int | None = None
    steps: int | None = None


@dataclass(frozen=True, kw_only=True)
class Newton:
    """A Gauss–Newton step of all steps of a chain.

    Attributes
    ----------
    size : int
        The components of a slice.
    rows : tuple of Squares
    active : Array
        Whether a run is worked on, (1,).
    begin : Array
        The first slice's equations by the prior, as an `equations.Layout` has them.
    reference, found, variance : Array
        The trajectory at which CPDs are linearised, the one that is found, and the variances of its
        components.
    """

    size: int
    rows: tuple[Squares, ...]
    active: Array
    begin: Array
    reference: Array
    found: Array
    variance: Array
