"""The picture of docs/architecture.md: ``python docs/architecture.py`` draws it anew."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch, Rectangle
from PIL import Image

PICTURE = Path(__file__).parent / "images" / "architecture.png"


class Layer(NamedTuple):
    """A layer of the package: its folders and files, what they hold, and its height in rows."""

    names: str
    holds: str
    rows: float = 1.0


class Station(NamedTuple):
    """A place on the way of a value: its text, its layer, and where it stands in that."""

    text: str
    layer: str
    x: float
    up: float = 0.5  # of the layer's height
    width: float = 1.9


class Leg(NamedTuple):
    """An arrow between stations: from where and to where along their edges, and what it carries."""

    start: str
    end: str
    leaves: float = 0.0
    meets: float = 0.0
    text: str = ""
    beside: tuple[float, float] = (0.0, 0.0)  # of the arrow's middle
    back: bool = False


# From top to bottom; each imports from those below it, and kernels from no other.
LAYERS = [
    Layer(
        "io, recordings, consistency, comparison, plot, results, viewer, examples",
        "logs, checks, pictures",
    ),
    Layer("learning", "parameters"),
    Layer("inference", "the calls"),
    Layer("beliefs", "a folder a family", 3.0),
    Layer("schedules, elimination", "messages, sweeps", 1.3),
    Layer("posteriors", "what is answered"),
    Layer("compile", "networks to graphs"),
    Layer("clustergraph", "clusters and sepsets"),
    Layer("networks", "static, dynamic"),
    Layer("evidence", "values by row"),
    Layer("linearisation", "CPDs at their rows"),
    Layer("cpds, maps", "means, noises, scans"),
    Layer("linearisers", "slope, value, error"),
    Layer("factors, tracing", "densities; functions as graphs"),
    Layer(
        "variables, units, errors, arguments, boundary, immutable, resources, progress, "
        "display, workers",
        "names",
    ),
    Layer("kernels", "mathematics of arrays; machine code"),
]
STATIONS = {
    "call": Station("pgm.filter", "inference", 3.3, width=1.2),
    "bind": Station("bind: rows of u and z", "evidence", 3.5),
    "graph": Station("a chain of slices", "compile", 4.4, width=1.7),
    "plan": Station("ChainPlan:\nCPDs at their rows", "beliefs", 4.5, 0.76, 1.7),
    "sweep": Station("sweep.forward:\nstep after step", "schedules, elimination", 6.1, width=1.7),
    "predict": Station("MomentChain.predict", "beliefs", 7.7, 0.8, 1.8),
    "take": Station("MomentChain.take", "beliefs", 9.8, 0.8, 1.8),
    "line": Station("Family.line", "linearisation", 7.2, width=1.5),
    "vector": Station("vector", "beliefs", 10.0, 0.25, 1.2),
    "rule": Station("the lineariser", "linearisers", 6.45, width=1.4),
    "bound": Station("BoundFunction", "linearisers", 4.75, width=1.5),
    "trace": Station("its trace", "factors, tracing", 4.75, width=1.2),
    "yours": Station("your f(x, u)", "linearisers", 3.15, width=1.2),
    "ahead": Station("gaussian.predict", "kernels", 7.6, width=1.6),
    "update": Station("gaussian.update", "kernels", 9.7, width=1.6),
    "record": Station("posterior", "posteriors", 11.0, width=1.4),
    "result": Station("Gaussian", "factors, tracing", 11.35, width=1.1),
}
LEGS = [
    Leg("call", "bind", 0.0, -0.2),
    Leg("bind", "graph", 0.4, -0.5),
    Leg("graph", "plan"),
    Leg("plan", "sweep"),
    Leg("sweep", "predict", 0.3, -0.3),
    Leg("sweep", "take", 0.6, -0.5),
    Leg("predict", "line", -0.3, -0.2),
    Leg("take", "line", -0.3, 0.2),
    Leg("line", "rule", -0.3, 0.0, "belief\nover the\nparents", (-0.48, 0.1)),
    Leg("rule", "bound"),
    Leg("bound", "yours"),
    Leg("bound", "trace"),
    Leg("line", "ahead", 0.25, 0.0, "F, value,\nerror", (0.5, 0.1), back=True),
    Leg("line", "vector", 0.55, -0.1, back=True),
    Leg("ahead", "update", text="belief", beside=(0.0, 0.25), back=True),
    Leg("vector", "update", 0.2, 0.0, "H, z − ẑ, R", (-0.65, 0.1), back=True),
    Leg("update", "record", 0.3, -0.2, "mean,\ncov", (0.42, 0.1), back=True),
    Leg("record", "result", 0.35, 0.0, "of x", (0.3, 0.1), back=True),
]

WIDTH, ROW, FOOT = 12.2, 0.52, 0.6
HALF = 0.3  # of a station's height, in rows
BANDS, INK, SOFT = ("#f5f5f5", "#e8e8e8"), "0.2", "0.4"
OURS, YOURS, THERE, BACK = "#ffffff", "#ffeeb8", "#0072B2", "#D55E00"  # Okabe and Ito's


def draw() -> Figure:
    """The layers, and the way of one value through them."""
    top = sum(layer.rows for layer in LAYERS)
    figure = Figure(figsize=(WIDTH, ROW * (top + FOOT)))
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.set(xlim=(0.0, WIDTH), ylim=(-FOOT, top))
    ax.axis("off")
    floors = _layers(ax, top)
    boxes = {name: _station(ax, station, floors) for name, station in STATIONS.items()}
    for leg in LEGS:
        _leg(ax, boxes[leg.start], boxes[leg.end], leg)
    _legend(ax, top)
    return figure


def _layers(ax: Axes, top: float) -> dict[str, tuple[float, float]]:
    """Draw the layers; the floor and the height of each."""
    found = {}
    for index, (names, holds, rows) in enumerate(LAYERS):
        top -= rows
        found[names] = top, rows
        ax.add_patch(Rectangle((0.0, top), WIDTH, rows, color=BANDS[index % 2], lw=0))
        style = {"x": 0.4, "fontsize": 9, "va": "center"}
        ax.text(y=top + rows / 2 + 0.18, s=names, weight="bold", color=INK, **style)
        ax.text(y=top + rows / 2 - 0.22, s=holds, color=SOFT, **style)
    return found


def _station(ax: Axes, station: Station, floors: dict[str, tuple[float, float]]) -> FancyBboxPatch:
    floor, rows = floors[station.layer]
    y, half = floor + station.up * rows, HALF * (1 + 0.6 * station.text.count("\n"))
    box = FancyBboxPatch(
        (station.x - station.width / 2, y - half),
        station.width,
        2 * half,
        boxstyle="round,pad=0,rounding_size=0.1",
        facecolor=YOURS if station is STATIONS["yours"] else OURS,
        edgecolor=SOFT,
        label="station",
    )
    ax.add_patch(box)
    ax.text(station.x, y, station.text, ha="center", va="center", fontsize=9, color=INK)
    return box


def _leg(ax: Axes, start: FancyBboxPatch, end: FancyBboxPatch, leg: Leg) -> None:
    colour = BACK if leg.back else THERE
    middles = [
        (b.get_x() + b.get_width() / 2, b.get_y() + b.get_height() / 2) for b in (start, end)
    ]
    (x, y), (to_x, to_y) = middles
    x, to_x = x + leg.leaves, to_x + leg.meets
    ax.add_patch(
        FancyArrowPatch(
            (x, y),
            (to_x, to_y),
            patchA=start,
            patchB=end,
            shrinkA=0,
            shrinkB=1,
            arrowstyle="-|>",
            mutation_scale=12,
            linewidth=1.4,
            color=colour,
        )
    )
    if leg.text:
        where = (x + to_x) / 2 + leg.beside[0], (y + to_y) / 2 + leg.beside[1]
        ax.text(*where, leg.text, ha="center", va="center", fontsize=8.5, color=colour)


def _legend(ax: Axes, top: float) -> None:
    arrow = {"arrowstyle": "-|>", "color": SOFT, "lw": 1.2}
    ax.annotate("", (0.2, 0.2), (0.2, top - 0.2), arrowprops=arrow)
    y, style = -FOOT / 2, {"va": "center", "fontsize": 9}
    ax.text(0.4, y, "imports point down", color=SOFT, **style)
    ax.text(3.0, y, "→ a control, a measurement, a belief on the way in", color=THERE, **style)
    ax.text(7.4, y, "→ the linearisation and the belief on the way out", color=BACK, **style)


def save(path: Path = PICTURE) -> None:
    """Write the picture, with few colours."""
    drawn = BytesIO()
    draw().savefig(drawn, dpi=100)
    Image.open(drawn).convert("RGB").quantize(48).save(path, optimize=True)


if __name__ == "__main__":
    save()
