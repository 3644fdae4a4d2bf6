"""Clouds of particles: two components as points, an angle as ticks."""

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from pgm.arguments import public
from pgm.boundary import is_whole
from pgm.errors import ModelError
from pgm.inference import ParticleBelief
from pgm.kernels.arrays import Array
from pgm.plot.beliefs.plane import as_landmarks, as_truth, finish, plane_of
from pgm.plot.drawing.axes import Unit, given_or_new
from pgm.plot.drawing.colours import look_of

# The area of a particle of mean weight [pt²], and how many times that one is drawn at the most.
_AREA, _LARGEST = 7.0, 25.0
_TICK = 0.09  # inches


@public
def particles(
    belief: ParticleBelief,
    *,
    components: tuple[str, str] | None = None,
    heading: str | None = None,
    ticks: bool = True,
    most: int = 2000,
    truth: npt.ArrayLike | None = None,
    landmarks: npt.ArrayLike | None = None,
    unit: Unit = None,
    colour: str | None = None,
    ax: Axes | None = None,
    **style: Any,
) -> Axes:
    r"""Draw particles as points, and an angle as short ticks that point along it.

    A point's area is in proportion to its weight, :math:`n w_i` times that of a particle of mean
    weight, up to 25 times. Where there are more particles than are drawn, those are chosen by a
    comb over the weights,

    .. math:: i_k = \min \{ i : w_1 + \dots + w_i \ge (k - \tfrac12) / m \}, \quad k = 1, \dots, m,

    - m: how many are drawn, `most`;

    and the area is how often one was chosen.

    Parameters
    ----------
    belief : ParticleBelief
        The belief of one run at one step, for instance ``posterior[x.at(3)]``.
    components : pair of str, optional
        Which components are the plane's, by name; the first two that are no angles without.
    heading : str, optional
        The angle of the ticks, counted from the belief's first straight component to its second;
        without, the belief's only angle, or none where there are several.
    ticks : bool
        Whether an angle is drawn.
    most : int
        How many are drawn at the most.
    truth : array_like, optional
        (n,), in the order of the belief's components; its place is marked by a cross.
    landmarks, unit, colour, ax
        See `trajectory`.
    **style
        Properties of `matplotlib.axes.Axes.scatter`, which win over the defaults.

    Raises
    ------
    ModelError
        If it is no belief of particles, of several runs or steps, or lacks the components; or an
        argument does not fit.

    Examples
    --------
    >>> from pgm.examples import drive, p, q
    >>> posterior = pgm.filter(drive, {q: [[1.0, 2.0]]}, belief=pgm.Particles(100, seed=1))
    >>> ax = pgm.plot.particles(posterior[p.at(1)], landmarks=[[0.0, 3.0]])
    """
    if not isinstance(belief, ParticleBelief):
        raise ModelError(f"particles draws a belief of particles, not a {type(belief).__name__}")
    if not is_whole(most) or most < 1:
        raise ModelError(f"most is a whole number, 1 or more, not {most!r}")
    plane = plane_of(belief, components, heading)
    mark, marks = as_truth(belief, truth, plane), as_landmarks(landmarks)

    ax = given_or_new(ax)
    look = look_of(ax, colour)
    chosen, weights = _thinned(belief.weights, int(most))
    place = [belief.components.index(name) for name in plane.pair]
    east, north = np.asarray(belief.states[chosen][:, place], dtype=float).T
    defaults: dict[str, Any] = {
        "s": _AREA * np.minimum(len(weights) * weights, _LARGEST),
        "color": look.colour,
        "alpha": 0.45,
        "linewidths": 0.0,
    }
    if {"c", "facecolor", "facecolors"} & set(style):
        del defaults["color"]
    ax.scatter(east, north, **(defaults | style))
    if plane.heading is not None and ticks:
        angle = belief.states[chosen, belief.components.index(plane.heading)]
        along = (np.sin(angle), np.cos(angle)) if plane.mirrored else (np.cos(angle), np.sin(angle))
        ax.quiver(
            east,
            north,
            *along,
            angles="xy",
            scale_units="inches",
            scale=1.0 / _TICK,
            headwidth=0.0,
            headlength=0.0,
            headaxislength=0.0,
            width=0.0016,
            color=look.colour,
            alpha=0.6,
        )
    return finish(ax, plane, marks, mark, unit)


def _thinned(weights: Array, most: int) -> tuple[npt.NDArray[np.intp], Array]:
    if len(weights) <= most:
        return np.arange(len(weights)), weights
    ends = np.cumsum(weights)
    teeth = (np.arange(most) + 0.5) / most * ends[-1]
    chosen, counts = np.unique(np.searchsorted(ends, teeth), return_counts=True)
    return chosen, counts / most
