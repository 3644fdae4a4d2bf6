"""Completed tables of records: what was observed, and the beliefs of what was not."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.errors import EvidenceError
from pgm.factors.axes import MISSING
from pgm.factors.listing import index_of, run_names, with_units
from pgm.factors.scope import column_names
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.posteriors.entered import Entered
from pgm.resources import FRAMES, optional
from pgm.variables import Discrete, Variable


def completed(posterior: Any, entered: Entered) -> Any:
    """The frame of `Posterior.to_frame` without variables; `entered` is its evidence."""
    pandas = optional("pandas", "Posterior.to_frame()", FRAMES)
    lead = entered.cells.lead
    variables = dict.fromkeys([*entered.cells.variables, *posterior._hidden])
    values: dict[str, Any] = {}
    more: dict[str, Any] = {}
    units: dict[str, str] = {}
    for variable in variables:
        if isinstance(variable, Discrete):
            states, probabilities = _states(posterior, entered, variable)
            names = np.array([*variable.states, None], dtype=object)
            _put(values, repr(variable), names[states], variable)
            _put(more, f"probability_{variable!r}", probabilities, variable)
            continue
        means, stds = _moments(posterior, entered, variable)
        named = zip(column_names(variable), variable.components, strict=True)
        for k, (name, component) in enumerate(named):
            _put(values, name, means[:, k], variable)
            _put(more, f"std_{name}", stds[:, k], variable)
            units[name] = units[f"std_{name}"] = variable.unit_of(component)
    for name, column in more.items():
        _put(values, name, column)
    index = index_of(pandas, list(map(range, lead)), run_names(len(lead)))
    frame = pandas.DataFrame(values, index=index)
    with_units(frame, units)
    return frame


def _put(columns: dict[str, Any], name: str, column: Any, variable: Variable | None = None) -> None:
    if name in columns:
        raise EvidenceError(
            f"two columns of the completed table would be called {name!r}; rename one of the "
            "variables, or take posterior[...] of each",
            variable=variable,
        )
    columns[name] = column


def _states(posterior: Any, entered: Entered, variable: Discrete) -> tuple[Integers, Array]:
    """The state of each run that was observed, or is likeliest, −1 for none; its probability."""
    cells = entered.cells
    seen = np.full(cells.runs, MISSING)
    if variable in cells.states:
        seen = np.broadcast_to(cells.rows(variable), (cells.runs,))
    known: Mask = seen != MISSING
    if known.all():
        return seen, np.ones(cells.runs)
    share = posterior[variable].probabilities.reshape(-1, variable.size)
    share = np.broadcast_to(share, (cells.runs, variable.size))
    best = np.where(np.isnan(share).any(axis=1), MISSING, share.argmax(axis=1))
    return np.where(known, seen, best), np.where(known, 1.0, share.max(axis=1))


def _moments(posterior: Any, entered: Entered, variable: Variable) -> tuple[Array, Array]:
    """The values that were observed, with no deviation, and the moments of others, (runs, d)."""
    cells = entered.cells
    shape = cells.runs, variable.dimension
    seen = np.full(shape, np.nan)
    if variable in cells.values:
        seen = np.broadcast_to(cells.rows(variable), shape)
    known = ~np.isnan(seen)
    means = stds = np.full(shape, np.nan)
    if not known.all():
        try:
            belief = posterior._moments(variable)
            means, stds = belief.mean.reshape(-1, shape[1]), belief.std.reshape(-1, shape[1])
        except EvidenceError:  # a reading of robust noise, say, that was not taken in some run
            if variable not in cells.values:
                raise
    return np.where(known, seen, means), np.where(known, 0.0, stds)
