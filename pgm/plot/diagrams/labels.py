"""Labels of the shapes of a picture."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from pgm.clustergraph import Cluster
from pgm.plot.diagrams.canvas import text_size
from pgm.variables import Variable

# A line wider than this, in points, is broken.
_WIDEST = 84.0
_EMPTY = "∅"

# A name wider than this, in points, is broken where its words end.
_LONG_NAME = 44.0


def node_label(node: Variable) -> str:
    """``x[3]``, on several lines where the name is long."""
    step = "" if node.step is None else f"[{node.step}]"
    if text_size(node.name + step).width <= _LONG_NAME:
        return node.name + step
    words = [word for word in re.split(r"(?<=[_\s.\-])", node.name) if word]
    lines = _filled([*words, step] if step else words, _LONG_NAME, "")
    return "\n".join(line.strip() for line in lines)


def _filled(words: Iterable[str], width: float = _WIDEST, between: str = ", ") -> list[str]:
    """Words on lines no wider than the width, or than the longest word."""
    lines: list[str] = []
    for word in words:
        if lines and text_size(longer := f"{lines[-1]}{between}{word}").width <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def scope_label(scope: Iterable[Variable], most: int | None = None) -> str:
    """Variables, on as many lines as a narrow shape needs; those beyond `most` are counted."""
    return _text([[_short(repr(v)) for v in group] for group in _by_step(scope)], most)


def cluster_label(
    cluster: Cluster,
    observed: frozenset[Variable],
    counts: Mapping[Variable, int],
    most: int | None = None,
) -> str:
    """The variables of a cluster: hidden ones first, then the observed ones, a line a family.

    Parameters
    ----------
    cluster : Cluster
    observed : frozenset of Variable
        Those known to be observed, as variables or as templates for all steps.
    counts : mapping of Variable to int
        Measurements of a sensor at a step: more than one are shown as ``z[3] ×4``; a sensor with
        none is left out, and so are the observed parents that it alone has in the cluster.
    most : int, optional
        Variables beyond this many are only counted, as ``+5``.
    """
    known = {v for v in cluster.scope if v in observed or v.template in observed}
    hidden = [v for v in cluster.scope if v not in known]
    groups = _by_step(hidden)
    left = {v: None for v in cluster.scope if v in known}  # a dict keeps the order
    for family in cluster.families:
        group = [v for v in family if v in left]
        if counts.get(family[0]) != 0:
            groups.append(group)
            for v in group:
                del left[v]
    mentioned = {v for family in cluster.families for v in family}
    groups.append([v for v in left if v not in mentioned])
    return _text([[_counted(v, counts.get(v, 1)) for v in group] for group in groups], most)


def _by_step(scope: Iterable[Variable]) -> list[list[Variable]]:
    """Variables of different steps apart, where they do not fit on a line."""
    found = list(scope)
    if len(_filled(map(repr, found))) <= 1:
        return [found]
    steps = sorted({v.step for v in found if v.step is not None})
    return [[v for v in found if v.step == step] for step in [None, *steps]]


def _text(groups: list[list[str]], most: int | None) -> str:
    """Words, each group on lines of its own; the last of too many are counted."""
    count = sum(map(len, groups))
    if most is not None and count > most:
        room = most - 1
        shown = [
            group[: max(0, room - sum(map(len, groups[:k])))] for k, group in enumerate(groups)
        ]
        last = max(k for k, group in enumerate(shown) if group)
        shown[last].append(f"+{count - room}")
        groups = shown
    return "\n".join(line for group in groups for line in _filled(group)) or _EMPTY


def _counted(variable: Variable, count: int) -> str:
    return _short(repr(variable)) + ("" if count <= 1 else f" ×{count}")


def _short(name: str) -> str:
    """A name, or where it is too long for a line, its ends."""
    cut = name
    keep = len(name)
    while text_size(cut).width > _WIDEST and keep > 2:
        keep -= 1
        cut = f"{name[: keep - keep // 3]}…{name[len(name) - keep // 3 :]}"
    return cut
