"""Evidence laid out by step: arrays with the time axis first and the runs second."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from pgm.cpds import ConditionalGaussian
from pgm.factors.runs import flat
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Variable

# Values of parents with evidence, (rows, runs or 1, d): a row is a step or a sighting.
Inputs = Mapping[Variable, Array]
Kind = TypeVar("Kind", np.float64, np.bool_)


@dataclass(frozen=True, eq=False)
class Reading:
    """All readings of one sensor, sorted by step.

    Attributes
    ----------
    cpd : CPD
        The sensor.
    step : ndarray of int
        (M,), ascending.
    order : ndarray of int
        (M,): which row of the user's evidence each one was.
    values : ndarray
        (M, runs or 1, d); zero where missing.
    taken : ndarray of bool
        (M, runs or 1, d): which components were; the others are missing.
    inputs : mapping of Variable to ndarray
        Values of the sensor's observed parents, (M, runs or 1, d).
    """

    cpd: ConditionalGaussian
    step: Integers
    order: Integers
    values: Array
    taken: Mask
    inputs: Inputs


@dataclass(frozen=True, eq=False)
class BoundEvidence:
    """Evidence laid out by step.

    Attributes
    ----------
    steps : int
        T.
    lead : tuple of int
        The leading axes, of runs; inside, they are flattened to one.
    transition : tuple of mapping
        For each transition CPD the values of its observed parents, (T, runs or 1, d); row k is
        that of step k + 1.
    readings : tuple of Reading
        Of the sensors that have evidence.
    first_run : int
        What the first run is called in messages: where these runs are a part of more, its place.
    """

    steps: int
    lead: tuple[int, ...]
    transition: tuple[Inputs, ...]
    readings: tuple[Reading, ...]
    first_run: int = 0

    @property
    def runs(self) -> int:
        """Number of runs."""
        return math.prod(self.lead)


def by_row(array: npt.NDArray[Kind], lead: tuple[int, ...]) -> npt.NDArray[Kind]:
    """A copy of an array (..., rows, d) as (rows, runs or 1, d), as `stacked`: runs fastest.

    Read-only, since functions of users see it.
    """
    memory = np.array(flat(array, lead, 2).transpose(1, 2, 0), order="C")
    rows = memory.transpose(0, 2, 1)
    rows.flags.writeable = False
    return rows


def reading_by_row(reading: Reading, lead: tuple[int, ...]) -> Reading:
    """A reading whose arrays have the user's axes, with the axes of runs as one, rows first."""
    return replace(
        reading,
        values=by_row(reading.values, lead),
        taken=by_row(reading.taken, lead),
        inputs={v: by_row(a, lead) for v, a in reading.inputs.items()},
    )
