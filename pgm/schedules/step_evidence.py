"""The evidence of one online step: its values checked and bound to the model's CPDs.

*Sightings* are the measurements of one sensor, of which a step may have several (`pgm.sightings`).
For one robot a *layout*, a plan of the step (CPDs with room for their evidence), is made once for
each *kind* of values: the variables that are given, and the shapes of their arrays. Batches of
robots, missing measurements and values of odd types or shapes have none: their plans are made anew
at each step, in the *general way*. The *place* of an array is its position among all that are given
at a step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import isfinite
from typing import Any, Protocol

import numpy as np

from pgm.boundary import as_floats
from pgm.cpds import by_step
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence, Constant, Sightings, bind, constant, sightings
from pgm.evidence.rows import as_log_weights, as_rows, rows_of
from pgm.evidence.values import Soft, soft
from pgm.factors.axes import as_indices
from pgm.factors.scope import listed, namesake
from pgm.immutable import set_writeable
from pgm.kernels.arrays import Array
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Discrete, Variable


class Place(Protocol):
    """The place of a belief, for the evidence of a step: its step, runs, and steps behind it.

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
        """The steps kept behind the belief; a sliding window fixes the number of runs."""
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
    for cpd in model.transition:
        by_step.require_step(cpd, belief.step + 1)
    evidence = {v: _constant(value) for v, value in values.items()}
    bound = bind(model.transition, (), evidence, 1, belief.lead, whole=False)
    return _same_runs(belief, bound)


def readings(
    model: DynamicBayesianNetwork,
    belief: Place,
    values: Mapping[Variable, Any],
    *,
    among: bool = False,
) -> BoundEvidence:
    """The measurements of an update, and inputs of its sensors, as bound evidence.

    `values` has both by variable, and `belief` is the one to update. The evidence is that of a
    chain of this one step, which is therefore its step 0. With `among`, sightings may be of one of
    several hidden variables.
    """
    for cpd in model.observation:
        if cpd.child in values:
            by_step.require_step(cpd, belief.step)
    evidence = {v: _reading(model, v, value) for v, value in values.items()}
    parts = model.transition, model.observation, evidence, 0, belief.lead
    hidden = frozenset(cpd.child for cpd in model.transition) if among else ()
    bound = bind(*parts, transition_inputs=False, identities=True, among=hidden, whole=False)
    return _same_runs(belief, bound)


def unread(
    model: DynamicBayesianNetwork,
    belief: Place,
    variable: Variable,
    given: Mapping[Variable, Any],
) -> tuple[BoundEvidence, bool]:
    """Sightings of a sensor that are to be read, as of `readings`, and whether one stands alone.

    `given` has the sensor's observed parents, of which there are as many rows as sightings, or
    constants. Without rows there is one sighting, alone.
    """
    rows = [v for v, each in given.items() if not isinstance(each, Constant)]
    count = max((rows_of(v, given[v], "M").shape[-2] for v in rows), default=1)
    discrete = isinstance(variable, Discrete)
    nothing = np.full(count, -1) if discrete else np.full((count, variable.dimension), np.nan)
    asked = {variable: Sightings(nothing, None, given)}
    return readings(model, belief, asked), not rows


def at_step(bound: BoundEvidence, step: int) -> BoundEvidence:
    """The evidence of an update at its step of the chain, not at step 0 of its own."""
    return replace(
        bound, readings=tuple(replace(each, step=each.step + step) for each in bound.readings)
    )


def _same_runs(belief: Place, bound: BoundEvidence) -> BoundEvidence:
    """The same evidence; an `EvidenceError` if it is of other runs than a window behind the belief.

    Only a window with a schedule, of a fixed lag, refuses: its steps must have the same axes of
    runs, those of `belief`. Where these are empty, evidence of any runs is taken: a belief of one
    run becomes one of many.
    """
    lead, schedule = belief.lead, getattr(belief.behind, "schedule", None)
    if schedule is not None and lead and lead != bound.lead:
        raise EvidenceError(
            f"evidence of runs {bound.lead} after such of runs {lead}: the steps of a window, with "
            f"{schedule!r}, are of the same runs; give the first evidence, or the "
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
        return soft(as_log_weights(variable, value)[..., None, :], log=True)
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
