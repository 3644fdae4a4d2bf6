"""Robust noise as machine code is told of it, with the weights of sightings."""

from __future__ import annotations

from operator import attrgetter, itemgetter

import numpy as np

from pgm.beliefs.moments.compiled.functions import loss_of
from pgm.beliefs.moments.compiled.table import Record, Table
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.kernels.machine.sweeps import told


def robust_noise_of(
    sensor: Sensor, table: Table, *, missing: bool, found: bool, controlled: bool
) -> told.Loss:
    """A sensor's robust noise, with the weights of its sightings; `found` as of `told.Loss`.

    `missing` says that components may be missing.
    """
    family, weights = sensor.family, sensor.weights
    counts = range(0 if missing else sensor.height, sensor.height + 1)
    functions = [loss_of(weights.noise, count) for count in counts]
    for each in functions:
        if isinstance(each, str):
            raise Uncompiled(f"{family.cpd!r}: its noise: {each}")
    if controlled and family.expects and family.template is not None:
        raise Uncompiled(f"{family.cpd!r} has robust noise, whose expected losses judge steps")
    weight, surplus, cost = zip(*functions, strict=True)
    kept, squares = (
        table.of(sensor, attrgetter(f"weights.{name}")) for name in ("weight", "square")
    )
    trial = trials_of(sensor) if controlled else ()
    return told.Loss(
        weight,
        surplus,
        cost,
        kept,
        squares,
        expects=family.expects,
        lone=lone(sensor),
        found=found,
        trial=tuple(table.of(table.record, itemgetter(name)) for name in trial),
    )


def lone(sensor: Sensor) -> bool:
    """Whether no step has two sightings."""
    return bool((np.diff(sensor.edges) <= 1).all())


def trials_of(sensor: Sensor) -> tuple[str, str]:
    """The names in a record of the weights, and their squares, that a step control tries."""
    return f"tried weight {sensor.variable.name}", f"tried square {sensor.variable.name}"


def untried(plan: ChainPlan) -> Record:
    """Room for the weights of robust noise that a step control tries."""
    robust = [sensor for sensor in plan.read if sensor.robust]
    names = [name for sensor in robust for name in trials_of(sensor)]
    shapes = [sensor.shape for sensor in robust for _ in range(2)]
    return {name: np.empty(shape) for name, shape in zip(names, shapes, strict=True)}
