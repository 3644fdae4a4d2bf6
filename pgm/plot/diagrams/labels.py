"""Labels of the shapes of a picture."""

import re
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby

from pgm.clustergraph import Cluster
from pgm.plot.diagrams.canvas import text_size
from pgm.variables import Variable

# A line wider than this, in points, is broken.
_WIDEST = 84.0
_EMPTY = "∅"
# As many families that are like others are listed one by one, and as many hidden variables alike.
_LISTED, _NAMED = 5, 8
_NUMBER = re.compile(r"\d+")

# A name wider than this, in points, is broken where its words end.
_LONG_NAME = 44.0
# A word of a name wider than this is cut.
_LONGEST_WORD = 4.0 * _WIDEST


def node_label(node: Variable) -> str:
    """``x[3]``, on several lines where the name is long."""
    step = "" if node.step is None else f"[{node.step}]"
    if text_size(node.name + step).width <= _LONG_NAME:
        return node.name + step
    parts = re.split(r"(?<=[_\s.\-])", node.name)
    words = [_short(word, _LONGEST_WORD) for word in parts if word]
    lines = _filled([*words, step] if step else words, _LONG_NAME, "")
    return "\n".join(line.strip() for line in lines)


def _filled(words: Iterable[str], width: float = _WIDEST, between: str = ", ") -> list[str]:
    lines: list[str] = []
    for word in words:
        if lines and text_size(longer := f"{lines[-1]}{between}{word}").width <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def scope_label(scope: Iterable[Variable], most: int | None = None) -> str:
    """Variables, on as many lines as a narrow shape needs; those beyond `most` are counted."""
    return _text(_hidden(scope, most), most)


def cluster_label(
    cluster: Cluster,
    observed: frozenset[Variable],
    counts: Mapping[Variable, int],
    most: int | None = None,
) -> str:
    """The variables of a cluster: hidden ones first, then the observed ones, a line a family.

    Where more than a few families have others alike, whose names differ by numbers alone, these
    share a line, as ``z1…z20[3] ×38``, which is 38 measurements of twenty sensors.

    observed: Those known to be observed, as variables or as templates for all steps.
    counts: Measurements of a sensor at a step: more than one are shown as ``z[3] ×4``; a sensor
        with none is left out, and so are the observed parents that it alone has in the cluster.
    most: Variables beyond this many are only counted, as ``+5``.
    """
    known = {v for v in cluster.scope if v in observed or v.template in observed}
    hidden = [v for v in cluster.scope if v not in known]
    left = {v: None for v in cluster.scope if v in known}  # a dict keeps the order
    observations = []
    for family in cluster.families:
        group = [v for v in family if v in left]
        if group and counts.get(family[0]) != 0:
            observations.append(group)
            for v in group:
                del left[v]
    mentioned = {v for family in cluster.families for v in family}
    rest = [v for v in left if v not in mentioned]
    lines = _hidden(hidden, most)
    kinds = _alike(observations)
    if sum(len(kind) for kind in kinds if len(kind) > 2) > _LISTED:
        lines += [
            [_several(list(dict.fromkeys(column)), counts) for column in zip(*kind, strict=True)]
            for kind in kinds
        ]
    else:
        lines += [[_counted(v, counts.get(v, 1)) for v in group] for group in observations]
    return _text([*lines, [_short(repr(v)) for v in rest]], most)


def _hidden(scope: Iterable[Variable], most: int | None) -> list[list[str]]:
    """Words for variables, in groups; many alike are one, as ``m1…m20[3]``, if none is left out."""
    found = []
    for group in _by_step(scope):
        runs = [list(run) for _, run in groupby(group, lambda v: _NUMBER.sub("#", repr(v)))]
        found.append(
            [
                word
                for run in runs
                for word in (
                    [_several(run, {})]
                    if most is None and len(run) > _NAMED
                    else [_short(repr(v)) for v in run]
                )
            ]
        )
    return found


def _alike(families: Iterable[Sequence[Variable]]) -> list[list[Sequence[Variable]]]:
    """Families by kind: those whose variables' names differ by numbers alone are of one."""
    found: dict[tuple[str, ...], list[Sequence[Variable]]] = defaultdict(list)
    for family in families:
        found[tuple(_NUMBER.sub("#", repr(v)) for v in family)].append(family)
    return list(found.values())


def _several(alike: Sequence[Variable], counts: Mapping[Variable, int]) -> str:
    """The first and the last of variables, how many where that does not say it, and readings."""
    total = sum(counts.get(v, 1) for v in alike)
    first, last = alike[0], alike[-1]
    if len(alike) <= 2:
        return ", ".join(_counted(v, counts.get(v, 1)) for v in alike)
    a, b = (_NUMBER.findall(v.name) for v in (first, last))
    text = f"{first.name}…{last!r}"
    if [int(y) - int(x) for x, y in zip(a, b, strict=True) if x != y] != [len(alike) - 1]:
        text = f"{len(alike)} of {text}"
    return text if total == len(alike) else f"{text} ×{total}"


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


def _short(name: str, width: float = _WIDEST) -> str:
    def cut(keep: int) -> str:
        return f"{name[: keep - keep // 3]}…{name[len(name) - keep // 3 :]}"

    if text_size(name).width <= width:
        return name
    # Halving, since names may have any length.
    longer = range(3, len(name))
    return cut(2 + bisect_right(longer, width, key=lambda keep: text_size(cut(keep)).width))
