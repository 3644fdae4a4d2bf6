"""The run of a filter and a smoother as a moving picture."""

import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from pgm.arguments import public
from pgm.boundary import as_tuple, is_whole
from pgm.compile import BalancedGraph
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.factors.scope import Scope, labels
from pgm.inference import Posterior
from pgm.kernels.arrays import Array
from pgm.plot.beliefs.plane import as_landmarks, name_plane
from pgm.plot.drawing.axes import Unit
from pgm.plot.drawing.components import as_gaussian, component_places, one_run, truth_columns
from pgm.plot.moving.movies import BlittedCanvas, movie_writer, write_movie
from pgm.plot.moving.panels import FILTERED, REVISED, Chain, Paths, frames
from pgm.posteriors.belief_kind import SMOOTHED, Kind
from pgm.posteriors.outcome import marginal
from pgm.variables import Variable

# How long the last picture of a pass stays [s].
_PAUSE = 1.0
# About the plane [inches]: room for numbers and names, and for the title above the legend.
_LEFT, _BELOW, _TITLE, _EDGE = 0.8, 0.6, 0.42, 0.12
_STRIP = 0.19  # of the height, for the clusters
_ENTRY, _ROW = 1.3, 0.2  # the width of an entry of the legend, and its height


@public
def animate(
    posterior: Posterior[Any],
    path: str | PathLike[str],
    *,
    variable: Variable | None = None,
    truth: npt.ArrayLike | None = None,
    landmarks: npt.ArrayLike | None = None,
    confidence: float = 0.95,
    components: tuple[str, str] | None = None,
    unit: Unit = None,
    run: int | Sequence[int] | None = None,
    clusters: int = 5,
    every: int | None = None,
    rate: float = 10.0,
    figsize: tuple[float, float] = (8.0, 7.0),
    dpi: int = 100,
) -> Path:
    """Write the run of a filter, or of a filter and a smoother, as a moving picture.

    Above, the path of a state in the plane, with confidence ellipses; below, the cluster graph,
    the cluster at work lit. The forward pass filters, and its messages flow to the right; after
    smoothing the pass back revises the beliefs by messages to the left.

    Parameters
    ----------
    posterior : Posterior
        Of Gaussian beliefs, or particles.
        From `pgm.filter` or `pgm.smooth` on a dynamic network. For particles the ellipses are
        those of the same mean and covariance.
    path : path
        Where to: a GIF, ``drive.gif``, or where the program ffmpeg is, ``drive.mp4``. It is
        written whole or not at all.
    variable : Variable, optional
        The state that is drawn; the first of two components or more without.
    truth : array_like, optional
        (T+1, k), columns in the order of the state's components.
    confidence : float
        Probability of an ellipse's inside.
    run : int or sequence of int, optional
        Which of several runs, an index for each leading axis.
    clusters : int
        The most clusters in the picture, fewer where their letters would be too small; it follows
        the one at work along a longer chain.
    every : int, optional
        Steps from a picture to the next; as many as leave at most 100 pictures a pass without.
    rate : float
        Pictures a second.
    figsize : pair of float
        Size of a picture [inches].
    dpi : int
        Dots an inch.
    landmarks, components, unit
        See `trajectory`.

    Returns
    -------
    pathlib.Path
        The file's path.

    Raises
    ------
    ModelError
        If it is no posterior of Gaussians or particles along a chain, or of several runs of which
        none is chosen; if the file is of another kind, or an MP4 and there is no ffmpeg; or an
        argument does not fit.

    Examples
    --------
    >>> import tempfile
    >>> from pgm.examples import drive, q
    >>> smoothed = pgm.smooth(drive, {q: [[1.0, 2.0], [1.0, 3.0]]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     pgm.plot.animate(smoothed, f"{folder}/drive.gif").name
    'drive.gif'
    """
    kind = _check(posterior)
    for value, name in ((clusters, "clusters"), (every, "every")):
        if value is not None and (not is_whole(value) or value < 1):
            raise ModelError(f"{name} is a whole number, 1 or more, not {value!r}")
    state = _state(posterior, variable)
    filtered, known = (_one(marginal(each, state), run) for each in (posterior.filtered, posterior))
    pair = _pair(filtered, components, confidence)
    places = component_places(filtered, pair)
    line = None if truth is None else _truth(filtered, truth, places)
    marks = as_landmarks(landmarks)
    writer = movie_writer(path, rate)

    graph = posterior.graph
    pictures = frames(kind, graph.steps, every)
    figure = Figure(figsize=figsize, dpi=dpi)
    entries = 2 + sum((line is not None, marks is not None, bool(kind.lag)))  # of the legend
    plane, below = (figure.add_axes(room) for room in _rooms(*figsize, entries))
    paths = Paths(plane, (filtered, known), kind, pair, line, marks, confidence)
    name_plane(plane, filtered, pair, unit)
    chain = Chain(below, graph, clusters, (FILTERED, REVISED), kind == SMOOTHED)
    title = _head(plane, paths.marks)
    BlittedCanvas(figure, [*paths.artists, *chain.artists, title])
    pauses = max(1, round(_PAUSE * rate))
    order = [
        frame
        for frame in pictures
        for _ in range(pauses if frame.step == (0 if frame.back else graph.steps) else 1)
    ]

    def draw(k: int) -> None:
        frame = order[k]
        paths.show(frame)
        chain.show(frame)
        title.set_text(f"{'back' if frame.back else 'forward'}: step {frame.step} of {graph.steps}")

    return write_movie(writer, path, figure, draw, len(order), dpi)


Room = tuple[float, float, float, float]


def _rooms(width: float, height: float, entries: int) -> tuple[Room, Room]:
    """Left, bottom, width and height, as parts of a figure's: of the plane, and of the clusters."""
    head = _TITLE + _ROW * math.ceil(entries / _columns(width, entries))
    low, high = _STRIP + _BELOW / height, 1.0 - head / height
    plane = _LEFT / width, low, 1.0 - (_LEFT + _EDGE) / width, high - low
    return plane, (0.01, 0.01, 0.98, _STRIP)


def _columns(width: float, entries: int) -> int:
    return min(entries, max(1, int((width - _LEFT) / _ENTRY)))


def _head(plane: Axes, marks: list[Artist]) -> Text:
    figure: Any = plane.figure
    width, height = figure.get_size_inches()
    plane.legend(
        handles=marks,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=_columns(width, len(marks)),
        frameon=False,
        fontsize="small",
        borderaxespad=0.2,
        columnspacing=1.2,
        handlelength=1.6,
    )
    return plane.text(
        _LEFT / width,
        1.0 - 0.6 * _TITLE / height,
        "",
        transform=figure.transFigure,
        weight="bold",
        va="baseline",
    )


def _check(posterior: Any) -> Kind:
    """The kind of a posterior whose path can be drawn; another one is refused."""
    known = isinstance(posterior, Posterior)
    if not known or not posterior._outcome.moving:
        what = posterior._title if known else f"a {type(posterior).__name__}"
        raise ModelError(
            "animate draws the posterior of a dynamic network with Gaussian beliefs or particles, "
            f"not {what}; beliefs of cells, of grids or tables, are for "
            "pgm.plot.animate_beliefs(posterior[x], path)"
        )
    if isinstance(posterior.graph, BalancedGraph):
        raise ModelError(
            "animate draws a chain, step after step, and this is a balanced tree, all of a level "
            "of which sends at once; leave method=pgm.Balanced() out"
        )
    kind: Kind = posterior.kind
    return kind


def _state(posterior: Posterior[Any], variable: Variable | None) -> Variable:
    states: Scope = posterior.graph.layout.states
    if variable is None:
        found = next((each for each in states if each.dimension > 1), None)
        if found is None:
            raise ModelError(
                f"a path is drawn of a state with two components or more; the states "
                f"{list(states)} have one each: draw these with pgm.plot.errors"
            )
        return found
    if variable not in states:
        raise ModelError(f"variable={variable!r} is no state; the model has {list(states)}")
    return variable


def _one(belief: Any, run: int | Sequence[int] | None) -> Gaussian:
    gaussian = as_gaussian(belief)
    lead = gaussian.mean.shape[:-2]
    if run is None:
        if any(size != 1 for size in lead):
            raise ModelError(
                f"the posterior has the leading axes {lead}, of runs; choose one, as with run=0"
            )
        return one_run(gaussian)
    index = (run,) if is_whole(run) else as_tuple(run) or ()
    if len(index) != len(lead) or not all(
        is_whole(k) and -size <= k < size for k, size in zip(index, lead, strict=False)
    ):
        raise ModelError(f"run={run!r} is none of the runs, whose axes are {lead}")
    return one_run(gaussian.run(*index))


def _pair(
    belief: Gaussian, components: tuple[str, str] | None, confidence: float
) -> tuple[str, str]:
    belief.ellipse(confidence, components)  # refuses what does not fit
    first, second = as_tuple(components) or labels(belief.scope)[:2]
    return first, second


def _truth(belief: Gaussian, truth: npt.ArrayLike, places: Sequence[int]) -> Array:
    line = truth_columns(belief, truth, places)
    if line.shape[:-1] != (len(belief.mean),):
        raise ModelError(
            f"the truth has {' × '.join(map(str, line.shape[:-1]))} rows; one for each of the "
            f"{len(belief.mean)} steps 0..T was due"
        )
    return line
