"""Sensors: their measurements, with gates, robust noise, and candidates."""

from __future__ import annotations

from dataclasses import dataclass

from pgm.kernels.machine.emitter.functions import Function
from pgm.kernels.machine.sweeps.told.rows import Row
from pgm.kernels.machine.sweeps.told.table import Array


@dataclass(frozen=True)
class Gate:
    """A gate, which rejects sightings that are far from their prediction.

    `limits` (height + 1,) are the largest squares by how many components were measured; `squares`
    are kept by row, and `rejected` are 1 of a sighting that is rejected, else 0.
    """

    limits: Array
    squares: Array
    rejected: Array


@dataclass(frozen=True)
class Loss:
    """A robust noise: sightings count with R / w, and the weight w is a function of a square.

    `weight(s)` and `surplus(s, w)`, the log-density less that of N(0, R / w), are traces by how
    many components were measured; of just the last where none may be missing. Weights and the
    squares that they are of are kept by row, those of a step control's trials in `trial`. `cost(s)`
    is twice the loss. `expects` says that squares are expected under the belief; `lone` that no
    step has two sightings; `found` that weights are as kept, and only the surplus is due.
    """

    weight: tuple[Function, ...]
    surplus: tuple[Function, ...]
    cost: tuple[Function, ...]
    weights: Array
    squares: Array
    expects: bool
    lone: bool
    found: bool
    trial: tuple[Array, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Candidates:
    """The candidates of a sensor whose sightings are each of one of them, or of none.

    Attributes
    ----------
    count : int
        How many there are, k. The CPD has a row for each with each sighting: sighting s and
        candidate j are at row s k + j.
    shares : Array
        By candidate, the logarithm of its prior probability, (1,).
    others : Array
        The log-densities of what is of none, each with its probability, (2,).
    limits : Array or None
        The largest squares (height + 1,) by how many components were measured; None without a gate.
    alike : Array
        By candidate, the number of the first one that is the same, (1,).
    terms : Array
        Where the log-density of a sighting with each candidate is put, with its probability, (k,).
    matrix, offset, noise : Array
        Where the linearisation with the candidate that was chosen last is put.
    values : Array or None
        Where a sighting's values are put, NaN of one of none; None if there can be no such.
    point : tuple of Array
        Where, by step, means and covariances are put at which sightings are linearised.
    """

    count: int
    shares: Array
    others: Array
    limits: Array | None
    alike: Array
    terms: Array
    matrix: Array
    offset: Array
    noise: Array
    values: Array | None
    point: tuple[Array, Array]


@dataclass(frozen=True, kw_only=True)
class Sensor(Row):
    """A sensor, a row a sighting, or several: one for each of some `candidates`.

    Attributes
    ----------
    readings : Array
        The values (d,); NaN is missing, where `missing` says that some may be.
    moved : Array or None
        Where values are kept, with their angles on the branch of the linearisation.
    bounds : int or None
        The place in the table of the address of the first sighting of each step, and one more;
        None if each step has one.
    gate : Gate or None
        Of a sweep that rejects sightings.
    loss : Loss or None
        Of robust noise.
    candidates : Candidates or None
        Of sightings that leave open of what they are.
    """

    readings: Array
    moved: Array | None = None
    missing: bool = False
    bounds: int | None = None
    gate: Gate | None = None
    loss: Loss | None = None
    candidates: Candidates | None = None

    @property
    def weighs(self) -> bool:
        """Whether weights of robust noise are to be found."""
        return self.loss is not None and not self.loss.found
