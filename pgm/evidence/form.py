"""The form of evidence: what is left of it without its values, which others may replace.

Evidence of the same variables, of the same shapes, and at the same steps is laid out in the same
way: names, lengths and steps are checked once.
"""

from __future__ import annotations

from collections.abc import Mapping
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
        given = _values(evidence)
        if given.keys() != self.shapes.keys():
            raise self._other(given)
        for variable, step in self.steps.items():
            if not np.array_equal(evidence[variable].step, step):
                raise EvidenceError(
                    f"sightings of {variable!r} are at other steps than those prepared for; "
                    f"{_ANEW}",
                    variable=variable,
                )
        rows = {key: self._checked(key, value) for key, value in given.items()}
        bound = self.bound
        transition = tuple(
            {v: self._input(rows, v, v, None) for v in inputs} for inputs in bound.transition
        )
        readings = tuple(self._reading(reading, rows) for reading in bound.readings)
        return BoundEvidence(
            bound.steps, bound.lead, transition, readings, bound.first_run, bound.readings
        )

    @cached_property
    def _sorted(self) -> frozenset[Variable]:
        """The sensors whose sightings were given in the order of their steps."""
        every = [(reading.cpd.child, reading.order) for reading in self.bound.readings]
        return frozenset(child for child, order in every if (order[1:] > order[:-1]).all())

    @cached_property
    def _span(self) -> Integers:
        """The steps 1..T, at which plain arrays have values."""
        return np.arange(1, self.bound.steps + 1)

    def _checked(self, key: Key, value: Any) -> Rows:
        """Values of the shape that is due, (..., rows, d); of a constant (..., d)."""
        due, constant = self.shapes[key]
        variable = key[-1] if isinstance(key, tuple) else key
        if isinstance(value, Constant) is not constant:
            raise EvidenceError(
                f"evidence for {variable!r} is {_kind(not constant)}, and {_kind(constant)} was "
                f"prepared for; {_ANEW}",
                variable=variable,
            )
        rows = _rows(key, value.value if constant else value, constant=constant)
        if rows.shape != due:
            raise EvidenceError(
                f"evidence for {variable!r} has shape {rows.shape}, and {due} was prepared for; "
                f"{_ANEW}",
                variable=variable,
            )
        return rows

    def _reading(self, reading: Reading, rows: Mapping[Key, Rows]) -> Reading:
        """The measurements of a sensor."""
        sensor, step, lead = reading.cpd.child, reading.step, self.bound.lead
        values = rows[sensor, sensor] if sensor in self.steps else rows[sensor]
        if sensor in self.steps and sensor not in self._sorted:
            values = values[..., reading.order, :]
        taken = taken_of(sensor, values, step, 1)
        if taken is None:
            taken = _all(values.shape[-2:])
        else:
            values = np.where(taken, values, 0.0)
            taken = by_row(taken, lead)
        inputs = {}
        for v in reading.inputs:
            key = (sensor, v) if (sensor, v) in rows else v
            inputs[v] = self._input(rows, key, v, reading)
        order, unknown = reading.order, reading.unknown
        return Reading(reading.cpd, step, order, by_row(values, lead), taken, inputs, unknown)

    def _input(
        self, rows: Mapping[Key, Rows], key: Key, variable: Variable, reading: Reading | None
    ) -> Rows:
        """The values of an observed parent, at the rows of a sensor or at the steps 1..T."""
        found, (_, constant), lead = rows[key], self.shapes[key], self.bound.lead
        if constant:
            count = self.bound.steps if reading is None else len(reading.step)
            found = complete(variable, found)[..., None, :]
            return by_row(np.broadcast_to(found, (*found.shape[:-2], count, found.shape[-1])), lead)
        if reading is None or not isinstance(key, tuple):
            found = complete(variable, found, self._span)
            if reading is not None and reading.cpd.child in self.steps:
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
