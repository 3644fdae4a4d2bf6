"""Probabilities of a variable's states over time: bands, one upon the other."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba

from pgm.arguments import public
from pgm.errors import ModelError
from pgm.factors import Table
from pgm.plot.beliefs.stacks import as_truth_states, chances
from pgm.plot.drawing.axes import given_or_new, name_axes, plain
from pgm.plot.drawing.colours import PALETTE

# So many states have bands that can be told apart.
_MOST = 12
# The strip of the right states, above the bands.
_STRIP = 1.02, 1.07


@public
def bands(
    belief: Table,
    *,
    truth: npt.ArrayLike | None = None,
    colours: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the probabilities of a variable's states over time as bands, one upon the other.

    For modes, faults and other variables of a few states, which `beliefs_over_time` draws a row a
    step.

    Parameters
    ----------
    belief : Table
        Over one variable and steps, as ``posterior[mode]``; of one run. Steps are counted from 0: a
        hidden control, of steps 1..T, has its row k for step k + 1.
    truth : array_like, optional
        (all steps,): the right state at each step, by name or number, as a strip above the bands.
    colours : sequence of str, optional
        One for each state; of a colour-blind-safe palette without.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's without.

    Raises
    ------
    ModelError
        If the belief is over several variables or runs, or of more than twelve states, or an
        argument does not fit.

    Examples
    --------
    >>> mode = pgm.Discrete("mode", states=("straight", "turn"))
    >>> belief = pgm.Table(mode, [[0.9, 0.1], [0.6, 0.4], [0.1, 0.9]], lead=3)
    >>> ax = pgm.plot.bands(belief, truth=["straight", "straight", "turn"])
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['straight', 'turn']
    """
    found = chances(belief, (1,), 1, "beliefs over one variable with one leading axis, of steps")
    (variable,) = belief.scope
    if not len(found):
        raise ModelError("beliefs over no steps; nothing is to draw")
    if variable.size > _MOST:
        raise ModelError(
            f"{variable!r} has {variable.size} states, more than {_MOST} bands can be told apart "
            "of: draw it by pgm.plot.beliefs_over_time"
        )
    right = None if truth is None else as_truth_states(variable, truth, len(found))
    shades = _colours(colours, variable.size)
    ax = given_or_new(ax)
    edges = np.arange(len(found) + 1) - 0.5
    tops = np.concatenate([np.zeros((len(found), 1)), np.cumsum(found, axis=1)], axis=1)
    for state, shade in enumerate(shades):
        low, high = (np.append(tops[:, k], tops[-1, k]) for k in (state, state + 1))
        ax.fill_between(
            edges,
            low,
            high,
            step="post",
            color=to_rgba(shade, 0.75),
            lw=0,
            label=plain(variable.states[state]),
        )
    if right is not None:
        for state, shade in enumerate(shades):
            steps = [(step - 0.5, 1.0) for step in np.flatnonzero(right == state).tolist()]
            ax.broken_barh(steps, (_STRIP[0], _STRIP[1] - _STRIP[0]), color=shade, lw=0)
    ax.set_xlim(edges[0], edges[-1])
    ax.set_ylim(0.0, 1.0 if right is None else _STRIP[1])
    ax.set_yticks([0.0, 0.5, 1.0])
    if right is not None:
        middle = 1.01, sum(_STRIP) / 2
        ax.annotate("truth", middle, xycoords=ax.get_yaxis_transform(), va="center", size="small")
    name_axes(ax, "step", f"probability of {variable.name}")
    ax.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=min(variable.size, 4), frameon=False
    )
    return ax


def _colours(colours: Sequence[str] | None, count: int) -> list[str]:
    if colours is None:
        return [PALETTE[k % len(PALETTE)] for k in range(count)]
    found = list(colours)
    if isinstance(colours, str) or len(found) != count:
        raise ModelError(f"colours are one for each of {count} states, not {colours!r}")
    return found
