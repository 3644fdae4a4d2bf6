"""Beliefs over finitely many states through time: a row a step, one below the other."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import to_rgba
from matplotlib.ticker import FuncFormatter, MaxNLocator

from pgm.arguments import public
from pgm.display import titled
from pgm.errors import ModelError
from pgm.factors import Table
from pgm.factors.scope import names
from pgm.inference import GridBelief, Kind
from pgm.kernels.arrays import Array
from pgm.plot.drawing.axes import given_or_new, name_axes, plain, useful_legend
from pgm.plot.drawing.colours import DASHES, INK, MUTED, PALETTE
from pgm.variables import Discrete

# More rows than this are too low to be read.
_ROWS = 16
# The part of a row that the largest probability takes.
_FULL = 0.86
# A belief's drawing remembers by what its rows are scaled, for the next one on the same axes.
_SCALE = "row of "


@public
def beliefs_over_time(
    belief: Table,
    *,
    steps: Sequence[int] | None = None,
    truth: npt.ArrayLike | None = None,
    full: float | None = None,
    filled: bool | None = None,
    label: str | Kind | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw a belief over the states of a variable at each step, time going down.

    All rows have one scale, which the label of the vertical axis tells. Call it again with the
    same `ax` to compare beliefs: the first is filled, the next are outlines on its scale.

    Parameters
    ----------
    belief : Table
        Over one variable and steps, as ``posterior[x]``; of one run. Steps are counted from 0: a
        hidden control, of steps 1..T, has its row k for step k + 1.
    steps : sequence of int, optional
        The steps to draw; all without, or as many as leave at most 16 rows.
    truth : array_like, optional
        (all steps,): the right state at each step, by name or number, marked by a line.
    full : float, optional
        The probability that fills a row; the largest of the belief without.
    filled : bool, optional
        Whether the belief is filled, or an outline; the first of the axes is filled without.
    label : str or Kind, optional
        In the legend, above the axes.
    colour, ax
        See `trajectory`.

    Raises
    ------
    ModelError
        If the belief is over several variables or runs, or no steps, or an argument does not fit.
    NumericalError
        If a belief is all zero.

    Examples
    --------
    >>> rain = pgm.Discrete("rain", states=("no", "yes"))
    >>> belief = pgm.Table(rain, [[0.5, 0.5], [0.2, 0.8], [0.1, 0.9]], lead=3)
    >>> ax = pgm.plot.beliefs_over_time(belief, label="filtered", truth=["no", "yes", "yes"])
    """
    found = chances(belief, (1,), 1, "beliefs over one variable with one leading axis, of steps")
    (variable,) = belief.scope
    count = len(found)
    chosen = _steps(steps, count)
    right = None if truth is None else as_truth_states(variable, truth, count)
    if full is not None and not (np.isfinite(full) and full > 0.0):
        raise ModelError(f"full must be a probability above 0, not {full!r}")

    ax = given_or_new(ax)
    before = [line for line in ax.lines if str(line.get_gid() or "").startswith(_SCALE)]
    known = float(str(before[0].get_gid()).removeprefix(_SCALE)) if before else None
    if known is not None and full is not None and full != known:
        raise ModelError(
            f"full is {full:g}, but rows of these axes are {known:g} high already; leave it out, "
            "or give it with the first belief"
        )
    scale = float(known or full or found[chosen].max())
    solid = not before if filled is None else filled
    count_before = len({(line.get_color(), line.get_linestyle()) for line in before})
    tint = colour or PALETTE[count_before % len(PALETTE)]
    dash = DASHES[count_before // len(PALETTE) % len(DASHES)]
    edges = np.arange(variable.size + 1) - 0.5
    for row, step in enumerate(chosen):
        height = row - _FULL * found[step] / scale
        if not before:
            ax.axhline(row, color=MUTED, lw=0.5, zorder=1.0)
        if solid:
            top = np.append(height, height[-1])
            ax.fill_between(
                edges, row, top, step="post", color=to_rgba(tint, 0.3), lw=0, zorder=1.5
            )
        (line,) = ax.step(
            np.concatenate([edges[:1], edges, edges[-1:]]),
            np.concatenate([[row, row], height, [row]]),
            where="pre",
            color=tint,
            ls=dash,
            lw=1.2,
            zorder=2.0 if solid else 2.2,
            gid=f"{_SCALE}{scale!r}",
        )
        if row == 0 and label is not None:
            line.set_label(plain(str(label)))
    if right is not None:
        rows = np.arange(len(chosen))
        ax.vlines(
            right[chosen], rows - _FULL, rows, color=INK, lw=1.2, ls=":", zorder=2.4, label="truth"
        )
    # The scale is the first belief's; a later one may reach beyond its rows.
    highest = -1.05 * _FULL * float(found[chosen[0]].max()) / scale
    ax.set_ylim(len(chosen) - 1 + 0.15, min(-1.0, highest, ax.get_ylim()[1] if before else 0.0))
    ax.set_xlim(edges[0], edges[-1])
    ax.set_yticks(np.arange(len(chosen)), [str(step) for step in chosen])
    name_states(ax, ax.xaxis, variable)
    name_axes(ax, variable.name, f"step (full height: probability {scale:.2g})")
    useful_legend(ax, above=True)
    return ax


def _steps(steps: Sequence[int] | None, count: int) -> list[int]:
    if count == 0:
        raise ModelError("beliefs over no steps; nothing is to draw")
    if steps is None:
        return list(range(0, count, max(1, math.ceil(count / _ROWS))))
    array = np.asarray(steps)
    if array.ndim != 1 or not array.size or array.dtype.kind not in "iu":
        raise ModelError(f"steps must be a sequence of whole numbers, not {steps!r}")
    if array.min() < 0 or array.max() >= count:
        raise ModelError(f"steps are 0 to {count - 1}; found {steps!r}")
    return [int(step) for step in array]


def as_truth_states(variable: Discrete, truth: npt.ArrayLike, count: int) -> npt.NDArray[np.int_]:
    """The numbers of the right states at so many steps, given by name or number."""
    array = np.asarray(truth)
    if array.shape != (count,):
        raise ModelError(
            f"the truth has shape {array.shape}; ({count},) was due, a state at each step"
        )
    return np.array([as_index(variable, state) for state in array.tolist()])


# As many states are all named along an axis; of more, some.
_NAMED = 16
_LONG = 4


def chances(belief: Any, variables: tuple[int, ...], lead: int, due: str) -> Array:
    """The probabilities of a table, (*lead, size of each variable...)."""
    if isinstance(belief, GridBelief):
        raise ModelError(f"{titled(belief)} is drawn by grid_map, or over time by animate_beliefs")
    if not isinstance(belief, Table):
        raise ModelError(f"a belief over discrete states is drawn, a Table, not {titled(belief)}")
    if len(belief.scope) not in variables or belief.log_scale.ndim != lead:
        raise ModelError(
            f"a table over {names(belief.scope)} with leading axes {belief.log_scale.shape}; "
            f"give {due}"
        )
    return belief.probabilities


def as_index(variable: Discrete, state: str | int) -> int:
    """The number of a state, given by name or number."""
    return variable.index(int(state) if isinstance(state, np.integer) else state)


def name_states(ax: Axes, axis: Axis, variable: Discrete) -> None:
    """Name the states along an axis, at an angle below it where names are long."""
    count = variable.size
    if count <= _NAMED:
        labels = [plain(state) for state in variable.states]
        long = max(map(len, labels)) > _LONG
        turned: dict[str, Any] = {}
        if long and axis is ax.xaxis:
            turned = {"rotation": 45, "ha": "right", "rotation_mode": "anchor"}
        axis.set_ticks(np.arange(count), labels, **turned)
        return

    def named(at: float, _: int | None = None) -> str:
        k = round(at)
        return plain(variable.states[k]) if 0 <= k < count and abs(at - k) < 1e-6 else ""

    axis.set_major_locator(MaxNLocator(_NAMED - 1, integer=True))
    axis.set_major_formatter(FuncFormatter(named))


def as_places(places: npt.ArrayLike, count: int) -> npt.NDArray[np.int_]:
    """Row and column of each cell, (count, 2)."""
    array = np.asarray(places)
    if array.dtype.kind not in "iu" or array.shape != (count, 2):
        raise ModelError(
            f"places have shape {array.shape} of {array.dtype}; whole numbers in shape "
            f"({count}, 2) were due, row and column of each state"
        )
    if len(np.unique(array, axis=0)) < count:
        raise ModelError("two states have the same place; give each a row and column of its own")
    return array.astype(int)
