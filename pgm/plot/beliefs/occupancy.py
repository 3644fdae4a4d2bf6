"""Pictures of occupancy grids, to draw beliefs and trajectories on."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes

from pgm.errors import ModelError
from pgm.maps import OccupancyMap
from pgm.plot.axes import equal_aspect, given_or_new, name_axes

# A tint that no probability has.
_UNKNOWN = "#D5E3EE"
_GREYS = colormaps["Greys"].with_extremes(bad=_UNKNOWN)


def occupancy_map(map: OccupancyMap, *, ax: Axes | None = None, **style: Any) -> Axes:
    """Draw an occupancy grid: white is free, black occupied, and pale blue not known.

    It lies where its origin says, turned by its yaw, below whatever else is drawn.

    Parameters
    ----------
    map : OccupancyMap
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's without.
    **style
        Properties of the image, or of a turned map's mesh, as its ``set`` takes them.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ModelError
        If it is no occupancy grid, or `ax` no axes.

    Examples
    --------
    >>> room = pgm.maps.OccupancyMap([[1, 1, 1], [0, 0, 1]], resolution=0.5)
    >>> ax = pgm.plot.occupancy_map(room)
    >>> ax.get_xlabel()
    'x [m]'
    """
    if not isinstance(map, OccupancyMap):
        raise ModelError(f"occupancy_map draws an OccupancyMap, not a {type(map).__name__}")
    ax = given_or_new(ax)
    values = np.ma.masked_invalid(map.occupied)
    height, width = map.shape
    if map.origin[2]:
        rows, columns = np.mgrid[: height + 1, : width + 1] - 0.5
        x, y = np.moveaxis(map.centres(rows, columns), -1, 0)
    else:
        x, y = map.centres([-0.5, height - 0.5], [-0.5, width - 0.5]).T
    drawn = ax.pcolorfast(x, y, values, cmap=_GREYS, vmin=0.0, vmax=1.0)
    # In a file of vectors each cell of a turned map would stand by itself.
    drawn.set(**({"zorder": -1.0, "rasterized": True} | style))
    name_axes(ax, "x [m]", "y [m]")
    equal_aspect(ax)
    return ax
