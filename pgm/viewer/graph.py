"""The page of a cluster graph without time, or of a balanced tree: cluster by cluster."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.clustergraph.cluster import Edge
from pgm.compile import BalancedGraph
from pgm.errors import GraphError, NumericalError
from pgm.factors import CanonicalForm, Gaussian, GaussianMixture, Table
from pgm.factors.scope import Scope
from pgm.inference import CliqueTree
from pgm.kernels.arrays import Array
from pgm.posteriors.shown_slices import GAUSSIANS
from pgm.variables import Variable
from pgm.viewer.moved import moved
from pgm.viewer.numbers import (
    SHOWN,
    Limits,
    Numbers,
    Run,
    factor,
    listed,
    lower,
    number,
    variable,
    went,
)
from pgm.viewer.placing import place

# Letters of a label: names that do not fit are counted.
_MOST = 26


def page(
    posterior: Any,
    numbers: Numbers,
    runs: list[Run],
    limits: Limits,
    truth: Mapping[Variable, Array],
) -> dict[str, Any]:
    """The structure of the page, its numbers added; `truth` as `truths` makes it."""
    graph, writer = posterior.graph, Writer(posterior, numbers, runs, limits)
    shown, note = _shown(graph, limits)
    log_evidence = np.asarray(posterior.log_evidence)
    flat = [int(np.ravel_multi_index(run, log_evidence.shape)) if run else 0 for run in runs]
    found = drawn(writer, graph, shown, [posterior.entered(at) for at in flat])
    edges = [tuple(edge["ends"]) for edge in found["edges"]]
    changes = moved(posterior, writer.places) if limits.moved else {}
    return found | {
        "cut": note,
        "runs": [
            {
                "run": list(run),
                "log_evidence": number(float(log_evidence[run])),
                "went": went(posterior.status, at),
                "edges": _residuals(posterior, numbers, edges, at),
                "moved": {
                    repr(v): float(value)
                    for v, each in changes.items()
                    if np.isfinite(value := np.broadcast_to(each, log_evidence.shape)[run])
                },
                "truth": _true(writer, truth, run),
            }
            for run, at in zip(runs, flat, strict=True)
        ],
    }


def drawn(
    writer: Writer,
    graph: ClusterGraph | CliqueTree,
    shown: Sequence[int],
    entered: Sequence[Mapping[Variable, Any]],
) -> dict[str, Any]:
    """The clusters that are shown, the edges between them, and where they stand.

    `entered` has the evidence of each run.
    """
    within = set(shown)
    values = [{variable: _told(value) for variable, value in each.items()} for each in entered]
    clusters = []
    for k in shown:
        cut = [j for j in graph.neighbours(k) if j not in within]
        clusters.append(_cluster(writer, graph.clusters[k], values) | {"cut": cut})
    edges = [(i, j) for i in shown for j in graph.neighbours(i) if i < j and j in within]
    joined = [_edge(writer, graph.sepsets[edge], edge) for edge in edges]
    letters: dict[Any, int] = {c["index"]: _letters(writer, c["scope"]) for c in clusters}
    letters |= {
        edge: _letters(writer, each["scope"]) for edge, each in zip(edges, joined, strict=True)
    }
    return {
        "kind": "graph",
        "variables": writer.variables,
        "clusters": clusters,
        "edges": joined,
        "words": {}
        if hasattr(writer.posterior, "message")
        else {"messages": writer.posterior.silent},
        "places": place(shown, edges, letters, graph),
    }


def _cluster(writer: Writer, cluster: Cluster, values: list[dict[Variable, str]]) -> dict[str, Any]:
    belief = writer.belief(cluster)
    hidden = writer.scopes[cluster.index]
    families = zip(cluster.factors, cluster.families, strict=True)
    return {
        "index": cluster.index,
        "scope": writer.names(hidden),
        "observed": [
            # Its value in each run, where the posterior holds it.
            [repr(v), [each.get(v) for each in values]]
            for v in cluster.scope
            if v not in hidden
        ],
        "cpds": [factor(each, family) for each, family in families],
        "belief": belief,
        "potential": writer.factors("potential", cluster.index, scope=hidden),
    }


def _edge(writer: Writer, sepset: Scope, edge: Edge) -> dict[str, Any]:
    i, j = edge
    scope = tuple(v for v in sepset if v in writer.scopes[i])
    return {
        "ends": [i, j],
        "scope": writer.names(scope),
        "there": writer.factors("message", i, j, scope=scope),
        "back": writer.factors("message", j, i, scope=scope),
    }


def _shown(graph: ClusterGraph, limits: Limits) -> tuple[list[int], str | None]:
    """The clusters on a page: all, or the first found from the root or from cluster 0."""
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


def _true(writer: Writer, truth: Mapping[Variable, Array], run: Run) -> dict[str, Any]:
    """The true values of variables on a page in one run, by name; x[3] is one of those of x."""
    found = {}
    for v in writer.places:
        if v in truth:
            found[repr(v)] = truth[v][run]
        elif v.step is not None and v.template in truth:
            own = truth[v.template][run]
            found[repr(v)] = own[v.step - (writer.posterior.graph.steps + 1 - len(own))]
    return {name: [number(value) for value in values] for name, values in found.items()}


def _told(value: Any) -> str:
    """The evidence of a variable, as text."""
    if value is None:
        return "not observed"
    return value if isinstance(value, str) else listed(value)


def _residuals(
    posterior: Any, numbers: Numbers, edges: list[Edge], place: int
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


# Of a table that is left out, so many of its largest entries are shown.
_LARGEST = 64
Factor = CanonicalForm | Table | Gaussian


class Writer:
    """The factors of a posterior in the numbers of a page, and the variables that they are over.

    variables: Those met so far, as the page names them.
    places: Where each of them stands among these.
    scopes: The variables without evidence of each cluster whose belief was written.
    """

    def __init__(self, posterior: Any, numbers: Numbers, runs: list[Run], limits: Limits) -> None:
        self.posterior, self.numbers, self.runs, self.limits = posterior, numbers, runs, limits
        self.variables: list[dict[str, Any]] = []
        self.scopes: dict[int, Scope] = {}
        self.places: dict[Variable, int] = {}

    def names(self, scope: Iterable[Variable]) -> list[int]:
        """The variables of a scope, by their place in the page's list."""
        found = []
        for each in scope:
            if each not in self.places:
                self.places[each] = len(self.variables)
                self.variables.append(variable(each))
            found.append(self.places[each])
        return found

    def factors(self, name: str, *of: int, scope: Scope) -> list[dict[str, Any]]:
        """A potential or message in each run, in the order of a scope, or why there is none."""
        if (make := getattr(self.posterior, name, None)) is None:
            return self._absent(str(self.posterior.refusal(name)))
        try:
            factor = make(*of)
        except (NumericalError, GraphError) as error:
            return self._absent(str(error))
        if isinstance(factor, CanonicalForm):
            factor = factor.rearrange(scope)
        return [self._written(factor, run) for run in self.runs]

    def belief(self, cluster: Cluster) -> list[dict[str, Any]]:
        """The belief of a cluster in each run: a table or moments, which singular ones have too."""
        k, posterior = cluster.index, self.posterior
        belief, why = None, None
        try:
            belief = posterior.belief(k)
        except (GraphError, NumericalError) as error:
            why = str(error)
        self.scopes[k] = scope = posterior.scope(cluster) if belief is None else belief.scope
        if isinstance(belief, Table):
            return [self._written(belief, run) for run in self.runs]
        if isinstance(belief, GaussianMixture):
            return [self._mixture(belief, run) for run in self.runs]
        if not scope:
            return self._absent("all its variables are observed")
        try:
            gaussian = posterior.joint(*scope)
        except (GraphError, NumericalError) as error:
            return self._absent(str(error))
        return [self._written(gaussian, run) | {"why": why} for run in self.runs]

    def _absent(self, why: str) -> list[dict[str, Any]]:
        return [{"form": "none", "why": why} for _ in self.runs]

    def _written(self, factor: Factor, run: Run) -> dict[str, Any]:
        if isinstance(factor, Table):
            return self._table(factor, run)
        if isinstance(factor, Gaussian):
            return self._moments(factor.mean[run], factor.cov[run])
        form = lower(factor.K[run]), factor.h[run], np.atleast_1d(factor.g[run])
        return {"form": "canonical", "at": self.numbers.flat(np.concatenate(form))}

    def _mixture(self, mixture: GaussianMixture, run: Run) -> dict[str, Any]:
        """The moments of a mixture, and its heaviest Gaussians."""
        weights = mixture.weights[run]
        heaviest = np.argsort(-weights, kind="stable")[:GAUSSIANS]
        each = [
            {"weight": float(weights[k])} | self._written(mixture.components, (*run, k))
            for k in heaviest[weights[heaviest] > 0.0].tolist()
        ]
        return self._moments(mixture.mean[run], mixture.cov[run]) | {"gaussians": each}

    def _moments(self, mean: Array, cov: Array) -> dict[str, Any]:
        at = self.numbers.flat(np.concatenate([mean, lower(cov)]))
        return {"form": "moments", "at": at}

    def _table(self, table: Table, run: Run) -> dict[str, Any]:
        run = run if table.log_scale.ndim else ()
        values, scale = table.values[run], np.atleast_1d(table.log_scale[run])
        found: dict[str, Any] = {"scope": self.names(table.scope)}
        flat = values.reshape(-1)
        full = self.numbers.count > self.limits.numbers
        if flat.size <= (_LARGEST if full else self.limits.entries):
            return found | {"form": "table", "at": self.numbers.flat(np.append(flat, scale))}
        top = np.argpartition(flat, -_LARGEST)[-_LARGEST:]
        top = top[np.argsort(-flat[top], kind="stable")]
        axes = range(values.ndim)
        sums = [values.sum(axis=tuple(a for a in axes if a != axis)) for axis in axes]
        at = self.numbers.flat(np.concatenate([top.astype(float), flat[top], scale, *sums]))
        return found | {"form": "largest", "at": at, "count": _LARGEST, "entries": flat.size}
