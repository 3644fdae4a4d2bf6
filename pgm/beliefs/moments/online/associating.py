"""Associating the open sightings of an online filter's step, before it takes them in.

A sighting is one measurement of a sensor. It is *open* if the evidence leaves a parent of the
sensor unknown, with some candidates for its value (`pgm.unknown`); see
`pgm.posteriors.associations`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pgm.beliefs.moments.association.association import associated_at
from pgm.beliefs.moments.online.beliefs import MomentBelief, moments_of
from pgm.beliefs.moments.steps.gate import Asked
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile import DynamicGraph
from pgm.evidence import BoundEvidence, Sightings, Unknown
from pgm.linearisers import Lineariser
from pgm.posteriors.associations import Found
from pgm.schedules import step_evidence
from pgm.variables import Variable


def leaves_open(readings: Mapping[Variable, Any]) -> bool:
    """Whether some sightings have an unknown parent, so that they are to be associated."""
    for value in readings.values():
        if type(value) is Sightings and value.given:
            for each in value.given.values():
                if type(each) is Unknown:
                    return True
    return False


def associated(
    graph: DynamicGraph,
    lineariser: Lineariser,
    belief: MomentBelief,
    readings: Mapping[Variable, Any],
    gate: Asked | None,
) -> tuple[dict[Variable, Any], Found]:
    """The readings with candidates chosen for unknown parents, and the `Associations` by sensor.

    `readings` are the values of an update, by sensor or input, and `belief` is the belief before
    it. Readings that are not open are taken into it first, unless the `gate` rejects them, and
    candidates are chosen by the resulting belief. Sightings taken for no candidate become NaN. The
    gate is a probability for all sensors, or a mapping from sensors to theirs; None for no gate.
    """
    bound = step_evidence.readings(graph.model, belief, readings)
    everything = BoundEvidence(0, bound.lead, (), ())
    plan = ChainPlan.make(graph, everything, lineariser, first=belief.step, prior=False)
    known = moments_of(belief, plan)
    closed, found = associated_at(graph, bound, lineariser, belief.step, known, gate)
    result = dict(readings)
    for before, reading in zip(bound.readings, closed.readings, strict=True):
        if before.unknown is not None:
            sensor, (parent, _) = before.cpd.child, before.unknown
            taken = np.where(reading.taken, reading.values, np.nan)
            rest = {**readings[sensor].given, parent: _by_run(reading.inputs[parent], bound.lead)}
            result[sensor] = Sightings(_by_run(taken, bound.lead), None, rest)
    return result, found


def _by_run(rows: Any, lead: tuple[int, ...]) -> Any:
    """The values `rows` of M sightings with the user's axes of runs first, (*lead, M, d).

    `rows` is (M, runs or 1, d). `lead` is the shape of the user's axes of runs.
    """
    wide = np.broadcast_to(rows, (len(rows), int(np.prod(lead)), rows.shape[-1])).swapaxes(0, 1)
    return wide.reshape(*lead, *wide.shape[1:])
