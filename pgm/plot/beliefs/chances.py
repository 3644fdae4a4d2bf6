"""Probabilities of a table's states as plots want them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, MaxNLocator

from pgm.display import titled
from pgm.errors import ModelError
from pgm.factors import Table
from pgm.factors.scope import names
from pgm.inference import GridBelief
from pgm.kernels.arrays import Array
from pgm.plot.axes import plain
from pgm.variables import Discrete

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
