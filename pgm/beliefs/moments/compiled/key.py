"""The key of a sweep's code, which plans of one form have in common."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np

from pgm.beliefs.moments.compiled.functions import points_of
from pgm.beliefs.moments.compiled.gates import has_missing, probability_of
from pgm.beliefs.moments.compiled.robust_noise import lone
from pgm.beliefs.moments.compiled.rows import known_at_start
from pgm.beliefs.moments.compiled.sensors import single
from pgm.beliefs.moments.steps import gate as gates
from pgm.beliefs.moments.steps.open_sensor import OpenSensor
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.linearisation.family import Family
from pgm.linearisers import Taylor

# What decides how a CPD is linearised whose function is called.
CALLED = "called"


def decisive(
    plan: ChainPlan, *, stored: bool, keep: bool, gate: gates.Asked | None
) -> tuple[Hashable, ...]:
    """The key of a forward sweep's code, beside the places of its CPDs.

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
            probability_of(sensor, gate, stored=stored),
            has_missing(sensor, gate, stored=stored),
            *_sightings(sensor),
            _group(sensor),
            sensor.form if isinstance(sensor, OpenSensor) else None,
        )
        for sensor in plan.read
    ]
    return (*rows, stored, keep, tuple(known_at_start(plan).tolist()))


def _function(family: Family, *, stored: bool, keep: bool) -> Hashable:
    """The key of a CPD's linearisation."""
    bare = family.bare if family.noisy else None
    weighed = family.cpd.noise is not None
    if stored or family.template is None:
        if keep and weighed and not stored:
            family.keep_errors()
        return bare
    rule = family.lineariser
    if _has_points(family) and isinstance(points_of(family), str):
        return CALLED
    answers = family.trace_whole()
    if isinstance(answers, str):
        return CALLED
    if keep and keeps_errors(family):
        family.keep_errors()
    return answers.trace, rule, bare


def keeps_errors(family: Family) -> bool:
    """Whether a sweep that keeps linearisations adds something to the noise of a CPD."""
    return family.cpd.noise is not None or _has_points(family)


def _has_points(family: Family) -> bool:
    by_rule = family.template is not None and bool(family.hidden)
    return by_rule and type(family.lineariser) is not Taylor


def _group(sensor: Sensor) -> Hashable:
    """The key of a sensor as one vector of the sightings of a step."""
    counts = np.diff(sensor.bounds)
    return (int(counts.max()), bool(counts.all())) if sensor.is_correlated else None


def _sightings(sensor: Sensor) -> tuple[bool, bool]:
    """Whether each step has one sighting; and of robust noise, whether none has more."""
    return single(sensor.edges), sensor.robust and lone(sensor)
