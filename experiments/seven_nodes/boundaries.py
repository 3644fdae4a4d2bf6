"""The clusters of a graph, drawn as boundaries around a network's variables."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse, Polygon
from scipy.spatial import ConvexHull

import pgm
from pgm.plot.colours import PALETTE

Array = npt.NDArray[np.float64]

# Between a node and the boundaries around it, in the node's radius.
_CLEAR = 0.2
_TURN = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)


def draw_boundaries(graph: pgm.ClusterGraph, ax: Axes) -> dict[int, Polygon]:
    """Draw a rounded hull around the variables of each cluster; hulls overlap in shared ones.

    Parameters
    ----------
    graph : ClusterGraph
    ax : matplotlib.axes.Axes
        On which `pgm.plot.network` has drawn the graph's network.

    Returns
    -------
    dict of int to Polygon
        By the cluster's number, which counts from 1 and stands beside its boundary.
    """
    places = {text.get_text(): np.array(text.get_position()) for text in ax.texts}
    radius = max(patch.width for patch in ax.patches if isinstance(patch, Ellipse)) / 2.0
    scopes = [[repr(variable) for variable in cluster.scope] for cluster in graph]
    drawn = {}
    for number, scope in enumerate(scopes, start=1):
        colour = PALETTE[(number - 1) % len(PALETTE)]
        # Neighbours keep different distances, so that no two boundaries run into one.
        distance = radius * (1.0 + _CLEAR * (1 + number % 2))
        centres = np.array([places[name] for name in scope])
        hull = _hull(centres, distance)
        drawn[number] = Polygon(
            hull,
            facecolor=(colour, 0.08),
            edgecolor=colour,
            linewidth=1.6,
            zorder=0.5,
            clip_on=False,
        )
        ax.add_patch(drawn[number])
        # The number stands where the other clusters are farthest.
        others = [places[name] for other in scopes if other is not scope for name in other]
        corner = hull[_distances(hull, np.array(others)).min(axis=1).argmax()]
        away = corner - centres[_distances(centres, corner[None])[:, 0].argmin()]
        ax.annotate(
            str(number),
            corner,
            xytext=9.0 * away / np.linalg.norm(away),
            textcoords="offset points",
            color=colour,
            weight="bold",
            ha="center",
            va="center",
        )
    return drawn


def _hull(centres: Array, radius: float) -> Array:
    """The corners of the convex hull of discs."""
    circle = radius * np.column_stack([np.cos(_TURN), np.sin(_TURN)])
    points = (centres[:, None] + circle).reshape(-1, 2)
    hull: Array = points[ConvexHull(points).vertices]
    return hull


def _distances(a: Array, b: Array) -> Array:
    """Between all points of two sets."""
    found: Array = np.linalg.norm(a[:, None] - b, axis=-1)
    return found
