"""The plane in which beliefs of cells or particles are drawn, and the marks in it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from pgm.boundary import as_floats, as_tuple
from pgm.display import titled
from pgm.errors import ModelError
from pgm.inference import GridBelief, ParticleBelief
from pgm.kernels.arrays import Array
from pgm.plot.axes import Unit, equal_aspect, name_axes, unit_of, with_unit
from pgm.plot.colours import INK


class Plane(NamedTuple):
    """The components of a picture.

    Attributes
    ----------
    pair : tuple of str
        Along its axes.
    heading : str or None
        The angle drawn by directions.
    mirrored : bool
        Whether the axes are the other way round than headings are counted.
    angles : tuple of str
        All components that are angles.
    known : tuple of str
        All components.
    """

    pair: tuple[str, str]
    heading: str | None
    mirrored: bool
    angles: tuple[str, ...]
    known: tuple[str, ...]


def plane_of(
    belief: GridBelief | ParticleBelief, components: tuple[str, str] | None, heading: str | None
) -> Plane:
    """The plane asked for; without, the first two straight components, and the only angle.

    Raises
    ------
    ModelError
        If the belief is of several runs or steps, or lacks the components.
    """
    if belief.lead:
        raise ModelError(
            f"{titled(belief)} is of several runs or steps; pick one, with [k] or "
            "posterior[x.at(k)]"
        )
    straight = tuple(name for name in belief.components if name not in belief.angles)
    pair = straight[:2] if components is None else as_tuple(components)
    if pair is None or len(pair) != 2:
        raise ModelError(
            f"a map is of two components, not {components or pair!r}; {titled(belief)}"
        )
    belief.marginal(*pair)  # refuses those that are none
    if heading is None:
        turning = [name for name in belief.angles if name not in pair]
        heading = turning[0] if len(turning) == 1 else None
    if heading is not None and (heading not in belief.angles or heading in pair):
        raise ModelError(f"heading={heading!r} is no angle of {titled(belief)} beside {pair}")
    mirrored = belief.components.index(pair[0]) > belief.components.index(pair[1])
    return Plane((pair[0], pair[1]), heading, mirrored, belief.angles, belief.components)


def as_truth(
    belief: GridBelief | ParticleBelief, truth: npt.ArrayLike | None, plane: Plane
) -> Array | None:
    """The two components drawn of a truth."""
    if truth is None:
        return None
    array = as_floats(truth, "the truth")
    if array.shape != (len(belief.components),):
        raise ModelError(
            f"the truth has shape {array.shape}; one number for each of {list(belief.components)} "
            "was due"
        )
    return array[[belief.components.index(name) for name in plane.pair]]


def as_landmarks(landmarks: npt.ArrayLike | None) -> Array | None:
    """Places (L, 2) in the plane, each once."""
    if landmarks is None:
        return None
    array = as_floats(landmarks, "landmarks")
    if array.ndim != 2 or array.shape[1] != 2:
        raise ModelError(f"landmarks have shape {array.shape}; (L, 2) was due, one a row")
    return np.unique(array, axis=0)


def draw_landmarks(ax: Axes, landmarks: Array) -> None:
    """Mark places that are not marked yet."""
    for line in ax.lines:
        if line.get_label() == "landmarks" and np.array_equal(line.get_xydata(), landmarks):
            return
    ax.plot(*landmarks.T, "^", color=INK, markersize=6, zorder=1.5, label="landmarks")


def finish(
    ax: Axes, plane: Plane, landmarks: Array | None, truth: Array | None, unit: Unit = None
) -> Axes:
    """Draw the marks, and name the axes."""
    if landmarks is not None:
        draw_landmarks(ax, landmarks)
    if truth is not None:
        ax.plot(*truth, "x", color=INK, markersize=8, markeredgewidth=1.8, label="truth")
    units = (unit_of(one, unit, plane.known, angle=one in plane.angles) for one in plane.pair)
    name_axes(ax, *(with_unit(one, of) for one, of in zip(plane.pair, units, strict=True)))
    equal_aspect(ax)
    return ax
