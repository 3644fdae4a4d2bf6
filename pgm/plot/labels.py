"""What a cluster and a sepset say in a picture."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pgm.clustergraph import Cluster
from pgm.plot.canvas import text_size
from pgm.variables import Variable

# A line wider than this, in points, is broken.
_WIDEST = 84.0
_EMPTY = "∅"


def scope_label(scope: Iterable[Variable]) -> str:
    """Variables, on as many lines as a narrow shape needs."""
    return "\n".join(_lines(map(repr, scope))) or _EMPTY


def cluster_label(
    cluster: Cluster, observed: frozenset[Variable], counts: Mapping[Variable, int]
) -> str:
    """The variables of a cluster: hidden ones first, then the observed ones, a line a family.

    Parameters
    ----------
    cluster : Cluster
    observed : frozenset of Variable
        Those known to be observed, as variables or as templates for all steps.
    counts : mapping of Variable to int
        Readings of a sensor at a step: more than one are shown as ``z[3] ×4``; a sensor with none
        is left out, and so are the observed parents that it alone has in the cluster.
    """
    known = {v for v in cluster.scope if v in observed or v.template in observed}
    hidden = [v for v in cluster.scope if v not in known]
    lines = _lines(map(repr, hidden))
    if len(lines) > 1:
        steps = sorted({v.step for v in hidden if v.step is not None})
        groups = [[v for v in hidden if v.step == step] for step in [None, *steps]]
        lines = [line for group in groups for line in _lines(map(repr, group))]
    left = {v: None for v in cluster.scope if v in known}  # a dict keeps the order
    for family in cluster.families:
        group = [v for v in family if v in left]
        if counts.get(family[0]) != 0:
            lines += _lines(_counted(v, counts.get(v, 1)) for v in group)
            for v in group:
                del left[v]
    mentioned = {v for family in cluster.families for v in family}
    lines += _lines(repr(v) for v in left if v not in mentioned)
    return "\n".join(lines) or _EMPTY


def _counted(variable: Variable, count: int) -> str:
    return repr(variable) if count <= 1 else f"{variable!r} ×{count}"


def _lines(words: Iterable[str]) -> list[str]:
    lines: list[str] = []
    for word in words:
        longer = f"{lines[-1]}, {word}" if lines else word
        if lines and text_size(longer).width <= _WIDEST:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines
