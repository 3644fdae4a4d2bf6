"""The page of a cluster graph without time, or of a balanced tree: cluster by cluster."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.clustergraph.checks import Edge
from pgm.compile import BalancedGraph
from pgm.inference import Posterior
from pgm.inference.discrete.posterior import DiscretePosterior
from pgm.inference.gaussian.posterior import GaussianPosterior
from pgm.variables import Variable
from pgm.viewer.factors import Writer
from pgm.viewer.limits import Limits, Run
from pgm.viewer.numbers import SHOWN, Numbers
from pgm.viewer.placing import place
from pgm.viewer.words import cpd, listed, number, went

# Letters of a label: names that do not fit are counted.
_MOST = 26


def page(posterior: Posterior, numbers: Numbers, runs: list[Run], limits: Limits) -> dict[str, Any]:
    """The structure of the page, its numbers added to those given."""
    graph, writer = posterior.graph, Writer(posterior, numbers, runs, limits)
    shown, note = _shown(graph, limits)
    within = set(shown)
    log_evidence = np.asarray(posterior.log_evidence)
    flat = [int(np.ravel_multi_index(run, log_evidence.shape)) if run else 0 for run in runs]
    values = [_evidence(posterior, at) for at in flat]
    clusters = []
    for k in shown:
        cut = [j for j in graph.neighbours(k) if j not in within]
        clusters.append(_cluster(writer, graph.clusters[k], values) | {"cut": cut})
    edges = [(i, j) for i in shown for j in graph.neighbours(i) if i < j and j in within]
    joined = [_edge(writer, edge) for edge in edges]
    letters: dict[Any, int] = {c["index"]: _letters(writer, c["scope"]) for c in clusters}
    letters |= {
        edge: _letters(writer, each["scope"]) for edge, each in zip(edges, joined, strict=True)
    }
    return {
        "kind": "graph",
        "variables": writer.variables,
        "clusters": clusters,
        "edges": joined,
        "places": place(shown, edges, letters, graph),
        "cut": note,
        "runs": [
            {
                "run": list(run),
                "log_evidence": number(float(log_evidence[run])),
                "went": went(posterior.status, at),
                "edges": _residuals(posterior, numbers, edges, at),
            }
            for run, at in zip(runs, flat, strict=True)
        ],
    }


def _cluster(writer: Writer, cluster: Cluster, values: list[dict[Variable, str]]) -> dict[str, Any]:
    belief = writer.belief(cluster)
    hidden = writer.scopes[cluster.index]
    families = zip(cluster.cpds, cluster.families, strict=True)
    return {
        "index": cluster.index,
        "scope": writer.names(hidden),
        "observed": [
            # Its value in each run, where the posterior holds it.
            [repr(v), [each.get(v) for each in values]]
            for v in cluster.scope
            if v not in hidden
        ],
        "cpds": [cpd(each, family) for each, family in families],
        "belief": belief,
        "potential": writer.factors(writer.posterior.potential, cluster.index, scope=hidden),
    }


def _edge(writer: Writer, edge: Edge) -> dict[str, Any]:
    i, j = edge
    message = writer.posterior.message
    sepset = writer.posterior.graph.sepsets[edge]
    scope = tuple(v for v in sepset if v in writer.scopes[i])
    return {
        "ends": [i, j],
        "scope": writer.names(scope),
        "there": writer.factors(message, i, j, scope=scope),
        "back": writer.factors(message, j, i, scope=scope),
    }


def _shown(graph: ClusterGraph, limits: Limits) -> tuple[list[int], str | None]:
    """The clusters of a page: all, or the first that are met from the root or from cluster 0."""
    total = len(graph)
    if total <= limits.clusters:
        return list(range(total)), None
    start = graph.root if isinstance(graph, BalancedGraph) else 0
    seen, waiting = {start}, [start]
    for k in waiting:
        for j in graph.neighbours(k):
            if j not in seen and len(seen) < limits.clusters:
                seen.add(j)
                waiting.append(j)
    note = f"{len(seen):,} of {total:,} clusters are shown, the nearest to cluster {start}"
    return sorted(seen), note


def _evidence(posterior: Posterior, run: int) -> dict[Variable, str]:
    """The values of observed variables in a run, in words."""
    found: dict[Variable, str] = {}
    if isinstance(posterior, GaussianPosterior):
        model = posterior._model
        for group, rows in zip(model.layout.groups, model.readings, strict=True):
            if rows is not None:
                own = rows[:, run if rows.shape[1] > 1 else 0]
                found |= {c.child: listed(row) for c, row in zip(group.cpds, own, strict=True)}
    elif isinstance(posterior, DiscretePosterior):
        for v, states in posterior._beliefs.evidence.states.items():
            each = np.reshape(states, -1)
            state = int(each[run if each.size > 1 else 0])
            found[v] = v.states[state] if state >= 0 else "not observed"
    return found


def _residuals(
    posterior: Posterior, numbers: Numbers, edges: list[Edge], place: int
) -> dict[str, Any] | None:
    """The change along each edge: in each iteration, where that was kept, and left at the end."""
    status = posterior.status
    if not status.by_edge:
        return None
    left = [number(float(np.reshape(status.by_edge[edge], -1)[place])) for edge in edges]
    each = status.edge_residuals
    if each is None:
        return {"left": left, "each": None}
    order = {edge: k for k, edge in enumerate(posterior.graph.sepsets)}
    flat = each.reshape(*each.shape[:2], -1)[..., place]
    own = flat[:, [order[edge] for edge in edges]]
    return {"left": left, "each": numbers.add(own, SHOWN)}


def _letters(writer: Writer, scope: list[int]) -> int:
    """About how many letters wide the label of a scope is; capitals are wider."""
    names = [writer.variables[k]["name"] for k in scope]
    text, count = ", ".join(names), len(names)
    while len(text) > _MOST and count > 1:
        count -= 1
        text = f"{', '.join(names[:count])} +{len(names) - count}"
    return round(sum(1.25 if letter.isupper() else 1.0 for letter in text[:_MOST]))
