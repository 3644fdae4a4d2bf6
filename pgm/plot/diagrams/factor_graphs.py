"""Factor graphs: variables as circles, and factors as squares joined to theirs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import networkx as nx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse, Rectangle

from pgm.arguments import public
from pgm.display import titled
from pgm.errors import ModelError
from pgm.networks import DynamicBayesianNetwork, MarkovNetwork
from pgm.plot.diagrams.canvas import Size, node_label, open_canvas, room, slack, text_size
from pgm.plot.diagrams.layered import layered
from pgm.plot.diagrams.networks import from_the_middle, last, named
from pgm.plot.drawing.colours import INK, OBSERVED
from pgm.variables import Variable

# The side of a factor's square, and the least width of a variable's circle, in points.
_SQUARE, _SMALLEST = 10.0, 30.0


@public
def factor_graph(
    model: MarkovNetwork | DynamicBayesianNetwork,
    *,
    steps: int | None = None,
    evidence: Iterable[Variable] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw a factor graph: a circle for each variable, and a square for each factor.

    A factor, of a Bayesian network a CPD, is joined to the variables that it is of. Two networks
    with one Markov network, like one factor of three variables and three factors of two, have
    different factor graphs.

    Parameters
    ----------
    model : MarkovNetwork, BayesianNetwork or DynamicBayesianNetwork
    steps : int, optional
        The last slice of a dynamic network drawn; 1 without.
    evidence : iterable or mapping of Variable, optional
        What is observed, and shaded.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's, as large as it needs, without.

    Raises
    ------
    ModelError
        If `model` is no network, or `steps` is no step.
    EvidenceError
        If the evidence names what is no variable of it.

    Examples
    --------
    >>> a, b, c = (pgm.Discrete(name, states=2) for name in "abc")
    >>> net = pgm.MarkovNetwork([pgm.Table.vacuous((a, b, c)), pgm.Table.vacuous(c)])
    >>> ax = pgm.plot.factor_graph(net)
    >>> len(ax.patches)
    5

    References
    ----------
    Kschischang, Frey & Loeliger, Factor graphs and the sum-product algorithm, 2001.
    """
    scopes = _scopes(model, steps)
    plain: nx.Graph[Any] = nx.Graph()
    plain.add_nodes_from(dict.fromkeys(v for scope in scopes for v in scope))
    observed = named(() if evidence is None else evidence, plain)
    for number, scope in enumerate(scopes):
        plain.add_edges_from((number, variable) for variable in scope)
    graph = from_the_middle(plain)
    labels = {node: node_label(node) for node in graph if isinstance(node, Variable)}
    texts = {node: text_size(label) for node, label in labels.items()}
    sizes: dict[Any, Size] = dict.fromkeys(graph, Size(_SQUARE, _SQUARE))
    for variable, text in texts.items():
        across = max(_SMALLEST, float(np.hypot(*text)) + 6.0)
        sizes[variable] = Size(across, across)
    layout = layered(graph, sizes, room(ax))
    letters = slack(list(texts.values()), [sizes[node] for node in texts])
    canvas = open_canvas(ax, layout.box(sizes), letters)
    for curve in layout.lines.values():
        canvas.line(curve, colour=INK, width=0.9)
    for node, (x, y) in layout.points.items():
        if isinstance(node, Variable):
            shade = OBSERVED if node in observed or node.template in observed else "white"
            canvas.shape(Ellipse((x, y), *sizes[node]), shade, 1.0)
            canvas.text((x, y), labels[node])
        else:
            corner = x - 0.5 * _SQUARE, y - 0.5 * _SQUARE
            canvas.shape(Rectangle(corner, _SQUARE, _SQUARE), INK, 1.0)
    return canvas.ax


def _scopes(model: Any, steps: int | None) -> Sequence[tuple[Variable, ...]]:
    """The variables of each factor of a network, but of those that are numbers."""
    if isinstance(model, DynamicBayesianNetwork):
        model = model.unroll(1 if steps is None else last(steps, "slice", ModelError))
    elif not isinstance(model, MarkovNetwork):
        raise ModelError(f"factor_graph draws a network, not {titled(model)}")
    elif steps is not None:
        raise ModelError("steps cut a DynamicBayesianNetwork; leave them out")
    return [factor.scope for factor in model.factors if factor.scope]
