"""Ancestral sampling: drawing children given their parents, one after another."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import zip_longest
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from pgm.boundary import as_tuple, is_whole
from pgm.cpds.base import Known, Values
from pgm.display import Listing, NoArray, Shown, Summary, vector
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import (
    BoundEvidence,
    Evidence,
    Reading,
    Sightings,
    bind,
    bind_values,
    sightings,
)
from pgm.evidence.rows import no_evidence_for
from pgm.factors.scope import listed, unknown_name
from pgm.immutable import Immutable
from pgm.resources import require_memory
from pgm.variables import Discrete, Variable

if TYPE_CHECKING:
    from pgm.networks.dynamic import DynamicBayesianNetwork
    from pgm.networks.static import BayesianNetwork

# What draws by the place of a variable, and the step or the readings drawn.
Source = Callable[[int, Any], Any]
# The most variables of a sample that are shown.
VARIABLES = 12


def draw(
    network: BayesianNetwork,
    n: int | tuple[int, ...],
    inputs: Evidence,
    rng: np.random.Generator,
) -> dict[Variable, Values]:
    """Draw each variable of a network without time after its parents."""
    shape = _as_shape("n", n, network.lead)
    require_memory(
        math.prod(shape) * sum(cpd.child.dimension or 1 for cpd in network.cpds),
        f"{n} draws of {len(network.cpds)} variables",
        "draw fewer at a time",
    )
    for variable in inputs:
        if variable not in network.variables:
            raise no_evidence_for(variable, network.variables)
        if variable not in network.inputs:
            raise EvidenceError(
                f"{variable!r} is no input of the network, whose inputs are "
                f"({listed(network.inputs)}); given evidence of other variables one infers, not "
                "samples",
                variable=variable,
            )
    bound = bind_values(network.cpds, inputs, shape, network.inputs)
    lead, runs = bound.lead, bound.runs
    values: dict[Variable, Values] = dict(bound.values)
    drawn: dict[Variable, Values] = {}
    for cpd in network.cpds:
        parents = {v: values[v] for v in cpd.parents}
        child = cpd._draw(Known(parents, lead, (runs,), cpd.child.step), rng)
        values[cpd.child] = child
        drawn[cpd.child] = child.reshape((*lead, *child.shape[1:]))
    return drawn


def _as_shape(name: str, asked: Any, lead: tuple[int, ...]) -> tuple[int, ...]:
    shape = asked if isinstance(asked, tuple) else (asked,)
    for length in shape:
        if not is_whole(length) or length < 1:
            raise ModelError(
                f"{name} is the number of draws, 1 or more, or a tuple of such; not {asked!r}"
            )
    # Not by NumPy, whose lengths end at 2⁶³: too many draws are refused for the memory they take.
    pairs = list(zip_longest(map(int, shape[::-1]), lead[::-1], fillvalue=1))
    if any(own != other and 1 not in (own, other) for own, other in pairs):
        raise ModelError(
            f"draws of shape {shape} do not broadcast with the model's axes of runs {lead}; "
            f"{name}=(1000, 1) draws a thousand for each"
        )
    return tuple(max(pair) for pair in reversed(pairs))


@dataclass(frozen=True, eq=False, repr=False)
class Sample(Shown, NoArray, Immutable):
    """A draw from a dynamic network.

    Attributes
    ----------
    values : mapping of Variable to ndarray
        States (*runs, T+1, d), controls (*runs, T, d), measurements (*runs, M, d); of discrete
        variables indices of states, without the last axis.
    evidence : mapping
        The inputs and the measurements, ready for `infer`.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> drawn = walk.sample(steps=3, rng=1)
    >>> drawn[x].shape, drawn[z].shape
    ((4, 1), (3, 1))
    >>> pgm.filter(walk, drawn.evidence)[x].mean.shape
    (4, 1)
    """

    values: Mapping[Variable, Values]
    evidence: Evidence

    _arrays: ClassVar[str] = "values by variable, sample[x]"

    def __getitem__(self, variable: Variable) -> Values:
        """The values of a variable, of the shape said above."""
        if variable not in self.values:
            raise ModelError(
                f"no values of {variable!r}, {unknown_name(variable, self.values, 'the sample')}",
                variable=variable,
            )
        return self.values[variable]

    @property
    def _title(self) -> str:
        return f"Sample({listed(self.values)})"

    def _summary(self) -> Summary:
        rows = []
        for variable, values in list(self.values.items())[:VARIABLES]:
            own = 0 if isinstance(variable, Discrete) else 1
            ends = [""] * 2
            if values.size:
                lead = values.ndim - own
                ends = [value(variable, values[(place,) * lead]) for place in (0, -1)]
            rows.append([repr(variable), str(values.shape), *ends])
        left = len(self.values) - len(rows)
        parts: list[Listing | str] = [Listing(["", "shape", "first", "last"], rows, names=4)]
        return Summary(self._title, parts + [f"... {left} more"] * (left > 0))


def value(variable: Variable, values: Values) -> str:
    """One value in a few words: its components, or the name of its state."""
    if isinstance(variable, Discrete):
        return variable.states[int(values)]
    return vector(values)


class Drawn(NamedTuple):
    """Values of hidden variables at steps 0..T, (T+1, runs, d), and of readings, (M, runs, d).

    Readings are in the order of the evidence, and axes of runs are flattened.
    """

    path: Mapping[Variable, Values]
    readings: Mapping[Variable, Values]


# What draws a model's variables, given evidence of its inputs, from a source.
Drawer = Callable[["DynamicBayesianNetwork", BoundEvidence, Source], Drawn]


def draw_steps(
    model: DynamicBayesianNetwork,
    inputs: Evidence,
    steps: int | None,
    runs: int | tuple[int, ...],
    source: Source,
    by: Drawer | None = None,
) -> Sample:
    """Draw states forward in time, then the measurements.

    `source` gives what the CPD of a child draws by, a generator: by the child's place among the
    model's variables, and the step; of a sensor by the places (m,) of its readings in the evidence.
    `by` draws them; `drawn_by_arrays` does without.
    """
    hidden = (*model.states, *model.controls)
    width = sum(variable.dimension or 1 for variable in hidden)
    shape = _as_shape("runs", as_tuple(runs) or runs, model.lead)
    _require_memory(shape, 1, width)
    bound = bind(model.transition, model.observation, inputs, steps, shape, drawing=True)
    _require_memory(bound.lead, bound.steps + 1, width)
    path, readings = (by or drawn_by_arrays)(model, bound, source)
    evidence: dict[Variable, Any] = dict(inputs)
    values = {v: _unflat(v, path[v], bound.lead) for v in model.states}
    values |= {v: _unflat(v, path[v][1:], bound.lead) for v in model.controls}
    for child, rows in readings.items():
        values[child] = _unflat(child, rows, bound.lead)
        asked = inputs.get(child)
        evidence[child] = (
            sightings(values[child], asked.step, asked.given)
            if isinstance(asked, Sightings)
            else values[child]
        )
    return Sample(MappingProxyType(values), MappingProxyType(evidence))


def places_of(model: DynamicBayesianNetwork) -> dict[Variable, int]:
    """The place of each variable, by which a source knows it."""
    return {variable: k for k, variable in enumerate(model.variables)}


def prior_drawn(
    model: DynamicBayesianNetwork,
    bound: BoundEvidence,
    source: Source,
    path: Mapping[Variable, Values],
) -> None:
    """Draw states at step 0 into the path; controls have none there."""
    place, count = places_of(model), bound.runs
    for variable in model.controls:
        path[variable][0] = _unfilled(variable, (count,))
    for cpd in model.prior:
        now = {v: path[v][0] for v in cpd.given}
        path[cpd.child][0] = cpd._draw(
            Known(now, bound.lead, (count,), 0), source(place[cpd.child], 0)
        )


def drawn_by_arrays(model: DynamicBayesianNetwork, bound: BoundEvidence, source: Source) -> Drawn:
    """Draw all runs together, step by step; of readings all of a sensor at once."""
    count, place = bound.runs, places_of(model)
    hidden = (*model.states, *model.controls)
    path = {v: _unfilled(v, (bound.steps + 1, count)) for v in hidden}
    prior_drawn(model, bound, source, path)
    for step in range(1, bound.steps + 1):
        for cpd, known in zip(model.transition, bound.transition, strict=True):
            values = {v: _states(v, rows[step - 1]) for v, rows in known.items()}
            for parent in cpd.given:
                if parent not in values:
                    values[parent] = path[parent.template][step - parent.lag]
            given = Known(values, bound.lead, (count,), step)
            path[cpd.child][step] = cpd._draw(given, source(place[cpd.child], step))
    readings = {}
    for reading in bound.readings:
        child = reading.cpd.child
        rows = _draw_reading(reading, path, count, bound.lead, source(place[child], reading.order))
        readings[child] = rows[np.argsort(reading.order)]
    return Drawn(path, readings)


def _require_memory(runs: tuple[int, ...], steps: int, width: int) -> None:
    require_memory(
        math.prod(runs) * steps * width,
        f"draws of {width} components at {steps} steps in {math.prod(runs)} runs",
        "draw fewer runs at a time, or fewer steps",
    )


def _draw_reading(
    reading: Reading,
    path: Mapping[Variable, Values],
    runs: int,
    lead: tuple[int, ...],
    rng: np.random.Generator,
) -> Values:
    values = {v: _states(v, rows) for v, rows in reading.inputs.items()}
    for parent in reading.cpd.given:
        if parent not in values:
            values[parent] = path[parent][reading.step]
    size = reading.step.size
    wide = {v: np.broadcast_to(a, (size, runs, *a.shape[2:])) for v, a in values.items()}
    if not size:
        return _unfilled(reading.cpd.child, (0, runs))
    return reading.cpd._draw(Known(wide, lead, (size, runs), reading.step[:, None]), rng)


def _unfilled(variable: Variable, lead: tuple[int, ...]) -> Values:
    if isinstance(variable, Discrete):
        return np.zeros(lead, dtype=np.intp)
    return np.full((*lead, variable.dimension), np.nan)


def _states(variable: Variable, rows: Values) -> Values:
    return rows[..., 0] if isinstance(variable, Discrete) else rows


def _unflat(variable: Variable, rows: Values, lead: tuple[int, ...]) -> Values:
    own = () if isinstance(variable, Discrete) else (rows.shape[-1],)
    return rows.swapaxes(0, 1).reshape(*lead, rows.shape[0], *own)
