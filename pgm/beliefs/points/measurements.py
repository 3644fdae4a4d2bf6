"""The beliefs of a sensor's measurements, without their own values, at points of the states.

The points are particles or cells of a grid, in a cloud for each step. A *row* is a step at which
the sensor may be forecast, or one of its sightings.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.points.cloud import Cloud
from pgm.beliefs.points.model import ParticleModel
from pgm.beliefs.points.point_mixture import Clouds, Measured, PointMixture
from pgm.compile import SliceLayout
from pgm.evidence import Reading
from pgm.kernels.arrays import Array, Integers
from pgm.posteriors.measurements import (
    as_read,
    no_readings,
    read_by,
    require_unread,
    rows_of,
)
from pgm.variables import Variable


def expected(
    model: ParticleModel, layout: SliceLayout, variable: Variable, clouds: Clouds
) -> PointMixture:
    """The beliefs of a sensor's measurements, ``z`` by row or ``z.at(3)``, given clouds by step."""
    reading, rows = rows_of(model.bound, layout, variable)
    steps, law = reading.step[rows], model.law(reading.cpd, reading.inputs)
    found = Measured(law, rows, steps, clouds, steps)
    lead = model.bound.lead
    if variable.step is not None:
        return PointMixture(variable, found, lead)
    return PointMixture(variable, found, (*lead, len(rows)), steps)


def unread(
    model: ParticleModel, layout: SliceLayout, variable: Variable, clouds: Clouds
) -> PointMixture:
    """The belief of a measurement that was not taken, as of `expected`; an EvidenceError else."""
    reading = read_by(model.bound, variable)
    if reading is not None:
        require_unread(variable, reading.step, reading.taken)
    return expected(model, layout, variable, clouds)


def left_out(
    model: ParticleModel, reading: Reading, clouds: Clouds, pareto: Array | None = None
) -> PointMixture:
    """The beliefs of a sensor's readings, each given its own cloud, in the order of the evidence.

    `clouds` are by row of the reading, and so is `pareto`, (rows, runs): see `PointMixture`.
    """
    rows, variable = np.argsort(reading.order), reading.cpd.child
    found = Measured(model.law(reading.cpd, reading.inputs), rows, reading.step[rows], clouds, rows)
    shapes = None if pareto is None else pareto[rows].T.copy()
    lead = *model.bound.lead, len(rows)
    return PointMixture(variable, found, lead, found.steps.copy(), shapes)


def online(model: ParticleModel, cloud: Cloud, variable: Variable, *, alone: bool) -> PointMixture:
    """The beliefs of a sensor's measurements at the step of a cloud, which has none of them.

    The sightings of the model's evidence are to be read: one of them if it stands `alone`.
    """
    (reading,), lead = model.bound.readings, model.bound.lead
    rows = np.argsort(reading.order)
    law, places = model.law(reading.cpd, reading.inputs), np.zeros(len(rows), dtype=np.intp)
    found = Measured(law, rows, reading.step[rows], [cloud], places)
    return PointMixture(variable, found, lead if alone else (*lead, len(rows)))


def readings_of(model: ParticleModel, variable: Variable) -> tuple[Integers, Array]:
    """The steps and values of a sensor's readings, as of `Outcome._readings_of`."""
    reading, lead = read_by(model.bound, variable), model.bound.lead
    if reading is None:
        return no_readings(variable, lead)
    marked = np.where(reading.taken, reading.values, np.nan)
    return as_read(reading.step, reading.order, marked, lead)
