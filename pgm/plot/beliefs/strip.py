"""Strips: the states that a discrete sensor reads over time, and how probable each was before."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.patches import Patch

from pgm.errors import EvidenceError, ModelError
from pgm.factors import Table
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.plot.drawing.axes import along, columns_of, name_time, plain
from pgm.plot.drawing.colours import INK, MUTED, look_of
from pgm.posteriors.outcome import OverTime
from pgm.posteriors.posterior import Posterior
from pgm.variables import Discrete

# The probabilities whose shades the legend has, and the most states that are named.
_SHADES, _NAMED = (0.1, 0.5, 0.9), 30


def strip(
    posterior: Posterior[Any],
    sensor: Discrete,
    *,
    run: int | tuple[int, ...] | None,
    times: npt.ArrayLike | None,
    colour: str | None,
    axes: Any,
) -> Axes:
    """Draw the probabilities of a sensor's states at each step as shades, and its readings as dots.

    Arguments and errors are those of `forecast`. A hollow dot is a reading of uncertain states, at
    the likeliest of them.
    """
    chances, steps, read, values = _of(posterior, sensor, run)
    across, name = along(steps, times)
    (ax,) = columns_of(axes, 1)
    tint = look_of(ax, colour).colour
    shades = LinearSegmentedColormap.from_list("probability", ["white", tint])
    places = np.asarray(across, dtype=float)
    ax.pcolormesh(
        _edges(places),
        np.arange(sensor.size + 1) - 0.5,
        chances.T,
        cmap=shades,
        vmin=0.0,
        vmax=1.0,
        rasterized=chances.size > 10_000,
        zorder=1.0,
    )
    handles: list[Any] = [
        Patch(facecolor=shades(p), edgecolor=MUTED, lw=0.5, label=f"{100.0 * p:.0f} %")
        for p in _SHADES
    ]
    at = np.searchsorted(steps, read)
    for soft, label in ((False, "reading"), (True, "soft reading")):
        state, seen = _states(values, soft=soft)
        if seen.any():
            face = "none" if soft else INK
            handles += ax.plot(
                places[at[seen]],
                state[seen],
                "o",
                ms=4.0,
                mfc=face,
                mec=INK if soft else "white",
                mew=0.8,
                color=INK,
                zorder=3.0,
                label=label,
            )
    some = ~np.isnan(values).all(axis=-1)
    if some.any() and at[some].max() < len(places) - 1:
        last = 0.5 * (places[at[some].max()] + places[at[some].max() + 1])
        handles.append(
            ax.axvline(last, color=MUTED, ls=":", lw=1.2, zorder=2.0, label="last reading")
        )
    if sensor.size <= _NAMED:
        ax.set_yticks(np.arange(sensor.size), [plain(state) for state in sensor.states])
    name_time(ax, name, sensor.name)
    ax.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=len(handles),
        frameon=False,
        fontsize="small",
        handletextpad=0.5,
        columnspacing=1.2,
    )
    return ax


def _edges(places: Array) -> Array:
    """The edges between places along the horizontal axis, half a step beyond the first and last."""
    if len(places) == 1:
        return np.asarray(places[0] + np.array([-0.5, 0.5]))
    middle = 0.5 * (places[1:] + places[:-1])
    first, last = places[0] - (middle[0] - places[0]), places[-1] + (places[-1] - middle[-1])
    return np.concatenate([[first], middle, [last]])


def _states(values: Array, *, soft: bool) -> tuple[Integers, Mask]:
    """The states (M,) that were read, or are likeliest by soft readings, and the mask of these."""
    known: Array = np.nan_to_num(values)
    state = known.argmax(axis=-1) if values.shape[-1] > 1 else known[:, 0].astype(np.intp)
    seen: Mask = np.asarray(~np.isnan(values).any(axis=-1))
    return state, seen if soft == (values.shape[-1] > 1) else np.zeros_like(seen)


def _of(
    posterior: Posterior[Any], sensor: Discrete, run: int | tuple[int, ...] | None
) -> tuple[Array, Integers, Integers, Array]:
    """The probabilities of states by step, (N, size), the steps, those read, and the readings."""
    ahead = posterior.predicted
    found = ahead[sensor]
    assert isinstance(found, Table)
    *lead, rows, size = found.values.shape
    step, values = posterior._readings_of(sensor)
    if run is None and math.prod(lead) != 1:
        raise ModelError(
            f"the posterior has the leading axes {tuple(lead)}, of runs; choose one, as with run="
            f"{0 if len(lead) == 1 else (0,) * len(lead)}",
            variable=sensor,
        )
    place = (0,) * len(lead) if run is None else (run,) if isinstance(run, int) else run
    steps = _steps(ahead, sensor, posterior.graph.steps)
    if np.array_equal(np.sort(step), steps):
        steps = step  # rows of sightings are in their order
    if len(steps) != rows:
        raise ModelError(
            f"{sensor!r} has several sightings at a step, each of other parents: a strip is of one "
            "reading a step",
            variable=sensor,
        )
    each = found.values[place].reshape(rows, size)
    order = np.argsort(steps, kind="stable")
    return each, steps[order], step, values[place].reshape(len(step), -1)


def _steps(ahead: OverTime[Any], sensor: Discrete, last: int) -> Integers:
    """The steps up to the last one at which a sensor has one row of forecasts."""
    found = []
    for step in range(last + 1):
        try:
            ahead[sensor.at(step)]
        except EvidenceError:
            continue
        found.append(step)
    return np.array(found, dtype=np.intp)
