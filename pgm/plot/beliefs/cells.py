"""Cells in the plane: of maps of occupancy, and of beliefs over them."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize, to_rgba
from matplotlib.font_manager import FontProperties
from matplotlib.patches import Rectangle
from matplotlib.textpath import text_to_path

from pgm.arguments import public
from pgm.boundary import is_whole
from pgm.errors import ModelError
from pgm.factors import Table
from pgm.inference import GridBelief
from pgm.kernels.arrays import Array
from pgm.maps import OccupancyMap
from pgm.plot.beliefs.plane import as_landmarks, as_truth, finish, plane_of
from pgm.plot.beliefs.stacks import as_index, as_places, chances, name_states
from pgm.plot.drawing.axes import Unit, equal_aspect, given_or_new, name_axes
from pgm.plot.drawing.colours import CHANCE, INK, MUTED, PALETTE, readable_on

# Numbers in more cells than this are too many to read, and lines between more hide the cells.
_WRITTEN = 30
_RULED = 600
# Of numbers, in points, where there is room, and in small cells; how much of a cell they fill.
_LETTERS, _SMALLEST, _FULL = 8.3, 5.5, 0.9


@public
def belief_map(
    belief: Table,
    *,
    places: npt.ArrayLike | None = None,
    most: float | None = None,
    truth: str | int | tuple[str | int, str | int] | None = None,
    numbers: bool | None = None,
    outside: str = "none",
    ax: Axes | None = None,
) -> Axes:
    """Draw a belief over cells as a map, seen from above.

    Rows go down from the top. The drawn mesh is ``ax.collections[0]``, from which
    ``figure.colorbar`` makes a bar.

    Parameters
    ----------
    belief : Table
        At one step: over two variables, whose states are rows and columns, or over one, whose
        states are cells with `places`.
    places : array_like of int, optional
        (K, 2): row and column of each state. Places of no state are left empty.
    most : float, optional
        The probability of the darkest colour, for maps that are to be compared; without, that of
        the most probable cell.
    truth : str, int or pair of these, optional
        The cell that is right, by name or number, which is framed; a row and a column for two
        variables.
    numbers : bool, optional
        Whether probabilities are written in the cells; without, in up to 30 cells where they can
        be read.
    outside : str
        Colour of the map where there is no cell.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's without.

    Raises
    ------
    ModelError
        If the belief is over other variables or several steps, or an argument does not fit it.
    NumericalError
        If the belief is all zero.

    Examples
    --------
    >>> place = pgm.Discrete("place", states=("hall", "room"))
    >>> ax = pgm.plot.belief_map(pgm.Table(place, [0.25, 0.75]), places=[[0, 0], [0, 1]])
    >>> [text.get_text() for text in ax.texts]
    ['0.25', '0.75']
    """
    found = chances(belief, (1, 2), 0, "one belief, at one step, over one or two variables")
    if (len(belief.scope) == 1) != (places is not None):
        raise ModelError(
            "places are the cells of a table over one variable, whose states have no rows and "
            "columns of their own; a table over two has"
        )
    at = as_places(places, found.size) if places is not None else _grid(found.shape)
    if most is None:
        most = float(found.max())
    elif not (np.isfinite(most) and most > 0.0):
        raise ModelError(f"most must be a probability above 0, not {most!r}")
    right = None if truth is None else at[_place(belief, truth)]

    ax = given_or_new(ax)
    ax.set_facecolor(outside)
    first, last = at.min(axis=0), at.max(axis=0)
    shape = last - first + 1
    mesh = np.full(shape, np.nan)
    mesh[tuple((at - first).T)] = found.ravel()
    # Lines around cells alone: where there is none, nothing is drawn.
    lines = np.where(np.isnan(mesh).reshape(-1, 1), to_rgba(MUTED, 0.0), to_rgba(MUTED))
    ruled: dict[str, Any] = {"edgecolors": lines, "linewidth": 0.4}
    rows, columns = (np.arange(f, e + 2) - 0.5 for f, e in zip(first, last, strict=True))
    norm = Normalize(0.0, most, clip=True)
    ax.pcolormesh(
        columns,
        rows,
        np.ma.masked_invalid(mesh),
        cmap=CHANCE,
        norm=norm,
        **(ruled if found.size <= _RULED else {"rasterized": True}),
    )
    texts = [f"{p:.3g}" if p >= 5e-4 else f"{p:.0g}" for p in found.ravel().tolist()]
    letters = _fitting(texts, ax, shape)
    if numbers if numbers is not None else found.size <= _WRITTEN and letters >= _SMALLEST:
        for (row, column), probability, text in zip(
            at.tolist(), found.ravel().tolist(), texts, strict=True
        ):
            ax.text(
                column,
                row,
                text,
                ha="center",
                va="center",
                fontsize=max(letters, _SMALLEST),
                color=readable_on(CHANCE(float(norm(probability)))),
            )
    if right is not None:
        row, column = right.tolist()
        # A frame inside the cell, since a mark in the middle would hide the number.
        frame = Rectangle(
            (column - 0.45, row - 0.45), 0.9, 0.9, fill=False, ec=PALETTE[1], lw=2.2, zorder=3.0
        )
        frame.set_label("truth")
        ax.add_patch(frame)
    ax.set_xlim(columns[0], columns[-1])
    ax.set_ylim(rows[-1], rows[0])
    ax.set_aspect("equal")
    if len(belief.scope) == 2:
        name_states(ax, ax.xaxis, belief.scope[1])
        name_states(ax, ax.yaxis, belief.scope[0])
        name_axes(ax, belief.scope[1].name, belief.scope[0].name)
    else:
        ax.set_xticks([])
        ax.set_yticks([])
    return ax


def _fitting(texts: Iterable[str], ax: Axes, shape: npt.NDArray[Any]) -> float:
    frame = ax.get_window_extent()
    cell = 72.0 / ax.figure.dpi * min(frame.width / shape[1], frame.height / shape[0])
    font = FontProperties(size=_LETTERS)
    widest = max(text_to_path.get_text_width_height_descent(one, font, False)[0] for one in texts)
    return float(min(_LETTERS, _LETTERS * _FULL * cell / widest))


def _grid(shape: tuple[int, ...]) -> npt.NDArray[np.int_]:
    return np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 2)


def _place(belief: Table, truth: str | int | tuple[str | int, str | int]) -> int:
    states = truth if isinstance(truth, tuple) else (truth,)
    if len(states) != len(belief.scope):
        raise ModelError(
            f"the truth {truth!r} has {len(states)} parts; one was due for each of "
            f"{list(belief.scope)}"
        )
    index = [as_index(v, state) for v, state in zip(belief.scope, states, strict=True)]
    return int(np.ravel_multi_index(index, tuple(v.size for v in belief.scope)))


# A cell whose arrow would stand for less than this share of the likeliest has none.
_FAINT = 0.02
# From white, of a probability of zero, to the first colour of the palette.
_MAP: Colormap = LinearSegmentedColormap.from_list("belief", ["white", PALETTE[0]])


@public
def grid_map(
    belief: GridBelief,
    *,
    components: tuple[str, str] | None = None,
    heading: str | None = None,
    arrows: int = 16,
    truth: npt.ArrayLike | None = None,
    landmarks: npt.ArrayLike | None = None,
    unit: Unit = None,
    ax: Axes | None = None,
    **style: Any,
) -> Axes:
    r"""Draw a belief on a grid: the probabilities of two components, and an angle's as arrows.

    An arrow stands for a block of cells: its direction is the circular mean of the angle there,

    .. math:: R e^{iθ} = \sum_k p_k e^{iθ_k} / \sum_k p_k,

    and its length R, which is 1 where the angle is known and 0 where nothing is known of it.

    Parameters
    ----------
    belief : GridBelief
        The belief of one run at one step, for instance ``posterior[x.at(3)]``.
    components : pair of str, optional
        Which components are the plane's, by name; the first two that are no angles without.
    heading : str, optional
        The angle that is drawn as arrows, counted from the belief's first straight component to
        its second, whichever of them is drawn along which axis; without, the belief's only angle,
        or none where there are several.
    arrows : int
        How many along the longer side of the map at the most; 0 for none.
    truth : array_like, optional
        (n,), in the order of the belief's components; its place is marked by a cross.
    landmarks, unit, ax
        See `trajectory`.
    **style
        Properties of `matplotlib.axes.Axes.pcolormesh`, which win over the defaults.

    Raises
    ------
    ModelError
        If it is no belief on a grid, of several runs or steps, or lacks the components; or an
        argument does not fit.

    Examples
    --------
    >>> from pgm.examples import drive, p, q
    >>> cells = pgm.Grid({"east": (-5.0, 5.0, 20), "north": (-5.0, 5.0, 20)})
    >>> posterior = pgm.filter(drive, {q: [[1.0, 2.0]]}, belief=cells)
    >>> ax = pgm.plot.grid_map(posterior[p.at(1)], landmarks=[[0.0, 3.0]])
    """
    if not isinstance(belief, GridBelief):
        raise ModelError(f"grid_map draws a belief on a grid, not a {type(belief).__name__}")
    if not is_whole(arrows) or arrows < 0:
        raise ModelError(f"arrows are a whole number, 0 or more, not {arrows!r}")
    plane = plane_of(belief, components, heading)
    cells = belief.marginal(*plane.pair)
    mark, marks = as_truth(belief, truth, plane), as_landmarks(landmarks)

    ax = given_or_new(ax)
    edges = [_edges(centres) for centres in cells.centres]
    defaults: dict[str, Any] = {"cmap": _MAP, "vmin": 0.0}
    ax.pcolormesh(*edges, cells.values.T, **(defaults | style))
    if plane.heading is not None and arrows:
        turning = belief.marginal(*plane.pair, plane.heading)
        _draw_arrows(ax, turning, int(arrows), plane.mirrored)
    ax.use_sticky_edges = False  # marks at the edge of the cells are whole
    return finish(ax, plane, marks, mark, unit)


def _edges(centres: Array) -> Array:
    half = 0.5 * (centres[1] - centres[0])
    found: Array = np.append(centres - half, centres[-1] + half)
    return found


def _draw_arrows(ax: Axes, belief: GridBelief, count: int, mirrored: bool) -> None:
    """Arrows of the third component, one for each block of cells of the first two."""
    widths = np.array([centres[1] - centres[0] for centres in belief.centres[:2]])
    apart = float((widths * belief.values.shape[:2]).max()) / count
    blocks = np.maximum(np.ceil(apart / widths - 1e-9), 1.0).astype(int).tolist()
    turn = np.exp(1j * belief.centres[2])
    if mirrored:
        turn = 1j * turn.conj()
    weight = _summed(belief.values.sum(axis=2), blocks)
    total = _summed(belief.values @ turn, blocks)
    seen = weight > _FAINT * weight.max()
    mean = total[seen] / weight[seen]
    each = zip(belief.centres[:2], blocks, strict=True)
    east, north = (_middles(centres, block) for centres, block in each)
    places = np.nonzero(seen)
    reach = 0.9 * float((widths * blocks).min())
    ax.quiver(
        east[places[0]],
        north[places[1]],
        reach * mean.real,
        reach * mean.imag,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        pivot="mid",
        color=INK,
        width=0.0035,
    )


def _summed(array: npt.NDArray[Any], blocks: Sequence[int]) -> npt.NDArray[Any]:
    """Sums over blocks of cells along both axes; the last ones may be smaller."""
    for axis, block in enumerate(blocks):
        array = np.add.reduceat(array, np.arange(0, array.shape[axis], block), axis=axis)
    return array


def _middles(centres: Array, block: int) -> Array:
    first = np.arange(0, len(centres), block)
    last = np.minimum(first + block, len(centres)) - 1
    found: Array = 0.5 * (centres[first] + centres[last])
    return found


# A tint that no probability has.
_UNKNOWN = "#D5E3EE"
_GREYS = colormaps["Greys"].with_extremes(bad=_UNKNOWN)


@public
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
