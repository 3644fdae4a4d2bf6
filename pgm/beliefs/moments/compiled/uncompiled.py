"""Why a plan is left to the general kernels."""

from __future__ import annotations

from collections.abc import Sequence

from pgm.beliefs.moments.steps.open_sensor import OpenSensor
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile.machine import MOST
from pgm.evidence.values import JOINT


class Uncompiled(Exception):
    """A plan that machine code cannot sweep, and why."""


def unknown(plan: ChainPlan, vectors: Sequence[Sensor] = ()) -> str | None:
    """Why machine code does not know a plan, but for functions that are not linearised yet.

    A step's sightings by one of the `vectors` are swept as one vector.
    """
    for sensor in plan.read:
        if sensor.robust and sensor.weights.noise.graduated:
            return f"{sensor.family.cpd!r} has graduated noise"
        if isinstance(sensor, OpenSensor):
            why = _open_unknown(sensor)
            if why is not None:
                return f"{sensor.family.cpd!r}: {why}"
        if sensor.exact:
            return f"{sensor.family.cpd!r} has a singular noise"
        if sensor.is_correlated and sensor not in vectors:
            rule = sensor.family.lineariser
            return f"{sensor.family.cpd!r} has several sightings in a group, linearised by {rule!r}"
    for family in plan.families:
        if max(family.cpd.child.dimension, family.shape[3]) > MOST:
            return f"{family.cpd!r} has more than {MOST} components"
    return None


def _open_unknown(sensor: OpenSensor) -> str | None:
    """Why machine code does not compare a sensor's sightings with candidates."""
    if sensor.unknown.association == JOINT:
        return "its sightings of a step are associated together"
    if sensor.robust:
        return "it has robust noise, and its sightings are to be associated"
    if getattr(sensor.family.lineariser, "fresh_per_run", False):
        return "points are drawn anew for each candidate"
    return None


def require_affine_prior(plan: ChainPlan) -> None:
    """Refuse a plan whose prior would be linearised again."""
    for link in plan.prior:
        if not link.family.exact:
            raise Uncompiled(f"{link.family.cpd!r} is a prior that is linearised again")
