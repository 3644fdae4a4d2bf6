"""Axes of plots of numbers: named, with legends that hide nothing, and with curves over time."""

from collections.abc import Iterable, Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import (
    Collection,
    EllipseCollection,
    FillBetweenPolyCollection,
    LineCollection,
    PolyCollection,
)
from matplotlib.colors import to_hex, to_rgba
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path
from matplotlib.ticker import MaxNLocator

from pgm.errors import ModelError
from pgm.kernels.arrays import Array
from pgm.plot.drawing.colours import MUTED, Look
from pgm.units import RAD

# The unit of all lengths, or of components by name.
Unit = str | Mapping[str, str] | None


def check_axes(ax: Any) -> Axes:
    """Check that a value is an axes, and not an array as ``plt.subplots(2)`` returns."""
    if not isinstance(ax, Axes):
        raise ModelError(f"ax must be one matplotlib Axes, not {type(ax).__name__}; pick one")
    return ax


def given_or_new(ax: Axes | None) -> Axes:
    """The given axes, or the axes of a new figure."""
    if ax is None:
        return plt.subplots(layout="constrained")[1]
    return check_axes(ax)


def columns_of(axes: Axes | Iterable[Axes] | None, count: int) -> tuple[Axes, ...]:
    """The given axes, one a component, or a column of new ones."""
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


def plain(name: str) -> str:
    """A name as matplotlib shows it word for word: dollar signs begin no formula."""
    return name.replace("$", r"\$")


def unit_of(component: str, unit: Unit, own: Mapping[str, str]) -> str:
    """The unit of one component, of all that have their own; empty where none is known."""
    known = own[component]
    if unit is None:
        return known
    if isinstance(unit, str):
        return known or unit
    if not isinstance(unit, Mapping):
        raise ModelError(
            f'unit= is a text, "m", or one for each component by name, {{"east": "m"}}; found '
            f"{unit!r}"
        )
    for name, said in unit.items():
        if name not in own:
            raise ModelError(f"unit= is given of {name!r}; the components are {[*own]}")
        if own[name] and own[name] not in (said, RAD):
            raise ModelError(
                f"unit= says {said!r} of {name!r}, whose variable is in {own[name]!r}; a plot "
                "converts nothing: leave it out, or multiply the belief's numbers"
            )
    return unit.get(component, known)


def with_unit(text: str, *units: str) -> str:
    """A text, and in brackets the unit, if it is the same of all."""
    return f"{text} [{units[0]}]" if units[0] and len(set(units)) == 1 else text


def name_axes(ax: Axes, x: str, y: str) -> None:
    """Label the axes that have no label yet, with names word for word."""
    if not ax.get_xlabel():
        ax.set_xlabel(plain(x))
    if not ax.get_ylabel():
        ax.set_ylabel(plain(y))


def equal_aspect(ax: Axes) -> None:
    """Equal scales in x and y, also where limits are shared with other axes."""
    shared = all(
        len(group.get_siblings(ax)) > 1
        for group in (ax.get_shared_x_axes(), ax.get_shared_y_axes())
    )
    ax.set_aspect("equal", adjustable="box" if shared else "datalim")


# Of the letters, in points, and what of a letter's size a legend takes beside its texts.
_SIZE = 8.3
_BESIDE, _ABOVE, _LINE = 4.6, 1.6, 1.6
# Beside an axes a legend takes no more than this part of its width.
_PART = 0.4
# Where a legend is put, the first that is free: its corner, as parts of the room that is left.
_PLACES = {
    "upper right": (1.0, 1.0),
    "upper left": (0.0, 1.0),
    "lower right": (1.0, 0.0),
    "lower left": (0.0, 0.0),
    "upper center": (0.5, 1.0),
    "lower center": (0.5, 0.0),
    "center right": (1.0, 0.5),
    "center left": (0.0, 0.5),
}
_POINTS = 400


def useful_legend(ax: Axes, *, above: bool = False) -> None:
    """A legend where there are two things or more to tell apart, inside, above or beside the axes.

    Each thing is named once, however often it is drawn.
    """
    named: dict[tuple[str, str], Any] = {}
    for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
        named.setdefault((label, _colour(handle)), handle)
    labels = [label for label, _ in named]
    if len(set(labels)) < 2:
        return
    handles = list(named.values())
    outside: dict[str, Any] = {"bbox_to_anchor": (1.0, 1.0), "frameon": False, "fontsize": _SIZE}
    place: Any = None if above else _free_place(ax, labels)
    if place:
        ax.legend(handles, labels, loc=place, framealpha=0.9, fontsize=_SIZE)
    elif above or not ax.figure.get_layout_engine() or _beside(labels) > _PART * _width(ax):
        # Without an engine that makes room there is some above alone.
        above_it = {"ncols": _columns(ax, labels), "borderaxespad": 0.1}
        ax.legend(handles, labels, loc="lower right", **outside, **above_it)
    else:
        ax.legend(handles, labels, loc="upper left", **outside)


def _colour(handle: Any) -> str:
    for of in ("get_color", "get_facecolor", "get_edgecolor"):
        if hasattr(handle, of):
            found = np.atleast_1d(getattr(handle, of)())
            return to_hex(found[0] if found.ndim > 1 else getattr(handle, of)())
    return ""


def _columns(ax: Axes, labels: list[str]) -> int:
    return int(np.clip(_width(ax) // _beside(labels), 1, min(len(labels), 4)))


def _width(ax: Axes) -> float:
    return float(72.0 / ax.figure.dpi * ax.get_window_extent().width)


def _beside(labels: list[str]) -> float:
    return _widest(labels) + _BESIDE * _SIZE


def _widest(labels: list[str]) -> float:
    font = FontProperties(size=_SIZE)
    lines = [line for label in labels for line in label.split("\n")]
    return float(
        max(text_to_path.get_text_width_height_descent(line, font, False)[0] for line in lines)
    )


def _free_place(ax: Axes, labels: list[str]) -> str | None:
    """The place of a legend that lies on no line, point or region; None without."""
    ax.autoscale_view()
    ax.apply_aspect()
    frame = ax.get_window_extent()
    dot = ax.figure.dpi / 72.0
    rows = sum(1 + label.count("\n") for label in labels)
    width = dot * _beside(labels)
    height = dot * _SIZE * (_ABOVE + _LINE * rows)
    drawn = _drawn(ax)
    away = dot * 5.0
    for place, (right, up) in _PLACES.items():
        left = frame.x0 + away + right * (frame.width - width - 2.0 * away)
        low = frame.y0 + away + up * (frame.height - height - 2.0 * away)
        box = np.array([[left, low], [left + width, low + height]])
        if not ((drawn > box[0] - away) & (drawn < box[1] + away)).all(axis=-1).any():
            return place
    return None


def _drawn(ax: Axes) -> Array:
    found = [np.empty((0, 2))]
    for line in ax.lines:
        if line.get_visible():
            found.append(_along(line.get_transform().transform(line.get_xydata())))
    for collection in ax.collections:
        found += _on(ax, collection)
    for patch in ax.patches:
        found.append(_along(patch.get_transform().transform(patch.get_path().vertices)))
    found += [np.array(text.get_window_extent().corners()) for text in ax.texts if text.get_text()]
    points: Array = np.concatenate(found)
    return points[np.isfinite(points).all(axis=-1)]


def _on(ax: Axes, collection: Collection) -> list[Array]:
    if isinstance(collection, EllipseCollection):
        turn = np.linspace(0.0, 2.0 * np.pi, 24)
        a, b = (
            0.5 * np.asarray(each)[:, None]
            for each in (collection.get_widths(), collection.get_heights())
        )
        tilt = np.radians(np.asarray(collection.get_angles()))[:, None]
        x = a * np.cos(turn) * np.cos(tilt) - b * np.sin(turn) * np.sin(tilt)
        y = a * np.cos(turn) * np.sin(tilt) + b * np.sin(turn) * np.cos(tilt)
        outline = np.stack([x, y], axis=-1) + np.asarray(collection.get_offsets())[:, None]
        return [ax.transData.transform(outline.reshape(-1, 2))]
    if isinstance(collection, PolyCollection | LineCollection):
        to = collection.get_transform()
        return [_along(to.transform(path.vertices)) for path in collection.get_paths()]
    offsets = np.asarray(np.ma.filled(collection.get_offsets(), np.nan), dtype=float)
    return [collection.get_offset_transform().transform(offsets.reshape(-1, 2))]


def _along(points: Array) -> Array:
    if len(points) < 2:
        return points
    steps = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    way = np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])
    at = np.linspace(0.0, way[-1], _POINTS)
    between = np.stack([np.interp(at, way, column) for column in points.T], axis=-1)
    found: Array = np.concatenate([points, between])
    return found


STEP = "step"
_BAND = "band"


def along(steps: npt.NDArray[np.int_], times: npt.ArrayLike | None) -> tuple[npt.NDArray[Any], str]:
    """The places of steps on the horizontal axis, and its label."""
    if times is None:
        return steps, STEP
    array = np.asarray(times)
    if array.shape != steps.shape:
        raise ModelError(f"times has shape {array.shape}; {steps.shape} was due, one for each step")
    return array, "time"


def name_time(ax: Axes, x: str, y: str) -> None:
    """Label the axes; steps are whole numbers."""
    name_axes(ax, x, y)
    if x == STEP:
        ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def band(
    ax: Axes,
    across: npt.NDArray[Any],
    low: Array,
    high: Array,
    tint: str,
    label: str | None = None,
    *,
    dash: str = "-",
    inside: float = 0.12,
    outline: float = 0.5,
) -> FillBetweenPolyCollection:
    """Shade between two curves, within an outline, that a band of no width is visible by.

    Bands after the first of an axes are outlines alone: shades upon each other are all grey.
    """
    first = all(drawn.get_gid() != _BAND for drawn in ax.collections)
    face = to_rgba(tint, inside if first else 0.0)
    edge = to_rgba(tint, outline if first else 0.9)
    return ax.fill_between(
        across,
        low,
        high,
        facecolor=face,
        edgecolor=edge,
        lw=0.8,
        ls=dash,
        zorder=1.0,
        label=label,
        gid=_BAND,
    )


def right_band(
    ax: Axes,
    across: npt.NDArray[Any],
    low: Array,
    high: Array,
    tint: str,
    *,
    confidence: float,
    label: str,
    tolerance: float = 1e-6,
) -> bool:
    """Shade the band of consistent values, in grey or in the tint of its own curve.

    across: (k,), along the horizontal axis.
    label: The curve's, for the legend, if the band is its own.
    tolerance: How far the ends of two bands may differ, as a part of them, to be drawn as one.

    Returns: Whether it is the first one of the axes.
    """
    within = f"{100.0 * confidence:.4g} % band"
    before = [drawn for drawn in ax.collections if str(drawn.get_label()).endswith(" % band")]
    if not before:
        band(ax, across, low, high, MUTED, label=within)
        return True
    own = band(ax, across, low, high, tint, label=f"{label}, {within}")
    if any(_look_alike(own, other, tolerance) for other in before):
        own.remove()
    return False


def _look_alike(a: Collection, b: Collection, tolerance: float) -> bool:
    """Whether two bands have the same places along the axis and about the same ends."""
    ends = [[np.asarray(path.vertices) for path in one.get_paths()] for one in (a, b)]
    return [v.shape for v in ends[0]] == [v.shape for v in ends[1]] and all(
        np.allclose(v, w, rtol=tolerance) for v, w in zip(*ends, strict=True)
    )


def line(
    ax: Axes,
    across: npt.NDArray[Any],
    values: Array,
    look: Look,
    label: str | None = None,
    *,
    dots: bool = False,
) -> None:
    """Draw a curve, with a dot at each value if asked for, or if there is but one."""
    marker = "." if dots or len(across) == 1 else None
    ax.plot(
        across,
        values,
        color=look.colour,
        ls=look.dash,
        lw=1.5,
        marker=marker,
        zorder=2.2,
        label=label,
    )
