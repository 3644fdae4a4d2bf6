"""Gates of sweeps in machine code: their limits, and their decisions."""

from __future__ import annotations

from operator import attrgetter, itemgetter

import numpy as np

from pgm.beliefs.moments.compiled.table import Record, Table
from pgm.beliefs.moments.steps import gate as gates
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.kernels.machine.sweeps import told
from pgm.schedules.gates import gate_of


def probability_of(sensor: Sensor, gate: gates.Asked | None, *, stored: bool) -> float | None:
    """The probability of a sensor's gate, None where a sweep does not gate it."""
    return None if gate is None or stored else gate_of(gate, sensor.variable)


def has_missing(sensor: Sensor, gate: gates.Asked | None, *, stored: bool) -> bool:
    """Whether components are missing of a sensor's sightings, before its gate decides."""
    taken = sensor.taken
    if probability_of(sensor, gate, stored=stored) is not None:
        assert sensor.gated is not None
        taken = sensor.gated.given
    return taken is not None and not taken.all()


def gate_told(probability: float, sensor: Sensor, table: Table) -> told.Gate:
    """A sensor's gate, whose decisions are gathered in the record; see `decided`."""
    limits = gates.limits(probability, sensor.height)[None, None]
    return told.Gate(
        table.of(sensor, lambda _: limits),
        table.of(sensor, attrgetter("gated.square")),
        table.of(table.record, itemgetter(rejected_by(sensor))),
    )


def rejected_by(sensor: Sensor) -> str:
    """The name in a record of a gate's decisions."""
    return f"rejected {sensor.variable.name}"


def undecided(plan: ChainPlan, gate: gates.Asked | None, *, stored: bool) -> Record:
    """Room for the gates' decisions of a sweep: 1 of a sighting that is rejected, else 0."""
    return {
        rejected_by(sensor): np.zeros(sensor.shape)
        for sensor in plan.read
        if probability_of(sensor, gate, stored=stored) is not None
    }


def decided(plan: ChainPlan, record: Record) -> None:
    """Record the gates' decisions of a sweep in the plan's sensors."""
    for sensor in plan.read:
        rejected = record.get(rejected_by(sensor))
        if rejected is not None:
            assert sensor.gated is not None
            assert sensor.taken is not None
            sensor.gated.rejected[...] = rejected != 0.0
            sensor.taken[...] = sensor.gated.given & ~sensor.gated.rejected[..., None]
