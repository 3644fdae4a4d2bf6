"""Confidence ellipses of stacked Gaussians."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cbook import normalize_kwargs
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_rgba

from pgm.consistency.checks import check_gaussian
from pgm.factors import Gaussian
from pgm.factors.scope import labels
from pgm.plot.axes import given_or_new, name_axes
from pgm.plot.colours import next_colour

# An ellipse smaller than this part of the picture is marked by a dot.
_INVISIBLE = 1e-4


def ellipses(
    gaussian: Gaussian,
    *,
    confidence: float = 0.95,
    components: tuple[str, str] | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
    **style: Any,
) -> Axes:
    r"""Draw the confidence ellipse of each of a stack of Gaussians.

    .. math:: \{x : (x-\mu)^\top P^{-1} (x-\mu) \le \chi^2_2(c)\}

    A singular covariance is drawn as a line, a zero one as a point.

    Parameters
    ----------
    gaussian : Gaussian
        With any leading axes.
    confidence : float
        c, the probability of the region, in (0, 1).
    components : pair of str, optional
        Which components, by name; the first two without.
    colour : str, optional
        Of the outline, and faintly of the inside; the next of a colour-blind-safe palette without.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's without.
    **style
        Properties of `matplotlib.collections.EllipseCollection`, which win over the defaults.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ModelError
        If `gaussian` is none, or lacks the components, or `confidence` is no probability.
    """
    gaussian = check_gaussian(gaussian)
    found = gaussian.ellipse(confidence, components)
    ax = given_or_new(ax)
    colour = colour or next_colour(ax)
    defaults: dict[str, Any] = {
        "edgecolor": to_rgba(colour, 0.75),
        "facecolor": to_rgba(colour, 0.1),
        "linewidth": 0.9,
    }
    style = normalize_kwargs(style, EllipseCollection)
    if "color" in style:
        del defaults["edgecolor"], defaults["facecolor"]
    centre, axes = found.centre.reshape(-1, 2), found.half_axes.reshape(-1, 2)
    angle = found.orientation.reshape(-1)
    collection = EllipseCollection(
        2.0 * axes[:, 0],
        2.0 * axes[:, 1],
        np.degrees(angle),
        units="xy",
        offsets=centre,
        offset_transform=ax.transData,
        **(defaults | style),
    )
    ax.add_collection(collection, autolim=False)
    # Matplotlib takes only the centres into its limits; these are the ellipses' own bounds.
    cos, sin = np.cos(angle), np.sin(angle)
    reach = np.stack(
        [
            np.hypot(axes[:, 0] * cos, axes[:, 1] * sin),
            np.hypot(axes[:, 0] * sin, axes[:, 1] * cos),
        ],
        axis=-1,
    )
    bounds = np.concatenate([centre - reach, centre + reach])
    ax.update_datalim(bounds)
    span = np.ptp(bounds, axis=0).max() if bounds.size else 0.0
    if (dots := axes[:, 0] <= _INVISIBLE * span).any():
        shade = style.get("color", style.get("edgecolor", colour))
        east, north = centre[dots].T
        ax.scatter(east, north, s=7.0, color=shade, zorder=collection.get_zorder())
    ax.autoscale_view()
    pair = components or labels(gaussian.scope)[:2]
    name_axes(ax, pair[0], pair[1])
    return ax
