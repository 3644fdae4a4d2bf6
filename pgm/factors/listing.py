"""Tables as text: rows of the last variable's states with their entries."""

from __future__ import annotations

import math

import numpy as np

from pgm.factors.axes import States, sizes
from pgm.factors.scope import names
from pgm.kernels.arrays import Array
from pgm.kernels.tables import entries

# How many states a row lists, and how many rows a table.
STATES = 6
ROWS = 8
# Beyond this, a log-scale is shown as a factor: numbers would have too many digits before them.
SCALE = 10.0


def title(scope: States, lead: tuple[int, ...]) -> str:
    """The variables of a table, in one line."""
    many = f" of {sizes(scope)} states" if len(scope) > 1 else ""
    return f"Table{names(scope)}{many}" + (f", {lead} of them" if lead else "")


def rows(scope: States, values: Array, log_scale: Array) -> str:
    """A table with its entries, where these are few."""
    lead = log_scale.ndim
    if len(scope) == 1 and not lead:
        return f"Table({scope[0]!r}: {_row(scope, values, log_scale)})"
    lines = [title(scope, log_scale.shape)]
    before = values.shape[:-1]
    if not scope or math.prod(before) > ROWS:
        return lines[0]
    for at in np.ndindex(*before):
        run, states = at[:lead], at[lead:]
        where = [f"{v!r} {v.states[k]}" for v, k in zip(scope, states, strict=False)]
        where.append(repr(scope[-1]))
        which = f"[{', '.join(map(str, run))}] " if run else ""
        found = _row(scope, values[at], np.asarray(log_scale[run]))
        lines.append(f"  {which}{', '.join(where)}: {found}")
    return "\n".join(lines)


def _row(scope: States, values: Array, log_scale: Array) -> str:
    """The first states of the last variable with their entries."""
    factor = f"; times exp({log_scale:.6g})"
    if abs(log_scale) < SCALE:
        values, factor = entries(values, log_scale), ""
    states = scope[-1].states
    shown = [f"{s} {p:.3g}" for s, p in zip(states[:STATES], values, strict=False)]
    if len(states) > STATES:
        shown.append(f"... {len(states)} states")
    return ", ".join(shown) + factor
