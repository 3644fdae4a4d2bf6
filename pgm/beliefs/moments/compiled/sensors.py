"""Sensors as machine code is told of them, sighting by sighting, or as vectors of a step."""

from __future__ import annotations

from operator import attrgetter
from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled.gates import gate_told, has_missing, probability_of
from pgm.beliefs.moments.compiled.groups import Group, Stored
from pgm.beliefs.moments.compiled.linearising import joint_linearising_of
from pgm.beliefs.moments.compiled.robust_noise import robust_noise_of
from pgm.beliefs.moments.compiled.rows import known_at_start, places, row_of, with_known
from pgm.beliefs.moments.compiled.table import Integers64, Table
from pgm.beliefs.moments.steps import gate as gates
from pgm.beliefs.moments.steps.open_sensor import OpenSensor
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.kernels.machine.sweeps import told


def sensor_of(
    plan: ChainPlan,
    sensor: Sensor,
    table: Table,
    *,
    stored: bool,
    keep: bool,
    gate: gates.Asked | None = None,
    controlled: bool = False,
) -> told.Sensor:
    """A sensor with its measurements, and with its gate if gates decide anew.

    `controlled` says that a cost judges where it is linearised.
    """
    family, size = sensor.family, plan.layout.slice_size
    probability = probability_of(sensor, gate, stored=stored)
    missing = has_missing(sensor, gate, stored=stored)
    readings = "moved_marked" if stored else "marked" if probability is None else "given_marked"
    kept = keep and not stored and bool(sensor.variable.angles)
    loss = None
    if sensor.robust:
        flags = {"missing": missing, "found": stored, "controlled": controlled}
        loss = robust_noise_of(sensor, table, **flags)
    held = max(1, *np.diff(sensor.bounds).tolist())
    if isinstance(sensor, OpenSensor):
        held = sensor.form[0]  # the candidates of one sighting
    return told.Sensor(
        **row_of(
            family,
            places(sensor.parents, size),
            table,
            stored=stored,
            keep=keep,
            held=held,
            known=_known(plan, sensor),
        ),
        readings=table.of(sensor, attrgetter(readings)),
        moved=table.of(sensor, attrgetter("moved")) if kept else None,
        missing=missing,
        bounds=None if single(sensor.edges) else table.at_of(sensor, attrgetter("edges")),
        gate=None if probability is None else gate_told(probability, sensor, table),
        loss=loss,
        candidates=_candidates_of(sensor, table) if isinstance(sensor, OpenSensor) else None,
    )


def _candidates_of(sensor: OpenSensor, table: Table) -> told.Candidates:
    """The candidates of a sensor's sightings, and the arrays for the one that is chosen."""
    count, gated, rejects = sensor.form

    def array(name: str) -> told.Array:
        return table.of(sensor, attrgetter(name))

    return told.Candidates(
        count=count,
        shares=array("shares"),
        others=array("others"),
        limits=array("limits") if gated else None,
        alike=array("alike"),
        terms=array("terms"),
        matrix=array("chosen.matrix"),
        offset=array("chosen.offset"),
        noise=array("chosen.noise"),
        values=array("chosen.values") if rejects else None,
        point=(array("point.mean"), array("point.cov")),
    )


def vector_of(
    plan: ChainPlan, group: Group, table: Table, *, stored: bool, keep: bool
) -> told.Sensor:
    """A sensor whose sightings of a step are one vector, with its measurements."""

    def array(name: str) -> told.Array:
        return table.of(group, attrgetter(name))

    sensor, whole = group.sensor, single(group.edges)
    found: dict[str, Any]
    if stored:
        found = {name: array(f"known.{name}") for name in Stored._fields}
    else:
        own = np.flatnonzero(sensor.variable.angle_mask).tolist()
        found = with_known(joint_linearising_of(group, table), _known(plan, sensor))
        found["angles"] = tuple(k * sensor.height + i for k in range(group.most) for i in own)
        found["noise"], found["readings"] = array("own_noise"), array("readings")
        if keep:
            found["matrix"], found["offset"] = array("matrix"), array("offset")
            found["kept"] = array("noise")
            found["moved"] = array("moved") if own else None
    return told.Sensor(
        parents=places(sensor.parents, plan.layout.slice_size),
        height=group.height,
        missing=True,
        bounds=None if whole else table.at_of(group, attrgetter("edges")),
        **found,
    )


def _known(plan: ChainPlan, sensor: Sensor) -> tuple[int, ...]:
    """The components of a sensor's parents that may have no variance at the first step."""
    return tuple(np.flatnonzero(known_at_start(plan)[sensor.parents]).tolist())


def single(edges: Integers64) -> bool:
    """Whether each step has one sighting, or one vector of sightings, beginning at these."""
    return bool((np.diff(edges) == 1).all())
