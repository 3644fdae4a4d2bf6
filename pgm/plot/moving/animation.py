"""Beliefs over cells as moving pictures."""

from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from pgm.arguments import public
from pgm.display import titled
from pgm.errors import ModelError
from pgm.factors import Table
from pgm.inference import GridBelief
from pgm.plot.beliefs.cells import belief_map, grid_map
from pgm.plot.beliefs.stacks import chances
from pgm.plot.drawing.axes import Unit
from pgm.plot.moving.movies import movie_writer, write_movie


@public
def animate_beliefs(
    belief: GridBelief | Table,
    path: str | PathLike[str],
    *,
    truth: npt.ArrayLike | None = None,
    landmarks: npt.ArrayLike | None = None,
    unit: Unit = None,
    rate: float = 5.0,
    also: Callable[[Axes, int], None] | None = None,
    figsize: tuple[float, float] = (5.0, 5.2),
    dpi: int = 80,
    **style: Any,
) -> Path:
    """Write a belief over time as a moving picture, a map a step: see `grid_map` and `belief_map`.

    The darkest colour is that of the most probable cell of each picture; of tables ``most=1.0``
    makes it the same in all.

    Parameters
    ----------
    belief : GridBelief or Table
        The belief of one run over steps, as ``posterior[x]``; a table of one variable needs
        `places`, and its steps are counted from 0, a hidden control's too, whose steps are 1..T.
    path : path
        Where to: a GIF, ``drive.gif``, or where the program ffmpeg is, ``drive.mp4``. It is
        written whole or not at all.
    truth : array_like, optional
        (T+1, n), in the order of the belief's components; of a table (T+1,), names or numbers
        of states, or (T+1, 2) of two variables.
    landmarks : array_like, optional
        (L, 2), in the two components drawn; of a grid alone.
    unit : str or mapping of str, optional
        See `grid_map`; of a grid alone.
    rate : float
        Pictures a second.
    also : callable, optional
        ``also(ax, step)`` draws more into each picture, or sets its limits.
    figsize : pair of float
        Size of a picture [inches].
    dpi : int
        Dots an inch.
    **style
        Further arguments of `grid_map`, or of `belief_map`.

    Returns
    -------
    pathlib.Path
        The file's path.

    Raises
    ------
    ModelError
        If it is no belief over cells, or of several runs or no steps; if the file is of another
        kind, or an MP4 and there is no ffmpeg; or an argument does not fit.

    Examples
    --------
    >>> import tempfile
    >>> row, column = (pgm.Discrete(name, states=("0", "1")) for name in ("row", "column"))
    >>> chances = [[[0.25, 0.25], [0.25, 0.25]], [[0.0, 0.5], [0.0, 0.5]]]
    >>> belief = pgm.Table((row, column), chances, lead=2)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     pgm.plot.animate_beliefs(belief, f"{folder}/drive.gif").name
    'drive.gif'
    """
    if isinstance(belief, Table):
        steps, picture = _of_table(belief, truth, landmarks, unit)
    else:
        steps, picture = _of_grid(belief, truth, landmarks, unit)
    writer = movie_writer(path, rate)
    figure, ax = plt.subplots(figsize=figsize, layout="constrained")

    def draw(k: int) -> None:
        step = int(steps[k])
        ax.clear()
        picture(k, ax=ax, **style)
        ax.set_title(f"step {step}")
        if also is not None:
            also(ax, step)

    try:
        return write_movie(writer, path, figure, draw, len(steps), dpi)
    finally:
        plt.close(figure)


def _of_grid(
    belief: Any, truth: npt.ArrayLike | None, landmarks: npt.ArrayLike | None, unit: Unit
) -> tuple[npt.NDArray[Any], Callable[..., Axes]]:
    if not isinstance(belief, GridBelief):
        raise ModelError(
            "animate_beliefs draws a belief on a grid, or a table over time, not a "
            f"{type(belief).__name__}"
        )
    if belief.steps is None or len(belief.lead) != 1:
        raise ModelError(
            f"{titled(belief)} is not of one run over steps; give posterior[x], or posterior[x][k] "
            "of several runs"
        )
    right = _truth(truth, (len(belief.steps), len(belief.components)), "steps and components")

    def picture(k: int, **style: Any) -> Axes:
        at = None if right is None else right[k].astype(float)
        return grid_map(belief[k], truth=at, landmarks=landmarks, unit=unit, **style)

    return belief.steps, picture


def _of_table(
    belief: Table, truth: npt.ArrayLike | None, landmarks: npt.ArrayLike | None, unit: Unit
) -> tuple[npt.NDArray[Any], Callable[..., Axes]]:
    values = chances(belief, (1, 2), 1, "beliefs of one run over steps, like posterior[x]")
    if not len(values):
        raise ModelError("beliefs over no steps are no moving picture")
    for name, given in (("landmarks", landmarks), ("unit", unit)):
        if given is not None:
            raise ModelError(f"{name}= is for a grid; the cells of a table have no coordinates")
    count = len(belief.scope)
    shape = (len(values),) if count == 1 else (len(values), count)
    right = _truth(truth, shape, "steps" if count == 1 else "steps and variables")

    def picture(k: int, **style: Any) -> Axes:
        at = None if right is None else right[k].tolist()
        at = tuple(at) if isinstance(at, list) else at
        return belief_map(Table(belief.scope, values[k]), truth=at, **style)

    return np.arange(len(values)), picture


def _truth(truth: npt.ArrayLike | None, due: tuple[int, ...], axes: str) -> npt.NDArray[Any] | None:
    if truth is None:
        return None
    right = np.asarray(truth)
    if right.shape != due:
        raise ModelError(f"the truth has shape {right.shape}; {due} was due, {axes}")
    return right
