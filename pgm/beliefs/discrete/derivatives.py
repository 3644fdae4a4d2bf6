"""Derivatives of p(evidence) by the entries of all factors, from two passes over a tree of tables.

p(evidence) is linear in each entry θ of a factor. Its derivative is the sum, over the joint states
that have the entry's, of the product of all other factors and the evidence: the belief of a cluster
that holds the factor, with the factor left out, summed to the factor's variables. Where θ is zero
the belief is, too, and cannot be divided by it. So products are kept as sums of finite logarithms
and numbers of zeros, from which any table can be taken out again.

Source: Darwiche (2003), A differential approach to inference in Bayesian networks. Park and
Darwiche (2004), A differential semantics for jointree algorithms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from pgm.beliefs.discrete.entered_evidence import entering
from pgm.beliefs.discrete.storage import Storage, contiguous, sepset_between
from pgm.clustergraph import ClusterGraph
from pgm.clustergraph.structure import Forest
from pgm.cpds import TableCPD
from pgm.evidence.static import BoundStates
from pgm.factors import Table
from pgm.factors.axes import States, spread
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import LOG_SUM_PRODUCT, log_sum

Factor = Table | TableCPD


class _Product:
    """The product of tables over a cluster, each of which can be left out.

    finite: (sizes..., runs): the sum of all logarithms that are finite.
    zeros: (sizes..., runs): the number of tables that are zero.
    """

    def __init__(self, evidence: Array) -> None:
        self.finite, self.zeros = np.zeros(evidence.shape), np.zeros(evidence.shape, dtype=np.intp)
        self.times(evidence)

    def times(self, logs: Array) -> None:
        """Multiply a table, of logarithms that broadcast, into the product."""
        zero = logs == -np.inf
        self.finite += np.where(zero, 0.0, logs)
        self.zeros += zero

    @property
    def whole(self) -> Array:
        """The logarithms of the product, (sizes..., runs)."""
        return np.where(self.zeros > 0, -np.inf, self.finite)

    def without(self, logs: Array) -> Array:
        """The logarithms of the product without a table that was multiplied in."""
        zero = logs == -np.inf
        return np.where(self.zeros > zero, -np.inf, self.finite - np.where(zero, 0.0, logs))


@dataclass(frozen=True, eq=False)
class Derivatives:
    """The derivatives of the probability of evidence in a forest of tables.

    factors: All factors.
    logs: Of each factor, ln ∂p(evidence in its tree)/∂θ, (sizes of its axes..., runs).
    trees: Of each factor, the number of its tree's root.
    log_evidence: Of each tree, by its root, ln p(evidence in the tree), (runs,).
    """

    factors: Sequence[Factor]
    logs: Sequence[Array]
    trees: Sequence[int]
    log_evidence: dict[int, Array]


def derivatives(graph: ClusterGraph, evidence: BoundStates) -> Derivatives:
    """The derivatives by the entries of all factors of a graph without loops."""
    forest, storage = graph.derived(Forest.of), contiguous(graph)
    products = [_Product(entering(storage, evidence, k)) for k in range(len(graph))]
    tables = [
        [(factor, _spread(factor, storage.scopes[k])) for factor in _factors(graph, k)]
        for k in range(len(graph))
    ]
    for product, own in zip(products, tables, strict=True):
        for _, logs in own:
            product.times(logs)
    upward: dict[int, Array] = {}
    for level in reversed(forest.levels[1:]):
        for k in level.tolist():
            parent = int(forest.parent[k])
            upward[k] = _message(storage, products[k].whole, k, parent)
            products[parent].times(upward[k])
    for level in forest.levels[:-1]:
        for k in level.tolist():
            for child in forest.children[k]:
                known = products[k].without(upward[child])
                products[child].times(_message(storage, known, k, child))
    log_evidence = {
        k: log_sum(products[k].whole, tuple(range(len(storage.scopes[k]))))
        for k in forest.levels[0].tolist()
    }
    factors, found, trees = [], [], []
    for k, own in enumerate(tables):
        for factor, logs in own:
            factors.append(factor)
            found.append(_summed(products[k].without(logs), storage.scopes[k], factor))
            trees.append(int(forest.roots[k]))
    return Derivatives(factors, found, trees, log_evidence)


def _factors(graph: ClusterGraph, cluster: int) -> Sequence[Factor]:
    return cast(Sequence[Factor], graph.clusters[cluster].factors)


def _spread(factor: Factor, scope: States) -> Array:
    """A factor's logarithms with the axes of a cluster, and one of runs, which may be one long."""
    potential = factor._potential
    logs: Array = spread(potential.entries(LOG_SUM_PRODUCT), potential.axes, scope)[..., None]
    return logs


def _message(storage: Storage, logs: Array, source: int, target: int) -> Array:
    """A table of the source, (sizes..., runs), summed to the sepset, with the target's axes."""
    shared = sepset_between(storage.graph, source, target)
    gone = tuple(k for k, v in enumerate(storage.scopes[source]) if v not in shared)
    # Sepsets and clusters both have the network's order.
    sizes = (v.size if v in shared else 1 for v in storage.scopes[target])
    return log_sum(logs, gone).reshape(*sizes, -1)


def _summed(logs: Array, scope: States, factor: Factor) -> Array:
    """A cluster's table, (sizes..., runs), summed to a factor's axes, in their order."""
    axes = factor._potential.axes
    left = tuple(v for v in scope if v in axes)
    total = log_sum(logs, tuple(k for k, v in enumerate(scope) if v not in axes))
    return total.transpose(*(left.index(v) for v in axes), -1)
