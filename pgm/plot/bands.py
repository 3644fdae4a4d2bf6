"""Errors over time, against what a belief says of its own errors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba

from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.inference import Kind
from pgm.kernels.angles import difference
from pgm.plot.axes import check_axes, name_axes, useful_legend
from pgm.plot.colours import INK, next_colour
from pgm.plot.components import component_names, component_places, one_run, truth_columns


def errors(
    belief: Gaussian,
    truth: npt.ArrayLike,
    *,
    components: Sequence[str] | None = None,
    sigma: float = 3.0,
    times: npt.ArrayLike | None = None,
    label: str | Kind | None = None,
    colour: str | None = None,
    axes: Axes | Iterable[Axes] | None = None,
) -> tuple[Axes, ...]:
    r"""Draw the error of each component over time, within the band ±σ of its own deviation.

    .. math:: e_t = \mu_t - x_t, \qquad |e_t| \le \sigma \sqrt{P_t}

    Errors of angles are wrapped. Call it again with the same `axes` to compare beliefs: each
    takes the next colour.

    Parameters
    ----------
    belief : Gaussian
        Over steps, as ``posterior[x]``; of one run.
    truth : array_like
        (steps, k), columns in the order of the belief's components.
    components : sequence of str, optional
        Which components, by name; all without.
    sigma : float
        Half the width of the band, in standard deviations.
    times : array_like, optional
        (steps,), the time of each step, for the horizontal axis; the steps themselves without.
    label : str or Kind, optional
        In the legend, above the first axes.
    colour : str, optional
        The next of a colour-blind-safe palette without.
    axes : matplotlib.axes.Axes or iterable of them, optional
        One a component; a column of new ones without.

    Returns
    -------
    tuple of matplotlib.axes.Axes
        One a component.

    Raises
    ------
    ModelError
        If the belief has several runs, or an argument does not fit it.
    """
    belief = one_run(belief)
    chosen = component_names(belief) if components is None else list(components)
    places = component_places(belief, components if components is not None else chosen)
    if not places:
        raise ModelError("no components to draw; name one or more, or leave components out")
    if not (np.isfinite(sigma) and sigma > 0.0):
        raise ModelError(f"sigma must be a number of standard deviations above 0, not {sigma!r}")
    true = truth_columns(belief, truth, places)
    mean, band = belief.mean[:, places], sigma * belief.std[:, places]
    if true.shape != mean.shape:
        raise ModelError(
            f"the truth has {true.shape[:-1]} steps where the belief has {len(mean)}; give "
            "(steps, components), the truth at the belief's steps and of the same run"
        )
    error = difference(mean, true, belief.angles[places])
    across, name = _times(belief, times)

    columns = _axes(axes, len(places))
    tint = colour or next_colour(columns[0])
    marker = "o" if len(mean) == 1 else None
    for k, ax in enumerate(columns):
        if not ax.lines:
            ax.axhline(0.0, color=INK, lw=0.8, zorder=1.0)
        # An outline keeps the band of a single step, or of no width, visible.
        ax.fill_between(
            across,
            -band[:, k],
            band[:, k],
            facecolor=to_rgba(tint, 0.18),
            edgecolor=to_rgba(tint, 0.4),
            lw=0.8,
            label=f"±{sigma:g}σ" if label is None else f"{label} ±{sigma:g}σ",
        )
        ax.plot(
            across,
            error[:, k],
            color=tint,
            lw=1.2,
            marker=marker,
            label="error" if label is None else str(label),
        )
        name_axes(ax, name if ax is columns[-1] else "", f"{chosen[k]} error")
    useful_legend(columns[0], above=True)
    return columns


def _times(belief: Gaussian, times: npt.ArrayLike | None) -> tuple[npt.NDArray[Any], str]:
    count = len(belief.mean)
    if times is None:
        first = belief.scope[0].step or 0
        return (first + np.arange(count) if belief.steps is None else belief.steps), "step"
    array = np.asarray(times)
    if array.shape != (count,):
        raise ModelError(f"times has shape {array.shape}; ({count},) was due, one for each step")
    return array, "time"


def _axes(axes: Axes | Iterable[Axes] | None, count: int) -> tuple[Axes, ...]:
    if axes is None:
        made = plt.subplots(
            count,
            sharex=True,
            squeeze=False,
            figsize=(6.4, 1.0 + 1.6 * count),
            layout="constrained",
        )[1]
        return tuple(made[:, 0])
    if isinstance(axes, Axes):
        axes = (axes,)
    found = tuple(check_axes(ax) for ax in np.ravel(np.array(list(axes), dtype=object)))
    if len(found) != count:
        raise ModelError(
            f"{len(found)} axes for {count} components; give one a component, or name the "
            "components to draw"
        )
    return found
