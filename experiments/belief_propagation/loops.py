"""Exact inference on a junction tree against messages on graphs with loops."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import pgm
from experiments.kinds import as_gaussian, as_table
from experiments.unsettled import unsettled
from pgm.compile import Method

Numbers = dict[str, Any]

SCHEDULES: dict[str, pgm.Flooding | pgm.Sequential | pgm.Residual] = {
    "flooding": pgm.Flooding(),
    "sequential": pgm.Sequential(),
    "residual": pgm.Residual(),
}
METHODS: dict[str, Method] = {"bethe": pgm.Bethe(), "ltrip": pgm.LTRIP()}
RELINEARISED = pgm.Calibration(iterations=100, tolerance=1e-10)


def titled(graph: str) -> str:
    """The name of a graph for tables and figures."""
    return type(METHODS[graph]).__name__ if graph in METHODS else graph.replace("_", " ")


@dataclass(frozen=True, eq=False)
class Case:
    """A network with evidence, its exact posterior, and graphs with loops.

    Attributes
    ----------
    evidence : mapping of Variable
    exact : Posterior
        On the junction tree; relinearised to convergence where CPDs are nonlinear.
    graphs : mapping of str to ClusterGraph
    """

    evidence: Mapping[pgm.Variable, Any]
    exact: pgm.results.Posterior
    graphs: Mapping[str, pgm.ClusterGraph]

    @classmethod
    def of(
        cls,
        network: pgm.BayesianNetwork,
        evidence: Mapping[pgm.Variable, Any],
        **graphs: pgm.ClusterGraph,
    ) -> Case:
        """Infer exactly; the graphs that methods make are the first of the graphs."""
        exact = pgm.infer(pgm.compile(network), evidence, schedule=RELINEARISED)
        compiled = {name: pgm.compile(network, method=method) for name, method in METHODS.items()}
        return cls(evidence, exact, {**compiled, **graphs})

    @property
    def network(self) -> pgm.BayesianNetwork:
        """The network of all graphs."""
        network: pgm.BayesianNetwork = self.exact.graph.network
        return network

    @property
    def hidden(self) -> list[pgm.Variable]:
        """The variables without evidence."""
        return [v for v in self.network.variables if v not in self.evidence]

    @unsettled()
    def send(self, graph: str, schedule: Any) -> pgm.results.Posterior:
        """The posterior on one of the graphs."""
        return pgm.infer(self.graphs[graph], self.evidence, schedule=schedule)

    def errors(self, posterior: pgm.results.Posterior) -> Numbers:
        """How far beliefs are from the exact ones, and how the schedule went."""
        status = posterior.status
        compare = _probabilities if self.network.discrete else _moments
        return {
            **compare(posterior, self.exact, self.hidden),
            "log_evidence": float(posterior.log_evidence),
            "log_evidence_kind": posterior.log_evidence_kind,
            "iterations": status.iterations,
            "converged": bool(status.converged),
        }

    def posteriors(self) -> dict[str, dict[str, pgm.results.Posterior]]:
        """By graph and schedule."""
        return {
            graph: {name: self.send(graph, schedule) for name, schedule in SCHEDULES.items()}
            for graph in self.graphs
        }


def _probabilities(
    posterior: pgm.results.Posterior, exact: pgm.results.Posterior, hidden: Sequence[pgm.Variable]
) -> Numbers:
    """The largest error of a probability in a marginal, and all marginals."""
    ours = {v: as_table(posterior[v]).probabilities for v in hidden}
    due = {v: as_table(exact[v]).probabilities for v in hidden}
    return {
        "error": max(float(np.abs(ours[v] - due[v]).max()) for v in hidden),
        "marginals": {v.name: ours[v].tolist() for v in hidden},
    }


def _moments(
    posterior: pgm.results.Posterior, exact: pgm.results.Posterior, hidden: Sequence[pgm.Variable]
) -> Numbers:
    """The largest error of a mean, in exact standard deviations, and the ratios of those."""
    ours = [as_gaussian(posterior[v]) for v in hidden]
    due = [as_gaussian(exact[v]) for v in hidden]
    pairs = list(zip(ours, due, strict=True))
    ratios = np.concatenate([a.std / b.std for a, b in pairs])
    return {
        "mean_error": max(float(np.abs((a.mean - b.mean) / b.std).max()) for a, b in pairs),
        "std_ratio_min": float(ratios.min()),
        "std_ratio_max": float(ratios.max()),
    }


def sweep(
    make: Callable[[float], tuple[pgm.BayesianNetwork, Mapping[pgm.Variable, Any]]],
    couplings: Sequence[float],
    schedules: Mapping[str, Any],
) -> dict[str, list[Numbers]]:
    """Errors on the Bethe graph by schedule, one for each strength of coupling."""
    cases = [Case.of(*make(coupling)) for coupling in couplings]
    return {
        name: [case.errors(case.send("bethe", schedule)) for case in cases]
        for name, schedule in schedules.items()
    }
