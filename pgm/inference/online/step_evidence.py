"""The evidence of one online step: its values checked and bound to the model's CPDs.

*Sightings* are the measurements of one sensor, of which a step may have several (`pgm.sightings`).
For one robot a *layout*, a plan of the step (CPDs with room for their evidence), is made once for
each *kind* of values: the variables that are given, and the shapes of their arrays. Batches of
robots, missing measurements and values of odd types or shapes have none: their plans are made anew
at each step, in the *general way*. The *place* of an array is its position among all that are given
at a step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite
from typing import Any, NamedTuple, Protocol

import numpy as np

from pgm.boundary import as_floats
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence, Constant, Sightings, bind, constant, sightings
from pgm.evidence.rows import as_rows, as_weights, rows_of
from pgm.evidence.values import Soft, soft
from pgm.factors.axes import as_indices
from pgm.factors.scope import listed, namesake
from pgm.immutable import set_writeable
from pgm.inference.chain.moments import MomentChain
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.readings import Reading
from pgm.inference.family import Family
from pgm.inference.online.beliefs import MomentBelief
from pgm.inference.online.window import Sliding
from pgm.inference.rows import At
from pgm.inference.schedule import Filtering
from pgm.kernels import gaussian
from pgm.kernels.arrays import Array
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Discrete, Variable


class Place(Protocol):
    """What the evidence of a step has to know of a belief: its step, its runs, the steps behind it.

    Beliefs of any kind have these. It is no *place* of an array.
    """

    @property
    def step(self) -> int:
        """The number of the belief's step."""
        ...

    @property
    def lead(self) -> tuple[int, ...]:
        """The shape of the user's axes of runs, which the belief's arrays have first."""
        ...

    @property
    def behind(self) -> object:
        """The steps kept behind the belief; a `Sliding` window fixes the number of runs."""
        ...


def mapping(value: Any, method: str, what: str) -> Mapping[Variable, Any]:
    """The same value; an `EvidenceError` if it is no mapping.

    The error's text names the `method` that the user called ("predict") and, as `what`, the mapping
    that it takes ("inputs to values").
    """
    if not isinstance(value, Mapping):
        raise EvidenceError(f"{method} takes a mapping of {what}, not {type(value).__name__}")
    return value


def inputs(
    model: DynamicBayesianNetwork, belief: Place, values: Mapping[Variable, Any]
) -> BoundEvidence:
    """The inputs of a prediction as bound evidence of one transition.

    `values` has the inputs by variable, and `belief` is the one to predict from. A variable that is
    no input of the transition raises an `EvidenceError`.
    """
    needed = {v for cpd in model.transition for v in cpd.parents}
    for variable in values:
        if variable not in needed or variable not in model.inputs:
            raise EvidenceError(
                f"predict takes inputs of the transition, [{listed(model.inputs)}], not "
                f"{variable!r}{namesake(variable, model.inputs)}; measurements go to update",
                variable=variable,
                step=belief.step + 1,
            )
    evidence = {v: _constant(value) for v, value in values.items()}
    return _same_runs(belief, bind(model.transition, (), evidence, 1, belief.lead))


def readings(
    model: DynamicBayesianNetwork, belief: Place, values: Mapping[Variable, Any]
) -> BoundEvidence:
    """The measurements of an update, and inputs of its sensors, as bound evidence.

    `values` has both by variable, and `belief` is the one to update. The evidence is that of a
    chain of this one step, which is therefore its step 0.
    """
    evidence = {v: _reading(model, v, value) for v, value in values.items()}
    parts = model.transition, model.observation, evidence, 0, belief.lead
    return _same_runs(belief, bind(*parts, transition_inputs=False, identities=True))


def _same_runs(belief: Place, bound: BoundEvidence) -> BoundEvidence:
    """The same evidence; an `EvidenceError` if it is of other runs than a window behind the belief.

    Only a `Sliding` window refuses: its steps must have the same axes of runs, those of `belief`.
    Where these are empty, evidence of any runs is taken: a belief of one run becomes one of many.
    """
    lead = belief.lead
    if isinstance(belief.behind, Sliding) and lead and lead != bound.lead:
        raise EvidenceError(
            f"evidence of runs {bound.lead} after such of runs {lead}: the steps of a window, with "
            f"{belief.behind.schedule!r}, are of the same runs; give the first evidence, or the "
            f"prior's mean, all axes {bound.lead}",
            step=belief.step,
        )
    return bound


def _constant(value: Any) -> Constant:
    """The value of an input, wrapped as a constant if it is not one."""
    return value if isinstance(value, Constant) else constant(value)


def _reading(model: DynamicBayesianNetwork, variable: Variable, value: Any) -> Any:
    """The value of a sensor as sightings at step 0, that of any other variable as a constant.

    Sightings with steps of their own are an `EvidenceError`.
    """
    if variable not in model.sensors:
        return _constant(value)
    if not isinstance(value, Sightings):
        value = sightings(_single(variable, value))
    if value.step is not None:
        raise EvidenceError(
            f"sightings of {variable!r} online belong to the belief's step; leave step= out",
            variable=variable,
        )
    if value.values is None:
        return Sightings(None, np.zeros(0, dtype=np.intp), value.given)
    count = rows_of(variable, value.values, "M").shape[-2]
    return Sightings(value.values, np.zeros(count, dtype=np.intp), value.given)


def _single(variable: Variable, value: Any) -> Any:
    """One measurement (*runs, d) with an axis of sightings, of length one: (*runs, 1, d).

    Of a discrete sensor, an index (*runs) becomes (*runs, 1), and weights (*runs, 1, size).
    """
    if not isinstance(variable, Discrete):
        return as_rows(variable, value, None)[..., None, :]
    if isinstance(value, Soft):
        return soft(as_weights(variable, value)[..., None, :])
    return as_indices(variable, value)[..., None]


ARRAY, FLOAT = np.ndarray, np.dtype(np.float64)
_SIGHTED, _GIVEN = -1, -2
# The kind of the values given: by variable how many rows and how wide. A variable is its identity,
# which is quicker than its value; whoever keeps a key has to keep the variables alive.
Key = tuple[Any, ...]


def ordinary(values: Mapping[Variable, Any]) -> tuple[Key, list[Array]] | None:
    """The kind of the values given, as a key for layouts, and their arrays, read-only.

    An array is (d,), or (M, d) of sightings, (d,) if M is 1; a sensor's comes before those of its
    parents. None where a value is NaN or infinite, is no array or list of numbers, or is of many
    robots.
    """
    key: list[Any] = []
    rows: list[Array] = []
    for variable, value in values.items():
        if not isinstance(value, Sightings):
            row = _view(value, 1)
            if row is None or not isfinite(sum(row.tolist())):
                return None
            rows.append(row)
            key += id(variable), row.shape
            continue
        row = _view(value.values, 2)
        if row is None or value.step is not None or not _is_finite(row):
            return None
        rows.append(row)
        key += id(variable), _SIGHTED, row.shape
        for parent, each in value.given.items():
            row = _view(each, 2)
            if row is None or not _is_finite(row):
                return None
            rows.append(row)
            key += id(parent), _GIVEN, row.shape
    return tuple(key), rows


def _is_finite(row: Array) -> bool:
    """Whether all numbers of an array are finite, by their sum, which is quicker.

    An array of finite numbers whose sum overflows counts as not finite: the general way takes it.
    """
    return isfinite(sum((row if row.ndim == 1 else row.ravel()).tolist()))


def _view(value: Any, axes: int) -> Array | None:
    """A read-only view (d,) or (M, d) of a value, as users' functions see it.

    A value of two axes has sightings as rows; of a single one the view is (d,). None where the
    value has another number of axes than `axes`, or is no array or list of numbers.
    """
    value = numbers(value, axes)
    if value is None:
        return None
    view: Array = value[0] if axes == 2 and len(value) == 1 else value.view()
    set_writeable(view, False)
    return view


def numbers(value: Any, axes: int) -> Array | None:
    """A value as an array of floats with `axes` axes; None where it cannot be one."""
    if type(value) is not ARRAY or value.dtype is not FLOAT:
        value = _numbers(value) if isinstance(value, ARRAY | list | tuple) else None
    return None if value is None or value.ndim != axes else value


def _numbers(value: Any) -> Array | None:
    """The value as an array of floats; None where it cannot be one.

    The step is then made in the general way, which raises the error.
    """
    try:
        return as_floats(value, "a value", EvidenceError)
    except EvidenceError:  # which the general way words
        return None


def places(values: Mapping[Variable, Any]) -> dict[tuple[Variable | None, Variable], int]:
    """The place of each array among all that are given at a step, by sensor and variable.

    The sensor is the one with whose sightings a parent was given; it is None for a variable given
    by itself, a sensor with its own measurements included.
    """
    found: dict[tuple[Variable | None, Variable], int] = {}
    for variable, value in values.items():
        found[None, variable] = len(found)
        if isinstance(value, Sightings):
            for parent in value.given:
                found[variable, parent] = len(found)
    return found


# Kinds of input that a filter keeps layouts for.
MOST = 64
Values = Mapping[Variable, Any]


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
        """What makes a prediction: its `MomentChain`, and its transition CPDs bound to the inputs.

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
        """What makes an update: its `MomentChain`, and sensors' CPDs bound to their readings.

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
