"""Beliefs in the plane: confidence ellipses, the path that a belief takes, and marks."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.cbook import normalize_kwargs
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_hex, to_rgba
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from pgm.arguments import public
from pgm.boundary import as_floats, as_tuple, is_unordered
from pgm.display import titled
from pgm.errors import ModelError
from pgm.factors import Gaussian, GaussianMixture
from pgm.factors.scope import labels
from pgm.inference import GridBelief, Kind, ParticleBelief
from pgm.kernels.arrays import Array
from pgm.plot.drawing.axes import (
    Unit,
    equal_aspect,
    given_or_new,
    name_axes,
    plain,
    unit_of,
    useful_legend,
    with_unit,
)
from pgm.plot.drawing.colours import DASHES, INK, look_of, next_colour
from pgm.plot.drawing.components import as_gaussian, component_places, one_run, truth_columns

# An ellipse smaller than this part of the picture is marked by a dot.
_INVISIBLE = 1e-4
# More ellipses than this along a path hide each other.
_ELLIPSES = 25
# Components of a mixture of less weight than this are not drawn.
_FAINT = 0.01
# The first path of an axes shows on both sides, and in the gaps, of another upon it.
_BROAD, _NARROW = 3.2, 1.8
_PATH, _TRUTH = "path of a belief", "path of the truth"


@public
def ellipses(
    gaussian: Gaussian | GaussianMixture | ParticleBelief,
    *,
    confidence: float = 0.95,
    components: tuple[str, str] | None = None,
    unit: Unit = None,
    label: str | Kind | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
    **style: Any,
) -> Axes:
    r"""Draw the confidence ellipse of each of a stack of Gaussians.

    .. math:: \{x : (x-\mu)^\top P^{-1} (x-\mu) \le \chi^2_2(c)\}

    A singular covariance is drawn as a line, a zero one as a point.

    Parameters
    ----------
    gaussian : Gaussian, GaussianMixture or ParticleBelief
        With any leading axes; of particles, the Gaussian of the same mean and covariance. Of a
        mixture each component of a weight of .01 or more is drawn, as dark as it weighs.
    confidence : float
        c, the probability of the region, in (0, 1).
    components : pair of str, optional
        Which components, by name; the first two without.
    colour : str, optional
        Colour of the outline, and faintly of the inside; the next of a colour-blind-safe palette
        without.
    unit, label, ax
        See `trajectory`.
    **style
        Properties of `matplotlib.collections.EllipseCollection`, which win over the defaults.

    Raises
    ------
    ModelError
        If `gaussian` is none, or lacks the components, or `confidence` is no probability.

    Examples
    --------
    >>> x = pgm.Variable("x", components=("east", "north"))
    >>> belief = pgm.Gaussian(x, mean=[1.0, 2.0], cov=[[4.0, 1.0], [1.0, 2.0]])
    >>> ax = pgm.plot.ellipses(belief, confidence=0.95, unit="m")
    >>> ax.get_xlabel()
    'east [m]'
    """
    gaussian, weights = _weighed(gaussian)
    found = gaussian.ellipse(confidence, components)
    ax = given_or_new(ax)
    look = look_of(ax, colour)
    colour = look.colour
    defaults: dict[str, Any] = {
        "edgecolor": _shades(colour, 0.75, weights),
        "linestyle": look.dash,
        "facecolor": _shades(colour, 0.1, weights),
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
    name_plane(ax, gaussian, (pair[0], pair[1]), unit)
    if label is not None:
        _name_ellipses(ax, collection, str(label), (defaults | style).get("linestyle"))
        useful_legend(ax)
    return ax


def _weighed(belief: Any) -> tuple[Gaussian, Array | None]:
    """A belief's Gaussians, and their weights, (k,), if it is a mixture that has several."""
    if not isinstance(belief, GaussianMixture) or belief.weights.shape[-1] == 1:
        return as_gaussian(belief), None
    some, each = belief.weights >= _FAINT, belief.components
    return Gaussian._make(belief.scope, each.mean[some], each.cov[some]), belief.weights[some]


def _shades(colour: str, alpha: float, weights: Array | None) -> Any:
    """A colour as strong as `alpha`, or for each weight a fainter one."""
    if weights is None:
        return to_rgba(colour, alpha)
    return [to_rgba(colour, alpha * math.sqrt(weight)) for weight in weights.tolist()]


def _name_ellipses(ax: Axes, drawn: EllipseCollection, label: str, dash: Any) -> None:
    """Name them by an empty patch of their look: legends take no collection of ellipses."""
    edge, face = (
        shades[0] if len(shades) else "none"
        for shades in (drawn.get_edgecolor(), drawn.get_facecolor())
    )
    width = float(np.atleast_1d(drawn.get_linewidth())[0])
    nowhere = Path(np.empty((0, 2)))
    ax.add_patch(PathPatch(nowhere, ec=edge, fc=face, lw=width, ls=dash, label=label))


def name_plane(ax: Axes, belief: Gaussian, pair: tuple[str, str], unit: Unit) -> None:
    """Label the axes with two components and their units."""
    own = dict(zip(labels(belief.scope), belief.units, strict=True))
    name_axes(ax, *(with_unit(one, unit_of(one, unit, own)) for one in pair))


@public
def trajectory(
    belief: Gaussian | GaussianMixture | ParticleBelief,
    *,
    truth: npt.ArrayLike | None = None,
    landmarks: npt.ArrayLike | None = None,
    confidence: float = 0.95,
    every: int | None = None,
    components: tuple[str, str] | None = None,
    unit: Unit = None,
    label: str | Kind | None = None,
    colour: str | None = None,
    dash: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the path of a belief in the plane, with confidence ellipses.

    Call it again with the same `ax` to compare beliefs: each takes the next colour.

    Parameters
    ----------
    belief : Gaussian, GaussianMixture or ParticleBelief
        Over steps, as ``posterior[x]``, or at one step, as ``posterior[x.at(3)]``; of one run. Of
        particles, the Gaussian of the same mean and covariance; of a mixture the path of the mean,
        with the ellipses of the components.
    truth : array_like, optional
        (..., rows, k), columns in the order of the belief's components; leading axes are drawn
        as further lines.
    landmarks : array_like, optional
        (L, 2), in the two components drawn.
    confidence : float
        Probability of an ellipse's inside.
    every : int, optional
        An ellipse at every so many steps; without, as many steps as leave at most 25 ellipses.
    components : pair of str, optional
        Which components are the plane's, by name; the first two without.
    unit : str or mapping of str, optional
        Unit of lengths, as ``"m"``, or of components by name; angles are in rad. For the labels
        alone.
    label : str or Kind, optional
        In the legend, which is drawn where there are two things or more to tell apart.
    colour : str, optional
        The next of a colour-blind-safe palette without.
    dash : {"-", "--", ":", "-."}, optional
        Dash of the path; without, the next of an axes are dashed and make the first a broad line,
        so that paths that lie one upon the other can be told apart.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's without.

    Raises
    ------
    ModelError
        If the belief has several runs or lacks the components, or an argument does not fit.

    Examples
    --------
    >>> x = pgm.Variable("x", components=("east", "north"))
    >>> path = [[0.0, 0.0], [1.0, 0.5], [2.0, 0.5]]
    >>> belief = pgm.Gaussian(x, mean=path, cov=0.04, steps=[0, 1, 2])
    >>> ax = pgm.plot.trajectory(belief, label="filtered", truth=[[0.0, 0.1], [2.0, 0.6]])
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['truth', 'filtered']
    """
    mixture = belief if isinstance(belief, GaussianMixture) else None
    belief = one_run(belief)
    if every is None:
        every = max(1, math.ceil(len(belief.mean) / _ELLIPSES))
    elif not isinstance(every, (int, np.integer)) or every < 1:
        raise ModelError(f"every must be a number of steps, 1 or more, not {every!r}")
    thinned = Gaussian._make(belief.scope, belief.mean[::every], belief.cov[::every])
    pair = tuple(components or labels(belief.scope)[:2])
    thinned.ellipse(confidence, components)  # refuses bad arguments before anything is drawn
    places = component_places(belief, pair)
    lines = None if truth is None else truth_columns(belief, truth, places)
    marks = as_landmarks(landmarks)

    ax = given_or_new(ax)
    paths = [line for line in ax.lines if line.get_gid() == _PATH]
    before = [to_hex(line.get_color()) for line in paths]
    colour = next_colour(ax) if colour is None else colour
    if dash is None:
        # No two alike, though colours begin again.
        dash = DASHES[(len(before) + before.count(to_hex(colour))) % len(DASHES)]
        if paths:
            paths[0].set_linewidth(_BROAD)
    if marks is not None:
        draw_landmarks(ax, marks)
    if lines is not None:
        _draw_truth(ax, lines.reshape(-1, *lines.shape[-2:]))
    shown: Gaussian | GaussianMixture = thinned
    if mixture is not None:
        several = mixture[(0,) * (len(mixture.lead) - 1)] if len(mixture.lead) > 1 else mixture
        shown = several[::every] if several.lead else several
    ellipses(
        shown,
        confidence=confidence,
        components=components,
        unit=unit,
        colour=colour,
        ax=ax,
        zorder=1.8,
    )
    ax.plot(
        *belief.mean[:, places].T,
        color=colour,
        ls=dash,
        lw=_NARROW,
        marker="o" if len(belief.mean) == 1 else None,
        markersize=5,
        zorder=2.5 if before else 2.3,  # the truth is between the first path and the next
        gid=_PATH,
        label=plain(f"estimate of {belief.scope[0]!r}") if label is None else str(label),
    )
    name_plane(ax, belief, (pair[0], pair[1]), unit)
    equal_aspect(ax)
    useful_legend(ax)
    return ax


def _draw_truth(ax: Axes, lines: Array) -> None:
    known = [line.get_xydata() for line in ax.lines if line.get_gid() == _TRUTH]
    mark = "x" if lines.shape[1] == 1 else None
    for k, line in enumerate(lines):
        if not any(np.array_equal(line, other, equal_nan=True) for other in known):
            label = None if k else "truth"
            ax.plot(*line.T, color=INK, lw=0.7, marker=mark, zorder=2.4, gid=_TRUTH, label=label)


class Plane(NamedTuple):
    """The components of a picture.

    mirrored: Whether the axes are the other way round than headings are counted.
    """

    pair: tuple[str, str]
    heading: str | None
    mirrored: bool
    angles: tuple[str, ...]
    units: Mapping[str, str]


def plane_of(
    belief: GridBelief | ParticleBelief, components: tuple[str, str] | None, heading: str | None
) -> Plane:
    """The plane asked for; without, the first two straight components, and the only angle."""
    if belief.lead:
        raise ModelError(
            f"{titled(belief)} is of several runs or steps; pick one, with [k] or "
            "posterior[x.at(k)]"
        )
    straight = tuple(name for name in belief.components if name not in belief.angles)
    pair = straight[:2] if components is None else as_tuple(components)
    if pair is None or len(pair) != 2 or is_unordered(components):
        raise ModelError(
            f"a map is of two components, the first to the right, not {components or pair!r}; "
            f"{titled(belief)}"
        )
    belief.marginal(*pair)  # refuses those that are none
    if heading is None:
        turning = [name for name in belief.angles if name not in pair]
        heading = turning[0] if len(turning) == 1 else None
    if heading is not None and (heading not in belief.angles or heading in pair):
        raise ModelError(f"heading={heading!r} is no angle of {titled(belief)} beside {pair}")
    mirrored = belief.components.index(pair[0]) > belief.components.index(pair[1])
    own = dict(zip(belief.components, belief.units, strict=True))
    return Plane((pair[0], pair[1]), heading, mirrored, belief.angles, own)


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
    """Draw landmarks that the axes do not show yet."""
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
    units = (unit_of(one, unit, plane.units) for one in plane.pair)
    name_axes(ax, *(with_unit(one, of) for one, of in zip(plane.pair, units, strict=True)))
    equal_aspect(ax)
    return ax
