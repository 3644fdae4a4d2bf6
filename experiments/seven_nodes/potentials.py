"""The initial beliefs of clusters in numbers, and the messages that follow from them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from operator import mul

import numpy as np

import pgm
from experiments.kinds import as_form
from pgm.cpds import CPD

Evidence = Mapping[pgm.Variable, float]


def initial_belief(cluster: pgm.results.Cluster) -> pgm.CanonicalForm:
    """ψ, the product of a cluster's factors, over its scope (equation 5.9)."""
    return reduce(mul, map(_factor, cluster.cpds)).extend(cluster.scope)


def message(
    posterior: pgm.results.Posterior, source: int, target: int, evidence: Evidence
) -> pgm.CanonicalForm:
    """δ from ψ and the messages that come from the other neighbours (equations 5.10 to 5.13)."""
    graph = posterior.graph
    cluster = graph.clusters[source]
    known = {v: value for v, value in evidence.items() if v in cluster.scope}
    product = initial_belief(cluster).reduce(known)
    for other in graph.neighbours(source):
        if other != target:
            product = as_form(posterior.message(other, source)) * product
    return product.marginal(*graph.sepsets[min(source, target), max(source, target)])


def difference(graph: pgm.ClusterGraph, evidence: Evidence) -> float:
    """The largest between the engine's messages and those by the equations."""
    posterior = pgm.infer(graph, evidence)
    found = 0.0
    for edge in graph.sepsets:
        for source, target in (edge, edge[::-1]):
            ours = as_form(posterior.message(source, target))
            theirs = message(posterior, source, target, evidence)
            parts = ((ours.K, theirs.K), (ours.h, theirs.h), (ours.g, theirs.g))
            found = max(found, *(float(np.abs(a - b).max()) for a, b in parts))
    return found


def _factor(cpd: CPD) -> pgm.CanonicalForm:
    """φ, a CPD as a function of its child and its parents (equation 5.2)."""
    assert isinstance(cpd, pgm.GaussianCPD | pgm.LinearGaussianCPD)
    matrices = [np.asarray(cpd.matrices[parent]) for parent in cpd.parents]
    F = np.concatenate([np.zeros((cpd.child.dimension, 0)), *matrices], axis=-1)
    assert isinstance(cpd.cov, np.ndarray)
    return pgm.AffineGaussian(F, cpd.offset, cpd.cov).canonical(cpd.child, cpd.parents)
