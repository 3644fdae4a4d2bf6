"""The page of a cluster graph without time, or of a balanced tree: factor by factor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.compile import BalancedGraph
from pgm.errors import GraphError, NumericalError
from pgm.factors import CanonicalForm, Gaussian, Table
from pgm.inference import Posterior
from pgm.inference.discrete.posterior import DiscretePosterior
from pgm.inference.gaussian.posterior import GaussianPosterior
from pgm.variables import Discrete, Variable
from pgm.viewer.limits import Limits, Run
from pgm.viewer.numbers import SHOWN, Numbers, lower
from pgm.viewer.placing import place
from pgm.viewer.words import cpd, listed, number, variable, went

# Of a table that is left out, so many of its largest entries are shown.
_LARGEST = 64
_Factor = CanonicalForm | Table | Gaussian


def page(
    posterior: Posterior, numbers: Numbers, runs: list[Run], limits: Limits, found: dict[str, Any]
) -> dict[str, Any]:
    """The structure of the page, added to what is given, its numbers to those given."""
    graph = posterior.graph
    shown, note = _shown(graph, limits)
    within = {k: at for at, k in enumerate(shown)}
    edges = [
        (i, j) for i in shown for j in graph.neighbours(i) if i < j and j in within
    ]
    clusters = [graph.clusters[k] for k in shown]
    writer = _Writer(posterior, numbers, runs, limits)
    lead = np.asarray(posterior.log_evidence).shape
    found |= {
        "family": "table" if isinstance(clusters[0].scope[0], Discrete) else "gaussian",
        "variables": writer.variables,
        "clusters": [],
        "edges": [],
        "runs": [
            {
                "run": list(run),
                "log_evidence": number(float(np.asarray(posterior.log_evidence)[run])),
                "went": went(posterior.status, _flat(run, lead)),
                "edges": _residuals(posterior, numbers, edges, run),
            }
            for run in runs
        ],
    }
    values = [_evidence(posterior, _flat(run, lead)) for run in runs]
    for cluster in clusters:
        k = cluster.index
        belief = writer.belief(cluster)
        hidden = writer.scopes[k]
        found["clusters"].append(
            {
                "index": k,
                "scope": writer.names(hidden),
                "observed": [_given(v, values) for v in cluster.scope if v not in hidden],
                "cpds": [cpd(c, f) for c, f in zip(cluster.cpds, cluster.families, strict=True)],
                "belief": belief,
                "potential": writer.factors(lambda k=k: posterior.potential(k), hidden),
                "cut": [j for j in graph.neighbours(k) if j not in within],
            }
        )
    for i, j in edges:
        scope = [v for v in graph.sepsets[i, j] if v in writer.scopes[i]]
        found["edges"].append(
            {
                "ends": [i, j],
                "scope": writer.names(scope),
                "there": writer.factors(lambda i=i, j=j: posterior.message(i, j), scope),
                "back": writer.factors(lambda i=i, j=j: posterior.message(j, i), scope),
            }
        )
    found["places"] = place([c["index"] for c in found["clusters"]], edges, _widths(found), graph)
    found["cut"] = note
    return found


def _flat(run: Run, lead: tuple[int, ...]) -> int:
    return int(np.ravel_multi_index(run, lead)) if lead else 0


def _given(observed: Variable, values: list[dict[Variable, str]]) -> list[Any]:
    """A variable that has evidence, and its value in each run, where the posterior holds it."""
    return [repr(observed), [each.get(observed) for each in values]]


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


def _shown(graph: ClusterGraph, limits: Limits) -> tuple[list[int], str | None]:
    """The clusters of a page: all, or the first that are met from the root or from cluster 0."""
    total = len(graph)
    if total <= limits.clusters:
        return list(range(total)), None
    start = graph.root if isinstance(graph, BalancedGraph) else 0
    seen, waiting = {start: None}, [start]
    for k in waiting:
        for j in graph.neighbours(k):
            if j not in seen and len(seen) < limits.clusters:
                seen[j] = None
                waiting.append(j)
    note = f"{len(seen):,} of {total:,} clusters are shown, the nearest to cluster {start}"
    return sorted(seen), note


def _residuals(
    posterior: Posterior, numbers: Numbers, edges: list[tuple[int, int]], run: Run
) -> dict[str, Any] | None:
    """The change along each edge: in each iteration, where that was kept, and left at the end."""
    status = posterior.status
    if not status.by_edge:
        return None
    left = [number(float(np.asarray(status.by_edge[edge])[run])) for edge in edges]
    each = status.edge_residuals
    if each is None:
        return {"left": left, "each": None}
    order = {edge: k for k, edge in enumerate(posterior.graph.sepsets)}
    rows = [order[edge] for edge in edges]
    return {"left": left, "each": numbers.add(each[(slice(None), rows, *run)], SHOWN)}


def _widths(found: dict[str, Any]) -> dict[Any, int]:
    """The letters that each cluster's and each sepset's label takes."""
    names = [v["name"] for v in found["variables"]]
    widths: dict[Any, int] = {}
    for each in found["clusters"]:
        widths[each["index"]] = _room(_label([names[k] for k in each["scope"]]))
    for each in found["edges"]:
        widths[tuple(each["ends"])] = _room(_label([names[k] for k in each["scope"]]))
    return widths


def _room(text: str) -> int:
    """The letters of a text, capitals counted as wider."""
    return round(sum(1.25 if letter.isupper() else 1.0 for letter in text))


def _label(names: list[str], most: int = 26) -> str:
    """The first names that fit, and how many others there are: as the page writes them."""
    text = ", ".join(names)
    shown = len(names)
    while len(text) > most and shown > 1:
        shown -= 1
        text = ", ".join(names[:shown]) + f" +{len(names) - shown}"
    return text if len(text) <= most else text[: most - 1] + "…"


class _Writer:
    """The factors of a posterior, written into the numbers of a page run by run."""

    def __init__(
        self, posterior: Posterior, numbers: Numbers, runs: list[Run], limits: Limits
    ) -> None:
        self.posterior, self.numbers, self.runs, self.limits = posterior, numbers, runs, limits
        self.variables: list[dict[str, Any]] = []
        self.scopes: dict[int, tuple[Variable, ...]] = {}
        self._places: dict[Variable, int] = {}

    def names(self, scope: Any) -> list[int]:
        """The variables of a scope, by their place in the page's list."""
        for each in scope:
            if each not in self._places:
                self._places[each] = len(self.variables)
                self.variables.append(variable(each))
        return [self._places[each] for each in scope]

    def factors(self, make: Callable[[], _Factor], scope: Any) -> list[dict[str, Any]]:
        """A factor in each run, or why there is none."""
        try:
            factor = make()
        except (NumericalError, GraphError) as error:
            return [{"form": "none", "why": str(error)} for _ in self.runs]
        if isinstance(factor, CanonicalForm):
            factor = factor.rearrange(tuple(scope))
        return [self._written(factor, run) for run in self.runs]

    def belief(self, cluster: Cluster) -> list[dict[str, Any]]:
        """The belief of a cluster in each run: moments, or a table where the page has no other."""
        k, posterior = cluster.index, self.posterior
        try:
            belief: Any = posterior.belief(k)
            self.scopes[k], why = belief.scope, None
        except NumericalError as error:
            belief, why = None, str(error)
            self.scopes[k] = _hidden(posterior, cluster)
        if isinstance(belief, Table):
            return [self._written(belief, run) for run in self.runs]
        if not self.scopes[k]:
            return [{"form": "none", "why": "all its variables are observed"} for _ in self.runs]
        try:
            gaussian = posterior.joint(*self.scopes[k])
        except (GraphError, NumericalError) as error:
            return [{"form": "none", "why": str(error)} for _ in self.runs]
        return [self._written(gaussian, run) | {"why": why} for run in self.runs]

    def _written(self, factor: Any, run: Run) -> dict[str, Any]:
        if isinstance(factor, Table):
            return self._table(factor, run)
        if isinstance(factor, Gaussian):
            parts = [factor.mean[run], lower(factor.cov[run])]
            return {"form": "moments", "at": self.numbers.flat(np.concatenate(parts))}
        run = run if factor.g.ndim else ()
        parts = [lower(factor.K[run]), factor.h[run], np.atleast_1d(factor.g[run])]
        return {"form": "canonical", "at": self.numbers.flat(np.concatenate(parts))}

    def _table(self, table: Table, run: Run) -> dict[str, Any]:
        run = run if table.log_scale.ndim else ()
        values, scale = table.values[run], np.atleast_1d(table.log_scale[run])
        found: dict[str, Any] = {"scope": self.names(table.scope)}
        full = self.numbers.count > self.limits.numbers
        if values.size <= (_LARGEST if full else self.limits.entries):
            at = self.numbers.flat(np.concatenate([values.reshape(-1), scale]))
            return found | {"form": "table", "at": at}
        flat = values.reshape(-1)
        top = np.argpartition(flat, -_LARGEST)[-_LARGEST:]
        top = top[np.argsort(-flat[top], kind="stable")]
        axes = range(values.ndim)
        sums = [values.sum(axis=tuple(a for a in axes if a != axis)) for axis in axes]
        parts = [top.astype(float), flat[top], scale, *sums]
        at = self.numbers.flat(np.concatenate(parts))
        return found | {"form": "largest", "at": at, "count": _LARGEST, "entries": flat.size}


def _hidden(posterior: Posterior, cluster: Cluster) -> tuple[Variable, ...]:
    """The variables of a cluster that have a marginal."""
    layout: Any = posterior._plan.layout if hasattr(posterior, "_plan") else None  # type: ignore[attr-defined]
    scopes = getattr(layout, "scopes", None)
    if scopes is not None:
        found: tuple[Variable, ...] = scopes[cluster.index]
        return found
    graph: Any = posterior.graph
    hidden = set(graph.layout.slice)
    return tuple(v for v in cluster.scope if v.template in hidden)
