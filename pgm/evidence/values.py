"""The values of evidence that are no plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy.typing as npt

from pgm.display import InCode, Shown, Summary, as_numbers, brief, table
from pgm.errors import EvidenceError
from pgm.factors.scope import listed
from pgm.immutable import Immutable
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class Constant(InCode):
    """A value that is equal at all steps; made by `constant`."""

    value: Any

    def __repr__(self) -> str:
        return f"Constant(value={brief(self.value)})"


@dataclass(frozen=True, eq=False, repr=False)
class Soft(InCode):
    """Weights of the states of a discrete variable; made by `soft`."""

    weights: Any

    def __repr__(self) -> str:
        return f"Soft(weights={brief(self.weights)})"


class Sightings(Shown, Immutable):
    """Measurements of one sensor at any steps; made by `sightings`."""

    __slots__ = ("given", "step", "values")

    values: Any
    step: Any
    given: Mapping[Variable, Any]

    def __init__(
        self, values: Any, step: Any = None, given: Mapping[Variable, Any] = MappingProxyType({})
    ) -> None:
        put = object.__setattr__
        put(self, "values", values)
        put(self, "step", step)
        put(self, "given", given)

    @property
    def _title(self) -> str:
        shape = getattr(self.values, "shape", None)
        values = brief(self.values) if shape is None else f"of shape {shape}"
        return f"Sightings({values}, given [{listed(self.given)}])"

    def _summary(self) -> Summary:
        values, step = as_numbers(self.values), as_numbers(self.step)
        if values is None or values.ndim < 2 or not values.size:
            return Summary(self._title)
        first = (0,) * (values.ndim - 2)
        rows = values[first]
        columns = [] if step is None or step.shape != rows.shape[:1] else [("step", step)]
        columns += [("value", rows), *((repr(v), given) for v, given in self.given.items())]
        which = [f"run {', '.join(map(str, first))}:"] if first else []
        return Summary(self._title, [*which, table(columns)])


# By variable: a plain array, a constant, or sightings; of a discrete one states, or soft weights.
Evidence = Mapping[Variable, Any]


def constant(value: npt.ArrayLike) -> Constant:
    """Evidence that is equal at all steps.

    Parameters
    ----------
    value : array_like
        (..., d); leading axes are runs.

    Returns
    -------
    Constant
        Evidence, checked where it is used.

    Examples
    --------
    >>> constant([0.5, 0.0])
    Constant(value=[0.5, 0.0])
    """
    return Constant(value)


def soft(weights: npt.ArrayLike) -> Soft:
    """Soft (virtual, likelihood) evidence for a discrete variable.

    The belief is multiplied by the weights, as by an observed child with p(measurement | state)
    proportional to them.

    Parameters
    ----------
    weights : array_like
        (..., size), one for each state, non-negative and not all zero; leading axes are runs.
        They need not sum to one: marginals depend on their ratios alone, and a common factor
        enters the log-evidence.

    Returns
    -------
    Soft
        Evidence, checked where it is used.

    References
    ----------
    Pearl, Probabilistic Reasoning in Intelligent Systems, 1988, section 2.2.2.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> pgm.query(rainy, rain, {wet: pgm.soft([0.0, 1.0])})
    Table(rain: no 0.25, yes 0.75)
    >>> pgm.query(rainy, rain, {rain: pgm.soft([1.0, 4.0])})
    Table(rain: no 0.2, yes 0.8)
    """
    return Soft(weights)


def sightings(
    values: npt.ArrayLike | None = None,
    step: npt.ArrayLike | None = None,
    given: Mapping[Variable, npt.ArrayLike | Constant] | None = None,
) -> Sightings:
    """Any number of measurements of one sensor at any steps, none included.

    Parameters
    ----------
    values : array_like
        (..., M, d); leading axes are runs; NaN is a component not taken, a row of NaN a measurement
        not taken. Left out where a model is to draw them (`DynamicBayesianNetwork.sample`).
    step : array_like of int
        (M,), in 0..T, in any order, repeats allowed, shared by all runs. Left out online, where
        measurements belong to the current step.
    given : mapping of Variable to array_like, optional
        The sensor's observed parents that differ from measurement to measurement, (..., M, d) each.

    Returns
    -------
    Sightings
        Evidence, whose shapes and steps are checked where it is used.

    Raises
    ------
    EvidenceError
        If `given` is no mapping.

    Examples
    --------
    >>> m = Variable("m", components=("east", "north"))
    >>> seen = sightings([[2.0, 0.1], [3.0, -0.2]], step=[4, 4], given={m: [[0, 1], [5, 1]]})
    """
    if type(given) is not dict and not isinstance(given, Mapping | None):
        raise EvidenceError(
            f"sightings: given maps parents to their values, given={{m: landmarks}}; found "
            f"{type(given).__name__}"
        )
    return Sightings(values, step, MappingProxyType(dict(given or {})))
