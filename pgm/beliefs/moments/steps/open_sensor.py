"""Sensors whose sightings are each of one of some candidates, laid out for machine code.

An *open* reading leaves one parent of its sensor unknown: one of k candidates. There the CPD has a
row for each candidate with each sighting, those of a sighting one after another, so that it may
have other noise, or another function called, with each; values, gates and bounds are by sighting.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.evidence import Reading, Unknown
from pgm.kernels import mahalanobis
from pgm.kernels.arrays import Array, stacked


def by_candidate(reading: Reading) -> Reading:
    """An open reading with a row for each candidate with each sighting, but for its values.

    Any other is returned as it is.
    """
    if reading.unknown is None:
        return reading
    parent, unknown = reading.unknown
    count = len(unknown.candidates)
    inputs = {v: np.repeat(values, count, axis=0) for v, values in reading.inputs.items()}
    own = np.tile(unknown.candidates, (len(reading.step), 1))[:, None]
    for values in (*inputs.values(), own):
        values.flags.writeable = False
    return replace(reading, step=np.repeat(reading.step, count), inputs={**inputs, parent: own})


def made_of(reading: Reading, size: int, **named: Any) -> Sensor:
    """The sensor of a reading, with these attributes; a slice has `size` components."""
    if reading.unknown is None:
        return Sensor(**named)
    return OpenSensor(**named, unknown=reading.unknown[1], size=size)


class Chosen(NamedTuple):
    """How a sighting is read with the candidate that was chosen for it, (1, runs, ...).

    It is linearised as `matrix` x + `offset` with the covariance `noise`, and has the `values`,
    NaN if it is of no candidate.
    """

    matrix: Array
    offset: Array
    noise: Array
    values: Array


class Point(NamedTuple):
    """The beliefs at which a sensor's sightings are linearised, by step: (T+1, runs, ...)."""

    mean: Array
    cov: Array


@dataclass(eq=False, kw_only=True)
class OpenSensor(Sensor):
    """A sensor whose sightings leave a parent open; its family has k rows for each of them.

    `unknown` has the candidates; a slice has `size` components.
    """

    unknown: Unknown
    size: int

    @property
    def form(self) -> tuple[int, bool, bool]:
        """How many candidates there are; whether they have a gate, and may all be ruled out."""
        unknown = self.unknown
        gated = unknown.gate is not None
        return len(unknown.candidates), gated, gated or unknown.volume is not None

    @property
    def shares(self) -> Array:
        """The logarithms of the candidates' prior probabilities, (k, 1, 1)."""
        return self.unknown.log_shares[:-2, None, None]

    @property
    def others(self) -> Array:
        """The log-densities of a spurious and of a new sighting, (1, 1, 2)."""
        return self.unknown.log_outliers[None, None]

    @property
    def limits(self) -> Array:
        """The largest squares by how many components were measured, (1, 1, d + 1)."""
        assert self.unknown.gate is not None
        count = np.maximum(np.arange(self.height + 1), 1)
        found: Array = mahalanobis.square_within(self.unknown.gate, count)[None, None]
        return found

    @cached_property
    def alike(self) -> Array:
        """The number of the first candidate of the same value and probability, (k, 1, 1)."""
        every = np.column_stack([self.unknown.candidates, self.unknown.log_shares[:-2]])
        _, first, inverse = np.unique(every, axis=0, return_index=True, return_inverse=True)
        return first[inverse.reshape(-1)].astype(float)[:, None, None]

    @cached_property
    def terms(self) -> Array:
        """By sighting ln p of its innovation and of each candidate, (M, runs, k); −∞ beyond a gate.

        A sweep fills it.
        """
        return stacked(self.shape, (len(self.unknown.candidates),))

    @cached_property
    def chosen(self) -> Chosen:
        """The sighting that a sweep reads, as it leaves it."""
        _, runs, height, size = self.family.shape
        shapes = (height, size), (height,), (height, height), (height,)
        return Chosen(*(stacked((1, runs), shape) for shape in shapes))

    @cached_property
    def point(self) -> Point:
        """The beliefs at which a sweep has linearised, as it leaves them."""
        lead = len(self.bounds) - 1, self.family.shape[1]
        return Point(stacked(lead, (self.size,)), stacked(lead, (self.size, self.size)))
