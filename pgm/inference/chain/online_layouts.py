"""Plans for the steps of one robot online, made once for each kind of input.

Batches of robots, missing readings and values of odd shapes have none here: their plans are made
anew at each step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from pgm.inference.chain.moments import MomentChain
from pgm.inference.chain.online_belief import OnlineBelief
from pgm.inference.chain.online_given import Key, ordinary, places
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.readings import Reading
from pgm.inference.family import Family
from pgm.inference.rows import At
from pgm.inference.schedule import Filtering
from pgm.kernels import gaussian
from pgm.kernels.arrays import Array
from pgm.variables import Variable

# Kinds of input that a filter keeps layouts for.
_MOST = 64
Values = Mapping[Variable, Any]


class _Local:
    """A CPD, and which of the rows given at a step are its inputs.

    Parameters
    ----------
    family : Family
    inputs : list of (int, bool)
        The place of each input among the rows, and whether it is shared by several sightings.
    sightings : int
    reading : int
        The place of the readings.
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
        """The CPD at rows; None where its noise there is singular."""
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
    """A plan and its chain, its CPDs, and the values that it was made of.

    These keep alive the variables that a kind of input tells by identity.
    """

    plan: ChainPlan
    chain: MomentChain
    locals: list[_Local]
    values: Values


class Layouts:
    """Layouts of a step, by the kind of input.

    Parameters
    ----------
    make : callable
        Makes a plan, or refuses what is given.
    schedule : Filtering
        How often readings are linearised.
    """

    def __init__(
        self, make: Callable[[OnlineBelief, Values], ChainPlan], schedule: Filtering
    ) -> None:
        self._make, self._schedule = make, schedule
        self._known: dict[Key, _Layout] = {}

    def motion(self, belief: OnlineBelief, inputs: Values) -> tuple[MomentChain, list[At]] | None:
        """The chain of a prediction, and its CPDs."""
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
        self, belief: OnlineBelief, readings: Values
    ) -> tuple[MomentChain, list[Reading]] | None:
        """The chain of an update, and its readings."""
        given = ordinary(readings)
        if given is None:
            return None
        key, rows = given
        if not belief.step:  # there are no controls, and readings of them are refused
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
        if chain.iterates:  # and tells how that went
            chain = MomentChain(layout.plan, self._schedule, keep=False)
        return chain, parts

    def _add(self, key: Key, belief: OnlineBelief, values: Values) -> _Layout:
        plan, where = self._make(belief, values), places(values)
        locals_ = [_local(link.family, None, 1, where) for link in plan.transition]
        if plan.sensors:
            locals_ = [
                _local(sensor.family, sensor.variable, len(sensor.values), where)
                for sensor in plan.sensors
            ]
        if len(self._known) >= _MOST:
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
    inputs = []
    for parent in family.inputs:
        own = sensor is not None and (sensor, parent) in where
        # What is given beside several sightings holds for each of them.
        inputs.append((where[sensor if own else None, parent], count > 1 and not own))
    return _Local(family, inputs, count, where[None, sensor] if sensor is not None else -1)
