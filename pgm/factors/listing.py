"""Factors as text, and as data frames of pandas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from pgm.arguments import public
from pgm.display import Listing, Summary, column, few, named_matrix, number, places
from pgm.display.summary import LEFT_OUT, Place
from pgm.errors import ModelError, NumericalError
from pgm.factors.axes import States, sizes
from pgm.factors.scope import MOST, Scope, components, listed, names
from pgm.kernels import tables as kernel
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.tables import entries
from pgm.resources import FRAMES, optional

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
    """The first few states of a table of one variable, for one of its runs."""
    return _row(table.scope, table.values[run], table.log_scale[run])


def _row(scope: States, values: Array, log_scale: Array) -> str:
    values, factor = _entries(values, log_scale)
    states = scope[-1].states
    shown = [f"{s} {p:.3g}" for s, p in zip(states[:STATES], values, strict=False)]
    if len(states) > STATES:
        shown.append(f"... {len(states)} states")
    return ", ".join(shown) + (f"; times {factor}" if factor else "")


def canonical_summary(title: str, scope: Scope, K: Array, h: Array, g: Array) -> Summary:
    """A canonical form's g, h and K as text; of several forms, the first."""
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


class Moments(Protocol):
    """A belief with means and standard deviations, of the components of its last axis."""

    @property
    def components(self) -> tuple[str, ...]:
        """The names of the components."""

    @property
    def units(self) -> tuple[str, ...]:
        """The units of the components."""

    @property
    def mean(self) -> Array:
        """(..., n)."""

    @property
    def std(self) -> Array:
        """Standard deviations, (..., n)."""

    @property
    def steps(self) -> Integers | None:
        """The steps that the last leading axis stands for."""


class Framed:
    """A belief whose moments make a data frame."""

    __slots__ = ()

    def to_frame(self: Moments) -> Any:
        """The means and standard deviations as a data frame of pandas.

        A row for each run and step, in the index: the level ``run``, or ``run_0``, ``run_1``, ...
        where runs have several axes, and the level ``step``, where there are any. Covariances are
        in `cov` alone, and `to_xarray` of a posterior.

        Columns are ``mean_<component>``, then ``std_<component>``, in units of the components,
        which ``frame.attrs["units"]`` has by column where they are known. An `ImportError` says how
        to install pandas where it is missing.

        Examples
        --------
        >>> x = pgm.Variable("x", components=("east", "north"))
        >>> walk = pgm.Gaussian(x, mean=[[0, 5], [1, 6], [2, 7]], cov=0.25, steps=[0, 1, 2])
        >>> frame = walk.to_frame()
        >>> list(frame.columns), frame.index.name
        (['mean_east', 'mean_north', 'std_east', 'std_north'], 'step')
        >>> frame["mean_north"].tolist()
        [5.0, 6.0, 7.0]
        """
        lead = self.mean.shape[:-1]
        levels: list[Any] = list(map(range, lead))
        titles = run_names(len(lead) - (self.steps is not None))
        if self.steps is not None:
            levels[-1], titles = self.steps, [*titles, "step"]
        what = f"{type(self).__name__}.to_frame()"
        return moments_frame(self.mean, self.std, self.components, self.units, levels, titles, what)


def moments_frame(
    mean: Array,
    std: Array,
    components: Sequence[str],
    units: Sequence[str],
    levels: Sequence[Any],
    titles: Sequence[str],
    what: str,
) -> Any:
    """Means and deviations (..., n) as a data frame, with a level of the index for each axis.

    `units` has the components' units, empty where they are unknown; `levels` the labels along each
    of the leading axes, `titles` their names; `what` is the call, for the error where pandas is
    missing.
    """
    pandas = optional("pandas", what, FRAMES)
    columns = {
        f"{name}_{label}": moment[..., k].reshape(-1)
        for name, moment in (("mean", mean), ("std", std))
        for k, label in enumerate(components)
    }
    frame = pandas.DataFrame(columns, index=index_of(pandas, levels, titles))
    with_units(frame, dict(zip(columns, (*units, *units), strict=True)))
    return frame


def with_units(frame: Any, columns: Mapping[str, str]) -> None:
    """Note the units of a data frame's columns among its attributes, where they are known."""
    if known := {column: unit for column, unit in columns.items() if unit}:
        frame.attrs["units"] = known


def run_names(axes: int) -> list[str]:
    """The names of axes of runs."""
    return ["run"] if axes == 1 else [f"run_{k}" for k in range(axes)]


class Entries(Protocol):
    """A table."""

    scope: States
    values: Array
    log_scale: Array

    @property
    def _title(self) -> str: ...


class FramedTable:
    """A table whose entries make a data frame."""

    __slots__ = ()

    @public
    def to_frame(self: Entries, *, axes: str | Sequence[str] | None = None) -> Any:
        """The entries as a data frame of pandas, with the states of the last variable as columns.

        A row for each of the leading axes' places and each combination of the other variables'
        states, levels of the index that are named like these. A table without variables has the
        one column ``value``. An entry that is too large for a number is a `NumericalError`.

        Parameters
        ----------
        axes : str or sequence of str, optional
            The names of the leading axes, ``"step"`` of ``posterior[x]``, since a table does not
            know what they are of; ``axis`` or ``axis_0``, ``axis_1``, ... without.

        Examples
        --------
        >>> rain, wet = (pgm.Discrete(name, states=("no", "yes")) for name in ("rain", "wet"))
        >>> frame = pgm.Table((rain, wet), [[0.9, 0.1], [0.3, 0.7]]).to_frame()
        >>> frame.index.tolist(), frame.columns.tolist(), float(frame.loc["yes", "no"])
        (['no', 'yes'], ['no', 'yes'], 0.3)
        """
        pandas = optional("pandas", "Table.to_frame()", FRAMES)
        lead, scope = self.log_scale.shape, self.scope
        log_scale = self.log_scale.reshape(lead + (1,) * len(scope))
        values = np.asarray(kernel.entries(self.values, log_scale))
        if np.isinf(values).any():
            raise NumericalError(
                f"an entry of the table over {names(scope)} is too large for a number; take "
                "log_values"
            )
        if axes is None:
            axes = ["axis"] if len(lead) == 1 else [f"axis_{k}" for k in range(len(lead))]
        titles = [axes] if isinstance(axes, str) else list(axes)
        if len(titles) != len(lead):
            raise ModelError(f"axes= has {len(titles)} names; {self._title} has axes {lead}")
        levels = [*map(range, lead), *(variable.states for variable in scope[:-1])]
        columns = pandas.Index(["value"])
        if scope:
            columns = pandas.Index(scope[-1].states, name=repr(scope[-1]))
        index = index_of(pandas, levels, [*titles, *map(repr, scope[:-1])])
        return pandas.DataFrame(values.reshape(len(index), -1), index=index, columns=columns)


def index_of(pandas: Any, levels: Sequence[Any], titles: Sequence[str]) -> Any:
    """The index of a data frame of pandas: labels of each axis, with the names of axes."""
    if len(levels) > 1:
        return pandas.MultiIndex.from_product(levels, names=titles)
    return pandas.Index(levels[0], name=titles[0]) if levels else pandas.RangeIndex(1)
