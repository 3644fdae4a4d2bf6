"""Evidence of a discrete network, checked once and laid out by run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.errors import EvidenceError
from pgm.evidence.indices import as_indices, in_run
from pgm.evidence.values import Soft
from pgm.factors.scope import names
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False)
class BoundStates:
    """Evidence of a discrete network.

    Attributes
    ----------
    lead : tuple of int
        The leading axes, of runs; inside, they are flattened to one.
    states : mapping of Discrete to int or ndarray of int
        Hard evidence: one index for all runs, or an index for each, (runs or 1,), where −1 is
        "not observed in this run". A variable that is observed in no run is left out.
    weights : mapping of Discrete to ndarray
        Soft evidence, (runs or 1, size), each row with a positive entry.
    """

    lead: tuple[int, ...]
    states: Mapping[Discrete, int | Integers]
    weights: Mapping[Discrete, Array]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return math.prod(self.lead)


def bind_discrete(variables: Iterable[Variable], evidence: Mapping[Any, Any]) -> BoundStates:
    """Check evidence against the variables of a discrete network and lay it out by run.

    Parameters
    ----------
    variables : iterable of Discrete
        Those of the network; a frozenset spares making one.
    evidence : mapping of Discrete
        The name or index of a state, an array of names or indices (...), with −1 for "not
        observed in this run", or `soft` weights (..., size). Leading axes are runs.

    Raises
    ------
    EvidenceError
        If a variable or a state is unknown, an index is no whole number, weights are negative,
        not finite or all zero, or the runs do not broadcast or are none.
    """
    known = variables if isinstance(variables, frozenset) else frozenset(variables)
    states: dict[Discrete, int | Integers] = {}
    stacked: dict[Discrete, Integers] = {}
    weighted: dict[Discrete, Array] = {}
    for variable, value in evidence.items():
        if variable not in known:
            raise _unknown(variable, known)
        # A single name or index is what most queries are made of: no array is made for it.
        kind = type(value)
        if kind is str and value in variable.states:
            states[variable] = variable.states.index(value)
        elif kind is int and -1 <= value < len(variable.states):
            if value >= 0:
                states[variable] = value
        elif isinstance(value, Soft):
            weighted[variable] = _as_weights(variable, value)
        else:
            stacked[variable] = as_indices(variable, value)
    if not stacked and not weighted:
        return BoundStates((), states, weighted)
    shapes = {v: array.shape for v, array in stacked.items()}
    shapes |= {v: array.shape[:-1] for v, array in weighted.items()}
    lead = _runs(shapes)
    for variable, array in stacked.items():
        if array.max() >= 0:
            states[variable] = array.item() if array.ndim == 0 else _flat(array, lead, 0)
    return BoundStates(lead, states, {v: _flat(array, lead, 1) for v, array in weighted.items()})


def _unknown(variable: Any, known: frozenset[Variable]) -> EvidenceError:
    if not isinstance(variable, Variable):
        return EvidenceError(
            f"evidence for {variable!r}, which is no variable; its keys are variables, "
            "{rain: 'yes'}"
        )
    return EvidenceError(
        f"evidence for {variable!r}, which the network does not have; it has "
        f"{sorted(map(repr, known))}",
        variable=variable,
    )


def _as_weights(variable: Discrete, value: Soft) -> Array:
    """The weights of soft evidence, (..., size)."""
    what = f"soft evidence for {variable!r}"
    try:
        array = np.array(value.weights, dtype=float)
    except (TypeError, ValueError):
        raise EvidenceError(
            f"{what}: the weights must be numbers, not {value.weights!r}", variable=variable
        ) from None
    if array.shape[-1:] != (variable.size,):
        raise EvidenceError(
            f"{what}: the weights have shape {array.shape}; the last axis must hold one for each "
            f"of the states {variable.states}",
            variable=variable,
        )
    bad = ~np.isfinite(array) | (array < 0.0)
    if bad.any():
        raise EvidenceError(
            f"{what}: weights that are negative, NaN or infinite{in_run(bad.any(axis=-1))}",
            variable=variable,
        )
    empty = ~array.any(axis=-1)
    if empty.any():
        raise EvidenceError(
            f"{what}: the weights are all zero{in_run(empty)}; a state that is possible needs a "
            "positive one, and equal ones say nothing",
            variable=variable,
        )
    return array


def _runs(shapes: Mapping[Discrete, tuple[int, ...]]) -> tuple[int, ...]:
    """The axes of runs that all evidence broadcasts to."""
    try:
        lead = np.broadcast_shapes(*shapes.values())
    except ValueError:
        listed = ", ".join(f"{variable!r} {shape}" for variable, shape in shapes.items() if shape)
        raise EvidenceError(
            f"the leading axes of the evidence do not broadcast to one set of runs: {listed}"
        ) from None
    if 0 in lead:
        raise EvidenceError(
            f"the evidence for {names(shapes)} has the axes of runs {lead}: there is no run in it"
        )
    return lead


def _flat(array: Any, lead: tuple[int, ...], own: int) -> Any:
    """Arrays (..., own axes) with the axes of runs as one, of length runs or 1."""
    rest = array.shape[array.ndim - own :]
    if math.prod(array.shape[: array.ndim - own]) > 1:
        array = np.broadcast_to(array, (*lead, *rest))
    flat = array.reshape(-1, *rest)
    flat.flags.writeable = False
    return flat
