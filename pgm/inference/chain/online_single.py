"""One robot online: a plan of one step is made once, and then only its values are renewed.

Whatever is out of the ordinary is None here, and left to the general way, which refuses what is
wrong: batches of robots, missing readings, values of odd shapes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import hypot, isfinite
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from pgm.errors import PgmError
from pgm.evidence import Sightings
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.single_motion import Motion
from pgm.inference.chain.single_sight import Sight
from pgm.inference.status import Status
from pgm.kernels import roots, single
from pgm.kernels.arrays import Array, block
from pgm.linearisers.single import Special
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.inference.chain.online import OnlineBelief

_FLOAT = np.dtype(np.float64)
# Kinds of input that a filter keeps plans for.
_MOST = 64
# Nothing was to iterate, and linearised once.
DONE, LINEARISED = (Status(1, np.empty(0), np.array(converged)) for converged in (True, False))
Moments = tuple[Array, Array]
T = TypeVar("T")


class Pool(Generic[T]):
    """What has been prepared and is not in use: threads may share a filter.

    Keys tell variables by identity, which is quicker than by value; they are kept, since an
    identity means nothing without its object.
    """

    def __init__(self) -> None:
        self._idle: dict[tuple[int, ...], tuple[object, list[T]]] = {}

    def take(self, key: tuple[int, ...]) -> T | None:
        """One that was prepared for a key, for this caller alone."""
        found = self._idle.get(key)
        try:
            return found[1].pop() if found is not None and found[1] else None
        except IndexError:  # another thread was quicker
            return None

    def give(self, key: tuple[int, ...], variables: object, prepared: T) -> None:
        """Keep one for the next caller."""
        found = self._idle.get(key)
        if found is None:
            if len(self._idle) >= _MOST:
                self._idle.clear()
            found = self._idle[key] = variables, []
        found[1].append(prepared)


class Given:
    """What a user gives for a step, as far as it is ordinary.

    Attributes
    ----------
    key : tuple of int
        What it is of, how many rows of each, how wide: a plan is for one such key.
    rows : list of ndarray
        (d,) each, or (M, d) of sightings, each before what is given with it.
    variables : list of Variable
        Whose rows these are.
    owners : list of Variable or None
        For what is given with sightings, whose they are.
    """

    __slots__ = ("key", "owners", "rows", "variables")

    def __init__(self, values: Mapping[Variable, Any]) -> None:
        key: list[int] = []
        self.rows: list[Array] = []
        self.variables: list[Variable] = []
        self.owners: list[Variable | None] = []
        for variable, value in values.items():
            if not isinstance(value, Sightings):
                self._add(key, variable, value, 1, None)
                continue
            if value.step is not None:
                raise Special
            self._add(key, variable, value.values, 2, None)
            for parent, each in value.given.items():
                self._add(key, parent, each, 2, variable)
        self.key = tuple(key)

    def _add(
        self, key: list[int], variable: Variable, value: Any, axes: int, owner: Variable | None
    ) -> None:
        if type(value) is not np.ndarray or value.dtype is not _FLOAT:
            value = _numbers(value)
        if value.ndim != axes:
            raise Special
        if not isfinite(hypot(*value.reshape(-1).tolist())):
            raise Special
        if not value.flags.c_contiguous:
            value = value.copy()
        rows = value.view()
        rows.setflags(write=False)  # functions of users see it
        key += id(variable), axes, *rows.shape
        if owner is not None:
            key.append(-1)
        self.rows.append(rows)
        self.variables.append(variable)
        self.owners.append(owner)

    def place(self, variable: Variable, owner: Variable | None = None) -> int:
        """Which rows are those of a variable, for a sensor."""
        each = list(zip(self.variables, self.owners, strict=True))
        return each.index((variable, owner) if (variable, owner) in each else (variable, None))


def _numbers(value: Any) -> Array:
    if not isinstance(value, np.ndarray | list | tuple):
        raise Special
    try:
        array = np.asarray(value)
    except ValueError:
        raise Special from None
    if array.dtype.kind not in "fiu":
        raise Special
    return array.astype(np.float64)


class _Driven:
    """A transition, and where its inputs stand in what is given."""

    def __init__(self, plan: ChainPlan, given: Given) -> None:
        self.motion = Motion(plan)
        moves = self.motion.moves
        self.moves = [(move, [given.place(v) for v in move.inputs]) for move in moves]
        # Only a lineariser's error can make a prediction indefinite.
        self.rough = any(move.family.approximate for move in moves)

    def renew(self, step: int, given: Given) -> None:
        """Take what is given for a step."""
        for move, places in self.moves:
            move.renew(step, [given.rows[place][None] for place in places])

    def predict(self, belief: OnlineBelief) -> Moments | None:
        """Moments of the slice from those of the one before it; None if the general way is due."""
        mean, cov = belief.mean[0], belief.cov[0]
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            try:
                if not self.motion.whole:
                    states = belief.layout.state_places
                    mean, cov = mean[states], block(cov, states, states)
                mean, cov = self.motion.predict(0, mean, cov)
            except PgmError:
                return None
            if self.rough and single.root(cov) is None and not roots.is_proper(roots.root(cov)):
                return None
            return (mean, cov) if _finite(mean, cov) else None


class _Sighted:
    """Sensors, and where their readings and inputs stand in what is given."""

    def __init__(self, plan: ChainPlan, given: Given) -> None:
        self.sight = Sight(plan)
        self.reads = [
            (read, given.place(read.variable), [given.place(v, read.variable) for v in read.inputs])
            for read in self.sight.reads
        ]

    def renew(self, step: int, given: Given) -> None:
        """Take what is given for a step."""
        for read, own, places in self.reads:
            values = given.rows[own]
            if values.ndim == 1:
                values = values[None]
            rows = []
            for place in places:
                found = given.rows[place]
                if found.ndim == 1:  # it holds for all sightings
                    found = found[None] if len(values) == 1 else np.tile(found, (len(values), 1))
                rows.append(found)
            read.renew_readings(step, values, rows)

    def update(self, belief: OnlineBelief) -> tuple[Array, Array, float] | None:
        """Moments given the readings, and their log-density; None if the general way is due."""
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            try:
                found = self.sight.update(0, belief.mean[0], belief.cov[0])
            except PgmError:
                return None
            return found if found is not None and _finite(*found) else None


def _finite(mean: Array, cov: Array, log_density: float = 0.0) -> bool:
    """Whether all is finite, and not too large to be squared."""
    flat = cov.reshape(-1)
    return isfinite(mean.dot(mean) + flat.dot(flat) + log_density)


class Single:
    """The lean steps of an online filter."""

    def __init__(self) -> None:
        self._motions: Pool[_Driven] = Pool()
        self._sights: Pool[_Sighted] = Pool()

    def predict(
        self,
        belief: OnlineBelief,
        inputs: Mapping[Variable, Any],
        make: Callable[[OnlineBelief, Mapping[Variable, Any]], ChainPlan],
    ) -> OnlineBelief | None:
        """The belief one step later; None where it takes the general way.

        `make` makes the plan of a prediction, where none is at hand.
        """
        try:
            given = Given(inputs)
        except Special:
            return None
        driven = self._motions.take(given.key)
        if driven is None:
            plan = make(belief, inputs)
            if plan.lead:
                return None
            driven = _Driven(plan, given)
        else:
            driven.renew(belief.step + 1, given)
        found = driven.predict(belief)
        self._motions.give(given.key, given.variables, driven)
        if found is None:
            return None
        return belief.after(belief.step + 1, *found, belief.log_density, DONE)

    def update(
        self,
        belief: OnlineBelief,
        readings: Mapping[Variable, Any],
        make: Callable[[OnlineBelief, Mapping[Variable, Any]], ChainPlan],
    ) -> OnlineBelief | None:
        """The belief given readings; None where it takes the general way.

        `make` makes the plan of an update, where none of such readings is at hand.
        """
        try:
            given = Given(readings)
        except Special:
            return None
        # At step 0 a plan may be refused, since there are no controls.
        key = given.key if belief.step else (*given.key, 0)
        sighted = self._sights.take(key)
        if sighted is None:
            plan = make(belief, readings)
            if plan.lead:
                return None
            sighted = _Sighted(plan, given)
        else:
            sighted.renew(belief.step, given)
        found = sighted.update(belief)
        self._sights.give(key, given.variables, sighted)
        if found is None:
            return None
        mean, cov, gained = found
        status = DONE if sighted.sight.linear else LINEARISED
        return belief.after(belief.step, mean, cov, belief.log_density + gained, status)
