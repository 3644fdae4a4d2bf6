"""Layouts of the steps of an online filter: plans with room for evidence, kept by its kind.

For one robot a *layout*, a plan of the step (CPDs with room for their evidence), is made once for
each *kind* of values: the variables that are given, and the shapes of their arrays. Batches of
robots, missing measurements and values of odd types or shapes have none: their plans are made anew
at each step, in the *general way*.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.online.beliefs import MomentBelief
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Reading
from pgm.kernels import gaussian
from pgm.kernels.arrays import Array
from pgm.linearisation.family import Family
from pgm.linearisation.rows import At
from pgm.schedules.schedule import Filtering
from pgm.schedules.step_evidence import MOST, Key, Values, ordinary, places
from pgm.variables import Variable


class _Local:
    """A CPD of a layout, and the places of its inputs and measurements.

    `family` is the CPD. `inputs` has a pair for each of its inputs: the place of the array, and
    whether all measurements share its only row. `sightings` is the number of measurements, and
    `reading` the place of their values; they are 1 and −1 for a CPD of the transition.
    """

    def __init__(
        self, family: Family, inputs: list[tuple[int, bool]], sightings: int, reading: int
    ) -> None:
        self.family, self.inputs, self.sightings, self.reading = family, inputs, sightings, reading
        # Where nothing is shared or computed, the rows are bound as they come.
        self.places: list[int | None] | None = None
        if family.template is not None and not family.noisy and not any(each for _, each in inputs):
            self.places = [None if k is None else inputs[k][0] for k in family.order]
            self.at_first = family.given(0, [np.zeros(0)] * len(inputs), sightings)

    def at(self, step: int, rows: list[Array]) -> At | None:
        """The CPD with its inputs taken from the arrays given at a step, `rows`, by place.

        None if its noise depends on these inputs, and is singular at them.
        """
        if self.places is not None:
            known = [None if k is None else rows[k] for k in self.places]
            return self.at_first.bound(step, known)
        count = self.sightings
        values = [np.tile(rows[k], (count, 1)) if each else rows[k] for k, each in self.inputs]
        found = self.family.given(step, values, count)
        if self.family.noisy and gaussian.root(found.noise) is None:
            return None
        return found


class _Layout(NamedTuple):
    """A layout: the plan of a step with its chain, its CPDs, and the values it was made from.

    `chain` makes steps by the plan, and `locals` are the CPDs. The `values` are kept so that their
    variables live: the layout's key has the variables' identities (`id`).
    """

    plan: ChainPlan
    chain: MomentChain
    locals: list[_Local]
    values: Values


class Layouts:
    """The layouts of predictions or of updates, kept by the kind of the values given.

    `make` makes the plan of a step from a belief and values; `schedule` says how often an update
    linearises. At most 64 layouts are kept; one more drops them all.
    """

    def __init__(
        self, make: Callable[[MomentBelief, Values], ChainPlan], schedule: Filtering
    ) -> None:
        self._make, self._schedule = make, schedule
        self._known: dict[Key, _Layout] = {}

    def motion(self, belief: MomentBelief, inputs: Values) -> tuple[MomentChain, list[At]] | None:
        """The `MomentChain` of a prediction, and its transition CPDs bound to the inputs.

        The chain belongs to the kept plan of the inputs' kind. None where the general way is to be
        taken: values have no kind, or a noise that depends on inputs is singular.
        """
        given = ordinary(inputs)
        if given is None:
            return None
        key, rows = given
        layout = self._known.get(key) or self._add(key, belief, inputs)
        ats = [local.at(belief.step + 1, rows) for local in layout.locals]
        if None in ats:
            return None
        return layout.chain, ats  # type: ignore[return-value]

    def sensors(
        self, belief: MomentBelief, readings: Values
    ) -> tuple[MomentChain, list[Reading]] | None:
        """The `MomentChain` of an update, and sensors' CPDs bound to their readings.

        The chain belongs to the kept plan of the readings' kind. None where the general way is to
        be taken: values have no kind, or a noise that depends on inputs is singular.
        """
        given = ordinary(readings)
        if given is None:
            return None
        key, rows = given
        if not belief.step:  # there are no controls, and measurements of them are refused
            key = *key, 0
        layout = self._known.get(key) or self._add(key, belief, readings)
        parts = []
        for sensor, local in zip(layout.plan.sensors, layout.locals, strict=True):
            if not local.sightings:
                continue
            at = local.at(belief.step, rows)
            if at is None:
                return None
            reading = rows[local.reading]
            parts.append(
                Reading(sensor, at, reading if local.sightings == 1 else reading.reshape(-1), None)
            )
        chain = layout.chain
        if chain.iterates or layout.plan.robust:  # and tells how that went
            chain = MomentChain(layout.plan, self._schedule, keep=False)
        return chain, parts

    def _add(self, key: Key, belief: MomentBelief, values: Values) -> _Layout:
        """Make a layout from the first values of a kind, and keep it under the kind's `key`."""
        plan, where = self._make(belief, values), places(values)
        locals_ = [_local(link.family, None, 1, where) for link in plan.transition]
        if plan.sensors:
            locals_ = [
                _local(sensor.family, sensor.variable, len(sensor.values), where)
                for sensor in plan.sensors
            ]
        if len(self._known) >= MOST:
            self._known.clear()
        chain = MomentChain(plan, self._schedule, keep=False)
        layout = self._known[key] = _Layout(plan, chain, locals_, dict(values))
        return layout


def _local(
    family: Family,
    sensor: Variable | None,
    count: int,
    where: Mapping[tuple[Variable | None, Variable], int],
) -> _Local:
    """The CPD `family` as a `_Local`, which knows the places of its inputs and measurements.

    `sensor` is the CPD's child and `count` its number of sightings; None and 1 for a transition. An
    input that was given by itself, not with the sensor's sightings, is shared by all of them.
    `where` has the places by pairs: the sensor with whose sightings an array was given, or None,
    and the array's variable.
    """
    inputs = []
    for parent in family.inputs:
        own = sensor is not None and (sensor, parent) in where
        # What is given beside several sightings holds for each of them.
        inputs.append((where[sensor if own else None, parent], count > 1 and not own))
    return _Local(family, inputs, count, where[None, sensor] if sensor is not None else -1)
