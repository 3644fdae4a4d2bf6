"""True values, as a page shows them beside beliefs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats, is_whole
from pgm.errors import GraphError
from pgm.evidence.degrees import in_degrees
from pgm.factors.scope import labels, unknown_name
from pgm.inference import Posterior
from pgm.kernels.arrays import Array
from pgm.networks import Sample
from pgm.variables import Discrete, Variable

Truth = Mapping[Variable, npt.ArrayLike] | Sample


def truths(posterior: Posterior[Any], truth: Truth | None) -> dict[Variable, Array]:
    """The truth of each variable without evidence, (*runs, steps, d), or without the axis of steps.

    States of discrete variables are their indices, d = 1; NaN is not known. Variables of the
    network that were observed are left out: the truth of these is their evidence.
    """
    if truth is None:
        return {}
    given = truth.values if isinstance(truth, Sample) else truth
    if not isinstance(given, Mapping):
        raise GraphError(
            "truth= maps variables to their true values, or is what model.sample() has drawn, not "
            f"{type(truth).__name__}"
        )
    graph, over_time = posterior.graph, posterior.kind is not None
    known = (graph.model if over_time else graph.network).variables
    shown = graph.layout.slice if over_time else known
    lead, found = np.shape(posterior.log_evidence), {}
    for variable, values in given.items():
        if variable not in known:
            raise GraphError(f"truth= has {variable!r}, {unknown_name(variable, known)}")
        if variable in shown:
            rows = (graph.steps + (variable in graph.layout.states),) if over_time else ()
            found[variable] = _checked(variable, values, lead, rows)
    return found


def at_steps(values: Array, steps: range, last: int) -> Array:
    """The rows of a truth of one run, (rows, d), at some steps of 0..last; NaN before its first."""
    late = last + 1 - len(values)
    return np.concatenate([np.full((late, values.shape[-1]), np.nan), values])[
        steps[0] : steps[-1] + 1
    ]


def _checked(
    variable: Variable, values: npt.ArrayLike, lead: tuple[int, ...], rows: tuple[int, ...]
) -> Array:
    """A truth as (*lead, *rows, d), where `rows` are the steps of a variable over time."""
    what, discrete = f"the truth of {variable!r}", isinstance(variable, Discrete)
    array = _states(variable, values) if discrete else _values(variable, values, what)
    size = array.shape[-1:] if discrete else (variable.dimension,)
    own = (*rows, *size)
    if array.shape[-len(own) :] != own or not _broadcasts(array.shape[: -len(own)], lead):
        due = (*lead, *rows) if discrete else (*lead, *own)
        raise GraphError(
            f"{what} has the shape {np.shape(values)}; {due} was due, or without the axes of runs"
        )
    angles = [k for k in variable.components if k in variable.angles]
    if rows and (odd := in_degrees(array, labels((variable,)), angles)):
        raise GraphError(f"{what}: {odd}")
    return np.broadcast_to(array, (*lead, *own))


def _broadcasts(shape: tuple[int, ...], lead: tuple[int, ...]) -> bool:
    try:
        return np.broadcast_shapes(shape, lead) == lead
    except ValueError:
        return False


def _values(variable: Variable, values: npt.ArrayLike, what: str) -> Array:
    array = as_floats(values, what, labels=labels((variable,)))
    return array if array.ndim or variable.dimension > 1 else array[None]


def _states(variable: Any, values: npt.ArrayLike) -> Array:
    """States, by name or index, as indices (..., 1); NaN where one is not known, None or −1."""
    given = np.asarray(values, dtype=object)
    places = [
        np.nan if each is None or (is_whole(each) and each == -1) else variable.index(each)
        for each in given.reshape(-1).tolist()
    ]
    return np.array(places, dtype=np.float64).reshape(*given.shape, 1)
