"""The network of seven variables: its clusters, its messages, and every belief checked.

Clusters are numbered from 1, as in the figures of the 2018 report, so that δ₂,₃ is the message from
cluster 2 to cluster 3. For each case of evidence, summary.json has under ``cases``:

- ``messages``: ``"2,3": {scope, K, h, g}``, and mean, variance and log-weight where K > 0;
- ``marginals``: mean and variance by variable; ``log_evidence``;
- ``difference``: the largest from the dense joint, of marginals, beliefs, sepsets (the product of
  the two messages between neighbours) and log-evidence.

``largest_difference`` is that of all cases, ``equations`` that of messages from those by the
report's equations.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import typer
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.dense import Dense
from experiments.kinds import as_form, as_gaussian
from experiments.record import Out, Record
from experiments.seven_nodes.boundaries import draw_boundaries
from experiments.seven_nodes.messages import draw_messages
from experiments.seven_nodes.potentials import difference, initial_belief
from models.seven_nodes import c, e, g, seven_nodes_clusters

Evidence = Mapping[pgm.Variable, float]

# Messages that have a table of their own.
QUICK: dict[str, Any] = {}
CAPTIONS = {
    "network": "Figure 5.3: the network of seven variables.",
    "boundaries": (
        "Figure 5.4: the same network with a factor φ for each CPD, and the boundaries of four "
        "clusters, dashed."
    ),
    "cluster_graph": (
        "Figure 5.5: its cluster graph. Clusters are ellipses, with their initial beliefs ψ, the "
        "products of their factors; sepsets are rectangles; arrows are messages. Without evidence "
        "nothing comes back: δ₃,₂(b) = 1, and δ₂,₃(b) is the prior of b."
    ),
    "with_evidence": (
        "The same with evidence, by which the initial beliefs are reduced: messages go both ways. "
        "Each is a weight times a Gaussian of the mean and the variance shown."
    ),
}
SHOWN = {
    "2,3": "δ₂,₃(b), from {b, d, e} to {b, c, f}: exp(weight) N(b; mean, var.)",
    "3,4": "δ₃,₄(f), from {b, c, f} to {f, g}: exp(weight) N(f; mean, var.)",
}


def run(
    out: Out = None,
    value: Annotated[float, typer.Option(help="Of the evidence on c.")] = 1.0,
) -> None:
    """Seven variables in four clusters: messages with and without evidence, against the joint."""
    record = Record("seven_nodes", out, value=value)
    graph = seven_nodes_clusters()
    cases = {_name(evidence): solve(graph, evidence) for evidence in _cases(value)}
    worst = max(found for case in cases.values() for found in case["difference"].values())
    for key, title in SHOWN.items():
        record.table(
            title,
            ("evidence", "K", "h", "g", "mean", "var.", "weight"),
            [(name, *_figures(case["messages"][key])) for name, case in cases.items()],
            about="A line a set of evidence. K, h and g are the message's canonical form, "
            "exp(−½ K x² + h x + g); mean, var. and weight are the same message as a Gaussian.",
        )
    record.table(
        "initial beliefs ψ = exp(−½ xᵀK x + hᵀx + g), rows of K after one another",
        ("cluster", "x", "K", "h", "g"),
        [
            (
                f"ψ{c.index + 1}",
                ", ".join(map(repr, psi.scope)),
                *map(_listed, (psi.K, psi.h)),
                float(psi.g),
            )
            for c, psi in ((c, initial_belief(c)) for c in graph)
        ],
    )
    record.table(
        "largest difference from the dense joint",
        ("evidence", *next(iter(cases.values()))["difference"]),
        [(name, *case["difference"].values()) for name, case in cases.items()],
        about="Of a mean or covariance of a marginal, of a canonical form of a cluster's belief, "
        "of the product of both messages at a sepset, and of the log-evidence.",
    )
    record.note(f"largest difference of all: {worst:.2g}")
    equations = max(difference(graph, evidence) for evidence in _cases(value))
    record.note(f"largest difference of messages from equations 5.10 to 5.13: {equations:.2g}")
    for name, figure in figures(graph, value).items():
        record.figure(figure, name, CAPTIONS[name])
    record.summary(cases=cases, largest_difference=worst, equations=equations)


def solve(graph: pgm.ClusterGraph, evidence: Evidence) -> dict[str, Any]:
    """Messages, marginals and log-evidence, and how far they are from the dense joint."""
    posterior = pgm.infer(graph, evidence)
    dense = Dense.of(graph.network).given(evidence)
    marginals: dict[str, Any] = {}
    messages: dict[str, Any] = {}
    difference = dict.fromkeys(("marginals", "beliefs", "sepsets", "log_evidence"), 0.0)

    def compare(what: str, ours: Iterable[Any], due: Iterable[Any]) -> None:
        found = [np.abs(x - y).max() for x, y in zip(ours, due, strict=True)]
        difference[what] = max(difference[what], *map(float, found))

    for variable in graph.network.variables:
        if variable not in evidence:
            marginal = as_gaussian(posterior[variable])
            compare("marginals", (marginal.mean, marginal.cov), dense.marginal(variable))
            mean, variance = marginal.mean.item(), marginal.cov.item()
            marginals[variable.name] = {"mean": mean, "variance": variance}
    for cluster in graph:
        belief = as_form(posterior.belief(cluster))
        compare("beliefs", (belief.K, belief.h, belief.g), dense.form(*belief.scope))
    for i, j in graph.sepsets:
        there, back = as_form(posterior.message(i, j)), as_form(posterior.message(j, i))
        both = there * back
        compare("sepsets", (both.K, both.h, both.g), dense.form(*both.scope))
        messages |= {f"{i + 1},{j + 1}": _numbers(there), f"{j + 1},{i + 1}": _numbers(back)}
    compare("log_evidence", [posterior.log_evidence], [dense.log_evidence])
    return {
        "messages": messages,
        "marginals": marginals,
        "log_evidence": float(posterior.log_evidence),
        "difference": difference,
    }


def figures(graph: pgm.ClusterGraph, value: float) -> dict[str, Figure]:
    """The network, the boundaries of its clusters, and the cluster graph with its messages."""
    drawn = {}
    drawn["network"], ax = plt.subplots(figsize=(5, 4))
    pgm.plot.network(graph.network, ax=ax)
    drawn["boundaries"], ax = plt.subplots(figsize=(7.2, 3.6))
    draw_boundaries(graph, ax)
    last = _cases(value)[-1]
    for name, evidence in (("cluster_graph", {}), ("with_evidence", last)):
        drawn[name], ax = plt.subplots(figsize=(11, 1.9))
        draw_messages(graph, evidence, ax)
    for figure in drawn.values():
        plt.close(figure)
    return drawn


def _cases(value: float) -> tuple[Evidence, ...]:
    """The last sends evidence in both directions through every sepset."""
    return {}, {c: value}, {c: value, e: 0.3, g: 1.2}


def _name(evidence: Evidence) -> str:
    return ", ".join(f"{v!r}={value:g}" for v, value in evidence.items()) or "none"


def _numbers(message: pgm.CanonicalForm) -> dict[str, Any]:
    """A message over one scalar: C(x; K, h, g) = exp(log-weight) N(x; mean, variance)."""
    K = message.K.item()
    numbers: dict[str, Any] = {
        "scope": [variable.name for variable in message.scope],
        "K": K,
        "h": message.h.item(),
        "g": float(message.g),
    }
    if K > 1e-12:  # else nothing is known of x but rounding
        marginal = message.gaussian()
        numbers |= {
            "mean": marginal.mean.item(),
            "variance": marginal.cov.item(),
            "log_weight": float(message.log_integral),
        }
    return numbers


def _figures(message: dict[str, Any]) -> list[object]:
    """The columns of a message in its table, without what is only rounding."""
    keys = ("K", "h", "g", "mean", "variance", "log_weight")
    return [round(message[key], 12) + 0.0 if key in message else "–" for key in keys]


def _listed(array: npt.NDArray[np.float64]) -> str:
    """The numbers of a vector, or of a matrix row by row."""
    rows = np.atleast_2d(array)
    return "; ".join(" ".join(f"{value:.3g}" for value in row + 0.0) for row in rows)
