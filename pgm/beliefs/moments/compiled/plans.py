"""Plans of chains, as machine code is told of them: what decides their code, and their arrays.

An *owner* is a CPD of the transition, a sensor, or the record of a sweep, by its number: owners
stand in this order. Arrays are told of by how their owner is asked for them.
"""

from __future__ import annotations

from collections.abc import Hashable
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled.functions import function_of, loss_of, points_of
from pgm.beliefs.moments.compiled.table import Table
from pgm.beliefs.moments.steps import gate as gates
from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile.machine import MOST, RULES
from pgm.kernels.arrays import Array, Index
from pgm.kernels.machine import told
from pgm.linearisation.family import Family
from pgm.linearisers import Taylor
from pgm.schedules.gates import gate_of

# By name the arrays that a sweep fills or reads beside those of CPDs and sensors.
Record = dict[str, Array]


class Uncompiled(Exception):
    """A plan that machine code cannot sweep, and why."""


def places(index: Index, size: int) -> tuple[int, ...]:
    """The places that an index says."""
    return tuple(np.arange(size)[index].tolist())


def unknown(plan: ChainPlan) -> str | None:
    """Why machine code does not know a plan, but for functions that are not linearised yet."""
    for sensor in plan.read:
        if sensor.robust and sensor.weights.noise.graduated:
            return f"{sensor.family.cpd!r} has graduated noise"
        if sensor.exact:
            return f"{sensor.family.cpd!r} has a singular noise"
        if sensor.grouped and max(np.diff(sensor.bounds)) > 1:
            return f"{sensor.family.cpd!r} has several sightings in a group"
    for family in plan.families:
        if max(family.cpd.child.dimension, family.shape[3]) > MOST:
            return f"{family.cpd!r} has more than {MOST} components"
    return None


def decisive(plan: ChainPlan, *, stored: bool, keep: bool, gate: gates.Asked | None) -> tuple[Hashable, ...]:
    """What decides the code of a plan's forward sweep, beside the places of its CPDs.

    Functions are traced, if they were not, and CPDs made ready to keep errors of linearisations.
    """
    rows: list[Hashable] = [
        (_function(link.family, stored=stored, keep=keep), len(link.turning))
        for link in plan.transition
    ]
    rows += [
        (
            _function(sensor.family, stored=stored, keep=keep),
            sensor.family.cpd,
            _gate(sensor, gate, stored=stored),
            _missing(sensor, gate, stored=stored),
            _single(sensor, plan.steps),
        )
        for sensor in plan.read
    ]
    return (*rows, stored, keep)


def _function(family: Family, *, stored: bool, keep: bool) -> Hashable:
    """What decides how a CPD is linearised."""
    bare = family.bare if family.noisy else None
    weighed = family.cpd.noise is not None
    if stored or family.template is None:
        if keep and weighed and not stored:
            family.keep_errors()
        return bare
    answers, rule = family.trace_whole(), family.lineariser
    if isinstance(answers, str):
        raise Uncompiled(f"{family.cpd!r}: {answers}")
    if family.hidden and type(rule) is not Taylor and type(rule) not in RULES:
        raise Uncompiled(f"{family.cpd!r}: {points_of(family)}")
    if keep and (weighed or _has_points(family)):
        family.keep_errors()
    return answers.trace, rule, bare


def _has_points(family: Family) -> bool:
    return bool(family.hidden) and type(family.lineariser) is not Taylor


def _gate(sensor: Sensor, gate: gates.Asked | None, *, stored: bool) -> float | None:
    return None if gate is None or stored else gate_of(gate, sensor.variable)


def _missing(sensor: Sensor, gate: gates.Asked | None, *, stored: bool) -> bool:
    taken = sensor.taken
    if _gate(sensor, gate, stored=stored) is not None:
        assert sensor.gated is not None
        taken = sensor.gated.given
    return taken is not None and not taken.all()


def _single(sensor: Sensor, steps: int) -> bool:
    return sensor.bounds == list(range(steps + 2))


def motion_of(
    plan: ChainPlan, owner: int, link: Link, table: Table, *, stored: bool, keep: bool
) -> told.Motion:
    """A CPD of the transition."""
    layout, family = plan.layout, link.family
    size = layout.state_size + layout.slice_size
    turning: tuple[tuple[int, int, int], ...] = ()
    if link.turning and not stored:
        own = places(link.parents, size)
        if any(before not in own for before in link.before.tolist()):
            raise Uncompiled(f"{family.cpd!r} turns an angle of which its function does not know")
        turning = tuple((new, before, own.index(before)) for new, before in link.turning)
    return told.Motion(
        **_row(owner, family, places(link.parents, size), table, stored=stored, keep=keep),
        bare=family.bare,
        unsure=not family.semidefinite,
        turning=turning,
    )


def sensor_of(
    plan: ChainPlan,
    owner: int,
    sensor: Sensor,
    table: Table,
    *,
    stored: bool,
    keep: bool,
    gate: gates.Asked | None = None,
) -> told.Sensor:
    """A sensor with its measurements, and with its gate if gates decide anew."""
    family, size = sensor.family, plan.layout.slice_size
    probability = _gate(sensor, gate, stored=stored)
    missing = _missing(sensor, gate, stored=stored)
    readings = "moved_marked" if stored else "marked" if probability is None else "given_marked"
    kept = keep and not stored and bool(sensor.variable.angles)
    return told.Sensor(
        **_row(owner, family, places(sensor.parents, size), table, stored=stored, keep=keep),
        readings=table.array(owner, attrgetter(readings)),
        moved=table.array(owner, attrgetter("moved")) if kept else None,
        missing=missing,
        bounds=None if _single(sensor, plan.steps) else table.at(owner, attrgetter("edges")),
        gate=None if probability is None else _gate_of(probability, owner, sensor, table),
        loss=_loss_of(owner, sensor, table, missing, found=stored) if sensor.robust else None,
    )


def _gate_of(probability: float, owner: int, sensor: Sensor, table: Table) -> told.Gate:
    """A sensor's gate, whose decisions are gathered in the record; see `decided`."""
    limits = gates.limits(probability, sensor.height)[None, None]
    return told.Gate(
        table.array(owner, lambda _: limits),
        table.array(owner, attrgetter("gated.square")),
        table.array(-1, itemgetter(rejected_by(sensor))),
    )


def _loss_of(owner: int, sensor: Sensor, table: Table, missing: bool, *, found: bool) -> told.Loss:
    """A sensor's robust noise, with the weights of its sightings; `found` as of `told.Loss`."""
    family, weights = sensor.family, sensor.weights
    counts = range(0 if missing else sensor.height, sensor.height + 1)
    functions = [loss_of(weights.noise, count) for count in counts]
    for each in functions:
        if isinstance(each, str):
            raise Uncompiled(f"{family.cpd!r}: its noise: {each}")
    weight, surplus = zip(*functions, strict=True)
    kept, squares = (
        table.array(owner, attrgetter(f"weights.{name}")) for name in ("weight", "square")
    )
    return told.Loss(weight, surplus, kept, squares, expects=family.expects, found=found)


def rejected_by(sensor: Sensor) -> str:
    """The name in a record of a gate's decisions."""
    return f"rejected {sensor.variable.name}"


def undecided(plan: ChainPlan, gate: gates.Asked | None, *, stored: bool) -> Record:
    """Room for what gates decide in a sweep: 1 of a sighting that is rejected, else 0."""
    return {
        rejected_by(sensor): np.zeros(sensor.family.shape[:2])
        for sensor in plan.read
        if _gate(sensor, gate, stored=stored) is not None
    }


def decided(plan: ChainPlan, record: Record) -> None:
    """Record what gates have decided in a sweep."""
    for sensor in plan.read:
        rejected = record.get(rejected_by(sensor))
        if rejected is not None:
            assert sensor.gated is not None
            assert sensor.taken is not None
            sensor.gated.rejected[...] = rejected != 0.0
            sensor.taken[...] = sensor.gated.given & ~sensor.gated.rejected[..., None]


def _row(
    owner: int,
    family: Family,
    parents: tuple[int, ...],
    table: Table,
    *,
    stored: bool,
    keep: bool,
) -> dict[str, Any]:
    def array(name: str) -> told.Array:
        return table.array(owner, attrgetter(f"family.{name}"))

    found: dict[str, Any] = {"parents": parents, "height": family.shape[2]}
    if not stored:
        found["angles"] = tuple(np.flatnonzero(family.cpd.child.angle_mask).tolist())
    if stored or family.template is None:
        found["matrix"], found["offset"] = array("matrix"), array("offset")
        weighed = family.cpd.noise is not None and not stored
        found["noise"] = array("own_noise" if weighed else "noise")
        if weighed and keep:
            found["kept"] = array("noise")
        return found
    answers, rule = family.compiled, points_of(family)
    assert answers is not None
    if isinstance(rule, str):
        raise Uncompiled(f"{family.cpd!r}: {rule}")
    found |= {"function": function_of(family.template, answers.trace), "points": rule}
    found["noise"] = array("own_noise")
    found["inputs"] = None if family.joined_inputs is None else array("joined_inputs")
    if keep:
        found["matrix"], found["offset"] = array("matrix"), array("offset")
        if rule is not None or family.cpd.noise is not None:
            found["kept"] = array("noise")
    return found
