"""Pictures of networks and cluster graphs for notebooks, as SVG within HTML."""

import io
import re
import warnings
from html import escape
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.errors import PgmError
from pgm.networks import MarkovNetwork
from pgm.plot.diagrams.clusters import cluster_graph
from pgm.plot.diagrams.networks import Network, network

# The most variables, and clusters, of a picture that is legible on a page.
VARIABLES, CLUSTERS = 60, 40
# Steps of a dynamic graph that are drawn of more.
STEPS = 4
# Widths and heights, in points, to which larger pictures shrink.
WIDE, HIGH = 640.0, 480.0

# Letters are shapes, so that no font is missing and no name is markup.
_LINES = "stroke-linejoin: round; stroke-linecap: butt"
_ABOUT = ("Creator", "Date", "Format", "Type")
_STYLE: dict[Any, Any] = {"svg.fonttype": "path", "svg.hashsalt": "pgm", "text.usetex": False}


def svg(value: Network | ClusterGraph) -> str:
    """A network or cluster graph as SVG on a white ground, or a word where it is too large."""
    size, most = _size(value)
    if size > most:
        call = "cluster_graph(graph" if isinstance(value, ClusterGraph) else "network(model"
        return f"<p>{size:,} are too many to draw here; <code>pgm.plot.{call}, ax=ax)</code></p>"
    # Nothing may be shown twice by notebooks that show all figures, nor remain.
    with mpl.rc_context(_STYLE), plt.ioff(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")
        try:
            figure = _drawn(value).figure
        except PgmError:
            return ""
        assert isinstance(figure, Figure)
        text = io.StringIO()
        try:
            figure.savefig(
                text,
                format="svg",
                facecolor="white",
                transparent=False,
                bbox_inches="tight",
                metadata=dict.fromkeys(_ABOUT),
            )
        finally:
            plt.close(figure)
    return _within_html(text.getvalue(), type(value).__name__)


def _size(value: Network | ClusterGraph) -> tuple[int, int]:
    if isinstance(value, DynamicGraph):
        return len(value.model.cpds), VARIABLES
    if isinstance(value, ClusterGraph):
        return len(value), CLUSTERS
    if isinstance(value, MarkovNetwork):
        return len(value.variables), VARIABLES
    return len(value.cpds), VARIABLES


def _drawn(value: Network | ClusterGraph) -> Axes:
    if not isinstance(value, ClusterGraph):
        return network(value)
    if isinstance(value, DynamicGraph) and value.steps > STEPS:
        return cluster_graph(value, steps=STEPS)
    return cluster_graph(value)


def _within_html(document: str, name: str) -> str:
    tag, rest = document[document.index("<svg") :].split(">", 1)
    # Rules of a style sheet would hold for the whole page that the picture stands on.
    rest = re.sub(r"<style.*?</style>", "", rest, flags=re.DOTALL)
    extent = dict(re.findall(r'(width|height)="([0-9.]+)pt"', tag))
    width, height = float(extent["width"]), float(extent["height"])
    scale = min(1.0, WIDE / width, HIGH / height)
    tag = re.sub(r'\s(width|height)="[^"]*"', "", tag)
    size = f'width="{width * scale:.0f}pt" height="{height * scale:.0f}pt"'
    look = f'style="max-width: 100%; background: white; {_LINES}"'
    return f'{tag} {size} role="img" aria-label="{escape(name)}" {look}>{rest}'
