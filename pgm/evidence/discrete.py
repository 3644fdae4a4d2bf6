"""Evidence of a discrete network, checked once and laid out by run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.boundary import as_floats
from pgm.errors import EvidenceError
from pgm.evidence.arrays import no_evidence_for
from pgm.evidence.values import Constant, Sightings, Soft
from pgm.factors.indices import as_indices
from pgm.factors.runs import Place, common_runs, flat, in_run
from pgm.factors.scope import listed
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
        Those of the network; a set spares making one.
    evidence : mapping of Discrete
        The name or index of a state, an array of names or indices (...), with −1 for "not
        observed in this run", or `soft` weights (..., size). Leading axes are runs.

    Raises
    ------
    EvidenceError
        If a variable or a state is unknown, an index is no whole number, weights are negative,
        not finite or all zero, or the runs do not broadcast or are none.
    """
    known = variables if isinstance(variables, Set) else frozenset(variables)
    states: dict[Discrete, int | Integers] = {}
    stacked: dict[Discrete, Integers] = {}
    weighted: dict[Discrete, Array] = {}
    for variable, value in evidence.items():
        if variable not in known:
            raise no_evidence_for(variable, known)
        # A single name or index is what most queries are made of: no array is made for it.
        kind = type(value)
        if kind is str and value in variable.states:
            states[variable] = variable.states.index(value)
        elif kind is int and -1 <= value < len(variable.states):
            if value >= 0:
                states[variable] = value
        elif isinstance(value, Soft):
            weighted[variable] = as_weights(variable, value)
        elif isinstance(value, Sightings | Constant):
            raise _of_dynamic(variable, value)
        else:
            stacked[variable] = as_indices(variable, value)
    if not stacked and not weighted:
        return BoundStates((), states, weighted)
    shapes = {v: array.shape for v, array in stacked.items()}
    shapes |= {v: array.shape[:-1] for v, array in weighted.items()}
    lead = common_runs(shapes.items())
    for variable, array in stacked.items():
        if array.max() >= 0:
            states[variable] = array.item() if array.ndim == 0 else flat(array, lead, 0)
    return BoundStates(lead, states, {v: flat(array, lead, 1) for v, array in weighted.items()})


def _of_dynamic(variable: Discrete, value: Sightings | Constant) -> EvidenceError:
    what = "sightings" if isinstance(value, Sightings) else "a constant"
    return EvidenceError(
        f"{what} of {variable!r}, a discrete variable: they are for dynamic networks; give the "
        f"state itself, {{{variable!r}: {variable.states[0]!r}}}, or soft weights; its states are "
        f"({listed(variable.states)})",
        variable=variable,
    )


def as_weights(variable: Discrete, value: Soft, where: Place = in_run) -> Array:
    """The weights of soft evidence, (..., size); a message has where the first bad ones are."""
    what = f"soft evidence for {variable!r}"
    states = f"({listed(variable.states)})"
    if isinstance(value.weights, Mapping):
        raise EvidenceError(
            f"{what}: the weights are a mapping; give them as a row, in the order of the states "
            f"{states}",
            variable=variable,
        )
    array = as_floats(
        value.weights,
        f"{what}: the weights, one for each of the states {states},",
        EvidenceError,
        labels=variable.states,
        variable=variable,
    ).copy()
    if array.shape[-1:] != (variable.size,):
        raise EvidenceError(
            f"{what}: the weights have shape {array.shape}; the last axis must hold one for each "
            f"of the states {states}",
            variable=variable,
        )
    bad = ~np.isfinite(array) | (array < 0.0)
    if bad.any():
        raise EvidenceError(
            f"{what}: weights that are negative, NaN or infinite{where(bad.any(axis=-1))}",
            variable=variable,
        )
    empty = ~array.any(axis=-1)
    if empty.any():
        raise EvidenceError(
            f"{what}: the weights are all zero{where(empty)}; a state that is possible needs a "
            "positive one, and equal ones say nothing",
            variable=variable,
        )
    return array
