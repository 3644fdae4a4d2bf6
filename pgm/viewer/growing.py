"""The page of a growing map: its tree of cliques, and what the last addition touched of it."""

from __future__ import annotations

from typing import Any

from pgm.factors.scope import Scope
from pgm.inference import CliqueTree, GrowingMap
from pgm.viewer.graph import Writer, drawn
from pgm.viewer.numbers import Limits, Numbers, Run

ONE_RUN: list[Run] = [()]


def page(grown: GrowingMap, numbers: Numbers, limits: Limits) -> dict[str, Any]:
    """The structure of the page, its numbers added."""
    tree = grown.cliques
    count = min(len(tree), limits.clusters)
    writer = Writer(tree, numbers, ONE_RUN, limits)
    found = drawn(writer, tree, range(count), [tree.entered()])
    for cluster in found["clusters"]:
        k = cluster["index"]
        cluster["touched"] = k in tree.touched
        cluster["pivots"] = writer.names(tree.pivots[k])
    anew = {repr(variable) for variable in grown.relinearised}
    for variable in found["variables"]:
        variable["anew"] = variable["name"] in anew
    return found | {
        "cut": _cut(tree, count),
        "runs": [
            {"run": [], "log_evidence": None, "went": None, "edges": None, "moved": {}, "truth": {}}
        ],
        "touched": {"cliques": len(tree.touched), "anew": _named(grown.relinearised)},
    }


def _named(variables: Scope) -> list[str]:
    return [repr(variable) for variable in variables]


def _cut(tree: CliqueTree, count: int) -> str | None:
    if count == len(tree):
        return None
    return (
        f"{count:,} of {len(tree):,} cliques are shown: those that the last addition touched, and "
        "then the nearest to a root"
    )
