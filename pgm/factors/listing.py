"""Factors as text: tables by rows of the last variable's states, canonical forms by components."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pgm.display import Listing, Summary, column, few, named_matrix, number, places
from pgm.display.summary import LEFT_OUT, Place
from pgm.factors.axes import States, sizes
from pgm.factors.scope import MOST, Scope, components, listed
from pgm.kernels.arrays import Array
from pgm.kernels.tables import entries

# How many states a row lists, and how many rows a table.
STATES = 6
ROWS = 12
# Significant digits of an entry.
DIGITS = 3
# Beyond this, a log-scale is shown as a factor: numbers would have too many digits before them.
SCALE = 10.0


def title(scope: States, lead: tuple[int, ...]) -> str:
    """The variables of a table, in one line."""
    many = f" of {sizes(scope)} states" if 1 < len(scope) <= MOST else ""
    return f"Table({listed(scope)}){many}" + (f", {lead} of them" if lead else "")


def summary(scope: States, values: Array, log_scale: Array) -> Summary:
    """A table with its entries: a row for the states of all variables but the last."""
    lead = log_scale.shape
    if not scope:
        return _numbers(log_scale, values)
    if len(scope) == 1 and not lead:
        return Summary(f"Table({scope[0]!r}: {_row(scope, values, log_scale)})")
    last = scope[-1]
    across = few(last.size, STATES)
    columns = [k for k in across if k is not None]
    shown = places(values.shape[:-1], ROWS)
    found = [at for at in shown if at is not None]
    each = [_entries(values[at], log_scale[at[: len(lead)]]) for at in found]
    numbers = {k: column([part[k] for part, _ in each], DIGITS) for k in columns}
    scaled = any(factor for _, factor in each)
    rows: dict[Place, list[str]] = {}
    for row, (at, (_, factor)) in enumerate(zip(found, each, strict=True)):
        states = zip(scope, at[len(lead) :], strict=False)
        cells = [str(list(at[: len(lead)]))] if lead else []
        cells += [variable.states[k] for variable, k in states]
        cells += [LEFT_OUT if k is None else numbers[k][row] for k in across]
        rows[at] = cells + [factor] * scaled
    names = [""] * bool(lead) + [repr(variable) for variable in scope[:-1]]
    heads = [LEFT_OUT if k is None else last.states[k] for k in across]
    heads[0] = f"{last!r}: {heads[0]}"
    listing = Listing(
        [*names, *heads, *["times"] * scaled],
        [None if at is None else rows[at] for at in shown],
        len(names),
    )
    return Summary(title(scope, lead), [listing] if found else [])


def shown(scope: States, values: Array) -> Sequence[str | Listing]:
    """The entries of a table, without its title."""
    if len(scope) == 1:
        return [_row(scope, values, np.zeros(()))]
    return summary(scope, values, np.zeros(())).parts


def _numbers(log_scale: Array, values: Array) -> Summary:
    lead = log_scale.shape
    found = [at for at in places(lead, STATES) if at is not None]
    each = (_entries(values[at], log_scale[at]) for at in found)
    parts = [f"{value:.3g}" + (f" times {factor}" if factor else "") for value, factor in each]
    return Summary(title((), lead) if lead else "Table()", [", ".join(parts)] if parts else [])


def _entries(values: Array, log_scale: Array) -> tuple[Array, str]:
    if abs(log_scale) < SCALE:
        return entries(values, log_scale), ""
    return values, f"exp({log_scale:.6g})"


def states_of(table: Any, run: tuple[int, ...] = ()) -> str:
    """The first states of the only variable of a table, of one of its runs."""
    return _row(table.scope, table.values[run], table.log_scale[run])


def _row(scope: States, values: Array, log_scale: Array) -> str:
    values, factor = _entries(values, log_scale)
    states = scope[-1].states
    shown = [f"{s} {p:.3g}" for s, p in zip(states[:STATES], values, strict=False)]
    if len(states) > STATES:
        shown.append(f"... {len(states)} states")
    return ", ".join(shown) + (f"; times {factor}" if factor else "")


def canonical_summary(title: str, scope: Scope, K: Array, h: Array, g: Array) -> Summary:
    """A canonical form's constant, vector and matrix; of several forms those of the first."""
    if not g.size:
        return Summary(title)
    first = (0,) * g.ndim
    heads = components(scope)
    scale = f"g = {number(g[first], 6)}"
    if first:
        scale = f"run {', '.join(map(str, first))}: {scale}"
    if not heads:
        return Summary(title, [scale])
    matrix = named_matrix(heads, heads, K[first], "K", before=[("h", h[first])])
    return Summary(title, [scale, matrix])
