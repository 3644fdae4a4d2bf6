"""The form of evidence: what is left of it without its values, which others may replace.

Evidence of the same variables, of the same shapes, and at the same steps is laid out in the same
way: names, lengths and steps are checked once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from pgm.errors import EvidenceError
from pgm.evidence.dynamic import BoundEvidence, Reading, by_row
from pgm.evidence.rows import Rows, complete, rows_of, taken_of
from pgm.evidence.values import Constant, Evidence, Sightings
from pgm.kernels.arrays import Integers, Mask
from pgm.variables import Variable

# A variable with values of its own, or a sensor with sightings and itself, or a parent given there.
Key = Variable | tuple[Variable, Variable]
# Observed parents, with the places of their values.
_Inputs = list[tuple[Variable, int]]
_FLOATS = np.dtype(float)
_ANEW = "prepare a call for evidence of this form, or use pgm.infer"


@dataclass(frozen=True, eq=False)
class Form:
    """The form of evidence that was bound to a dynamic network.

    Attributes
    ----------
    shapes : mapping
        The shape of each array of values, and whether it is a constant.
    steps : mapping of Variable to ndarray
        By sensor with sightings their steps, (M,), as they were given.
    bound : BoundEvidence
        The layout, with arrays of no rows in place of values.
    """

    shapes: Mapping[Key, tuple[tuple[int, ...], bool]]
    steps: Mapping[Variable, Integers]
    bound: BoundEvidence

    @classmethod
    def of(cls, evidence: Evidence, bound: BoundEvidence) -> Form:
        """The form of evidence, and of its layout."""
        shapes, sightings = {}, {}
        for key, value in _values(evidence).items():
            constant = isinstance(value, Constant)
            rows = _rows(key, value.value if constant else value, constant=constant)
            shapes[key] = rows.shape, constant
        for variable, value in evidence.items():
            if isinstance(value, Sightings):
                sightings[variable] = np.array(value.step, dtype=np.intp)
        return cls(shapes, sightings, _emptied(bound))

    def bind(self, evidence: Evidence) -> BoundEvidence:
        """Evidence of this form laid out; an EvidenceError refuses any other."""
        if not isinstance(evidence, Mapping):
            raise EvidenceError(
                f"evidence maps variables to values; found {type(evidence).__name__}"
            )
        given = self._given(evidence)
        for variable, (step, told) in self._told_steps.items():
            found = evidence[variable].step
            # Bytes are compared in a fraction of the time.
            same = type(found) is np.ndarray and found.dtype is step.dtype and found.ndim == 1
            if not (same and found.tobytes() == told) and not np.array_equal(found, step):
                raise EvidenceError(
                    f"sightings of {variable!r} are at other steps than those prepared for; "
                    f"{_ANEW}",
                    variable=variable,
                )
        rows = list(map(self._checked, self.shapes.items(), given))
        bound = self.bound
        transition = tuple(
            {v: self._input(rows, place, v, None) for v, place in inputs}
            for inputs in self._places[0]
        )
        readings = tuple(
            self._reading(reading, rows, *places)
            for reading, places in zip(bound.readings, self._places[1], strict=True)
        )
        unread = tuple(
            replace(reading, inputs={v: self._input(rows, at, v, reading) for v, at in inputs})
            if inputs
            else reading
            for reading, inputs in zip(bound.unread, self._places[2], strict=True)
        )
        form = bound.readings
        return BoundEvidence(
            bound.steps, bound.lead, transition, readings, bound.first_run, form, unread=unread
        )

    def _given(self, evidence: Evidence) -> list[Any]:
        """The values in evidence, in the order of `shapes`; other variables are refused."""
        found: list[Any] = []
        for variable, parents in self._asked.items():
            value = evidence.get(variable)
            if parents is None:
                found.append(value)
            elif isinstance(value, Sightings) and len(value.given) == len(parents):
                found.append(value.values)
                found += map(value.given.get, parents)
        whole = len(evidence) == len(self._asked) and len(found) == len(self.shapes)
        if whole and not any(each is None or isinstance(each, Sightings) for each in found):
            return found
        given = _values(evidence)
        if given.keys() != self.shapes.keys():
            raise self._other(given)
        return [given[key] for key in self.shapes]

    @cached_property
    def _asked(self) -> dict[Variable, list[Variable] | None]:
        """By variable of the evidence the parents given with its sightings; None of an array."""
        found: dict[Variable, list[Variable] | None] = {}
        for key in self.shapes:
            if not isinstance(key, tuple):
                found[key] = None
                continue
            sensor, parent = key
            parents = found.setdefault(sensor, [])
            if parent != sensor and parents is not None:
                parents.append(parent)
        return found

    @cached_property
    def _told_steps(self) -> dict[Variable, tuple[Integers, bytes]]:
        """The steps of sightings, with their bytes."""
        return {variable: (step, step.tobytes()) for variable, step in self.steps.items()}

    @cached_property
    def _places(self) -> tuple[list[_Inputs], list[tuple[int, _Inputs]], list[_Inputs]]:
        """Where in `shapes` inputs of the transition stand, and values and inputs of readings.

        The last are the inputs of sensors where nothing was read.
        """
        at = {key: place for place, key in enumerate(self.shapes)}
        transition = [[(v, at[v]) for v in inputs] for inputs in self.bound.transition]
        readings = []
        for reading in self.bound.readings:
            sensor = reading.cpd.child
            inputs = [(v, at[(sensor, v) if (sensor, v) in at else v]) for v in reading.inputs]
            values = at[(sensor, sensor) if sensor in self.steps else sensor]
            readings.append((values, inputs))
        unread = [[(v, at[v]) for v in reading.inputs] for reading in self.bound.unread]
        return transition, readings, unread

    @cached_property
    def _constants(self) -> list[tuple[Key, bool]]:
        """The keys of `shapes`, and whether a constant stands there."""
        return [(key, constant) for key, (_, constant) in self.shapes.items()]

    @cached_property
    def _sorted(self) -> frozenset[Variable]:
        """The sensors whose sightings were given in the order of their steps."""
        every = [(reading.cpd.child, reading.order) for reading in self.bound.readings]
        return frozenset(child for child, order in every if (order[1:] > order[:-1]).all())

    @cached_property
    def _span(self) -> Integers:
        """The steps 1..T, at which plain arrays have values."""
        return np.arange(1, self.bound.steps + 1)

    def _checked(self, due: tuple[Key, tuple[tuple[int, ...], bool]], value: Any) -> Rows:
        """Values of the shape that is due, (..., rows, d); of a constant (..., d)."""
        key, (shape, constant) = due
        if isinstance(value, Constant) is not constant:
            variable = _variable(key)
            raise EvidenceError(
                f"evidence for {variable!r} is {_kind(not constant)}, and {_kind(constant)} was "
                f"prepared for; {_ANEW}",
                variable=variable,
            )
        rows = _rows(key, value.value if constant else value, constant=constant)
        if rows.shape != shape:
            variable = _variable(key)
            raise EvidenceError(
                f"evidence for {variable!r} has shape {rows.shape}, and {shape} was prepared for; "
                f"{_ANEW}",
                variable=variable,
            )
        return rows

    def _reading(
        self, reading: Reading, rows: Sequence[Rows], place: int, inputs: _Inputs
    ) -> Reading:
        """The measurements of a sensor, whose values and inputs stand at places among rows."""
        sensor, step, lead, values = reading.cpd.child, reading.step, self.bound.lead, rows[place]
        if sensor in self.steps and sensor not in self._sorted:
            values = values[..., reading.order, :]
        taken = taken_of(sensor, values, step, 1)
        whole = taken is None
        if taken is None:
            taken = _all(values.shape[-2:])
        else:
            values = np.where(taken, values, 0.0)
            taken = by_row(taken, lead)
        own = {v: self._input(rows, place, v, reading) for v, place in inputs}
        order, unknown = reading.order, reading.unknown
        found = Reading(reading.cpd, step, order, by_row(values, lead), taken, own, unknown)
        if whole:
            vars(found)["whole"] = True  # for which it need not look again
        return found

    def _input(
        self, rows: Sequence[Rows], place: int, variable: Variable, reading: Reading | None
    ) -> Rows:
        """The values of an observed parent, at the rows of a sensor or at the steps 1..T."""
        found, (key, constant), lead = rows[place], self._constants[place], self.bound.lead
        if constant:
            count = self.bound.steps if reading is None else len(reading.step)
            found = complete(variable, found)[..., None, :]
            return by_row(np.broadcast_to(found, (*found.shape[:-2], count, found.shape[-1])), lead)
        if reading is None or not isinstance(key, tuple):
            found = complete(variable, found, self._span)
            if reading is not None and not np.array_equal(reading.step, self._span):
                found = found[..., reading.step - 1, :]
            return by_row(found, lead)
        if reading.cpd.child not in self._sorted:
            found = found[..., reading.order, :]
        return by_row(complete(variable, found, reading.step), lead)

    def _other(self, given: Mapping[Key, Any]) -> EvidenceError:
        """The error for evidence of other variables."""
        lacking = [_name(key) for key in self.shapes if key not in given]
        strange = [_name(key) for key in given if key not in self.shapes]
        found = [f"lacks {', '.join(lacking)}"] * bool(lacking)
        found += [f"has {', '.join(strange)} beside"] * bool(strange)
        return EvidenceError(f"evidence {' and '.join(found)} of what was prepared for; {_ANEW}")


def _values(evidence: Evidence) -> dict[Key, Any]:
    """The arrays and constants that stand in evidence, those of sightings by their sensor."""
    found: dict[Key, Any] = {}
    for variable, value in evidence.items():
        if isinstance(value, Sightings):
            found[variable, variable] = value.values
            found |= {(variable, parent): own for parent, own in value.given.items()}
        else:
            found[variable] = value
    return found


def _rows(key: Key, value: Any, *, constant: bool) -> Rows:
    """Values as an array (..., rows, d); of a constant (..., d)."""
    variable, axis = (key[-1], "M") if isinstance(key, tuple) else (key, "T")
    if type(value) is np.ndarray and value.dtype is _FLOATS and value.ndim > 1:
        return value
    return rows_of(variable, value, None if constant else axis)


@lru_cache(maxsize=64)
def _all(shape: tuple[int, ...]) -> Mask:
    """The mask of measurements of one run that are all taken, (rows, 1, d)."""
    return by_row(np.ones(shape, dtype=bool), ())


def _variable(key: Key) -> Variable:
    return key[-1] if isinstance(key, tuple) else key


def _name(key: Key) -> str:
    if not isinstance(key, tuple):
        return repr(key)
    sensor, parent = key
    return (
        f"sightings of {sensor!r}" if sensor == parent else f"{parent!r} of {sensor!r}'s sightings"
    )


def _kind(constant: bool) -> str:
    return "a constant" if constant else "an array"


def _emptied(bound: BoundEvidence) -> BoundEvidence:
    """The layout of evidence, which keeps none of its values."""
    none = np.empty((0, 1, 1))
    return replace(
        bound,
        transition=tuple(dict.fromkeys(inputs, none) for inputs in bound.transition),
        unread=tuple(
            replace(reading, inputs=dict.fromkeys(reading.inputs, none)) for reading in bound.unread
        ),
        readings=tuple(
            replace(
                reading,
                values=none,
                taken=none.astype(bool),
                inputs=dict.fromkeys(reading.inputs, none),
            )
            for reading in bound.readings
        ),
    )
