"""Ways to compile a network, compared: what they make, how near it comes, how long it takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any

import numpy as np

import pgm
from experiments.belief_propagation.loops import Numbers
from experiments.kinds import as_gaussian, as_table
from experiments.unsettled import unsettled
from pgm.clustergraph.cluster import size
from pgm.compile import Method

Beliefs = Mapping[pgm.Variable, Any]

EXACT = "junction tree"
# Clusters of join graphs take so many binary variables, or components, more than any family.
ROOMS = (0, 2, 4)
SCHEDULE = pgm.Sequential(iterations=300)


def methods(network: pgm.BayesianNetwork) -> dict[str, Method]:
    """By name; the junction tree is the first."""
    family = max(size(cpd.scope) for cpd in network.cpds)
    found: dict[str, Method] = {
        EXACT: pgm.JunctionTree(),
        "Bethe": pgm.Bethe(),
        "LTRIP": pgm.LTRIP(),
    }
    for room in ROOMS:
        if network.discrete:
            found[f"join graph ×{2**room}"] = pgm.JoinGraph(family * 2**room)
        else:
            found[f"join graph +{room}"] = pgm.JoinGraph(family + room)
    return found


@unsettled()
def compare(network: pgm.BayesianNetwork, evidence: Beliefs) -> dict[str, Numbers]:
    """Numbers of each way to compile a network, against its junction tree."""
    hidden = [v for v in network.variables if v not in evidence]
    found: dict[str, Numbers] = {}
    exact: Beliefs = {}
    due = 0.0
    for name, method in methods(network).items():
        start = perf_counter()
        graph = pgm.compile(network, method=method)
        schedule = pgm.Calibration() if graph.is_tree else SCHEDULE
        posterior = pgm.infer(graph, evidence, schedule=schedule)
        beliefs = {v: posterior[v] for v in hidden}
        seconds = perf_counter() - start
        if name == EXACT:
            exact, due = beliefs, float(posterior.log_evidence)
        errors = _probabilities if network.discrete else _moments
        found[name] = {
            "clusters": len(graph),
            "sepsets": len(graph.sepsets),
            "largest": max(graph.sizes),
            **errors(beliefs, exact),
            "log_evidence_error": abs(float(posterior.log_evidence) - due),
            "iterations": posterior.status.iterations,
            "converged": bool(posterior.status.converged),
            "seconds": seconds,
        }
    return found


def averaged(draws: Sequence[Mapping[str, Numbers]]) -> dict[str, Numbers]:
    """Means over networks; of what is ``..._max``, and of the largest cluster, the largest."""
    return {
        name: {
            key: (max if key == "largest" or key.endswith("_max") else np.mean)(
                [draw[name][key] for draw in draws]
            )
            for key in draws[0][name]
        }
        for name in draws[0]
    }


def _probabilities(ours: Beliefs, exact: Beliefs) -> Numbers:
    """Largest errors of a probability in the marginals: their mean, and the largest."""
    errors = [
        np.abs(as_table(ours[v]).probabilities - as_table(due).probabilities).max()
        for v, due in exact.items()
    ]
    return {"error_mean": float(np.mean(errors)), "error_max": float(np.max(errors))}


def _moments(ours: Beliefs, exact: Beliefs) -> Numbers:
    """Errors of means, in exact standard deviations, and relative errors of variances."""
    pairs = [(as_gaussian(ours[v]), as_gaussian(due)) for v, due in exact.items()]
    means = np.concatenate([np.abs(a.mean - b.mean) / b.std for a, b in pairs])
    variances = np.concatenate([np.abs((a.std / b.std) ** 2 - 1.0) for a, b in pairs])
    return {
        "mean_error_max": float(means.max()),
        "variance_error_mean": float(variances.mean()),
        "variance_error_max": float(variances.max()),
    }
