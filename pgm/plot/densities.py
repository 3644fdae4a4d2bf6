"""The densities of CPDs, written beside the nodes of slices."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

from pgm.networks import BayesianNetwork, DynamicBayesianNetwork
from pgm.networks.static import density
from pgm.plot.canvas import Point, Size, text_size
from pgm.variables import Variable

# A density begins so far to the right of its node's centre, in radii, to be clear of arrows down.
_AWAY = 0.5
_GAP = 10.0


def densities(
    model: BayesianNetwork | DynamicBayesianNetwork, nodes: Iterable[Variable]
) -> dict[Variable, str]:
    """The density of each node that has a CPD."""
    if isinstance(model, DynamicBayesianNetwork):
        model = model.unroll(max(node.step or 0 for node in nodes))
    return {cpd.child: density(cpd) for cpd in model.cpds}


def spread(
    points: dict[Variable, Point], texts: dict[Variable, str], radius: float
) -> dict[Variable, Point]:
    """Columns farther apart, where a text would else reach those of the next node in its row."""
    factor = 1.0
    in_rows = sorted(points, key=lambda node: points[node][::-1])
    for node, after in pairwise(in_rows):
        (x, y), (beyond, row) = points[node], points[after]
        if node in texts and y == row:
            due = text_size(texts[node]).width + _AWAY * radius + _GAP
            factor = max(factor, due / (beyond - x))
    return {node: (factor * x, y) for node, (x, y) in points.items()}


def lower_right(at: Point, radius: float, text: Size) -> Point:
    """The centre of a text at the lower right of a node."""
    return at[0] + _AWAY * radius + 0.5 * text.width, at[1] - radius - 0.5 * text.height
