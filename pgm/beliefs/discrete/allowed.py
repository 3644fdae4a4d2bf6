"""Runs whose evidence has probability zero: refused, or given ln p = −∞ and beliefs of NaN.

Such evidence is called impossible, and its runs *lost*. A run is one set of evidence of a batch; in
shapes, [runs] is an axis that a single run lacks. The calibrated tables of a tree stand in one flat
array, (entries of clusters + entries of sepsets, [runs]).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgm.beliefs.discrete.storage import Storage
from pgm.beliefs.discrete.tree_beliefs import TreeBeliefs
from pgm.clustergraph import ClusterGraph
from pgm.evidence.static import BoundStates
from pgm.kernels.arrays import Array, Mask
from pgm.schedules.impossible import ImpossibleEvidence
from pgm.schedules.limits import Room
from pgm.variables import Discrete


def beliefs_of(
    graph: ClusterGraph, evidence: BoundStates, room: Room, *, allow: bool
) -> TreeBeliefs | AllowedBeliefs:
    """The calibrated beliefs of all clusters of a graph without loops, given the evidence.

    The result is a `TreeBeliefs` if the evidence of every run is possible. Else, without `allow`,
    `ImpossibleEvidence` is raised. With `allow` the lost runs are calibrated without evidence, and
    the result is an `AllowedBeliefs`, which answers NaN for them, and −∞ for ln p(evidence). `room`
    limits how many table entries, times runs, are computed at once, and how many are kept for later
    answers. Tables too large for memory raise `GraphError`.
    """
    try:
        return TreeBeliefs.of(graph, evidence, room)
    except ImpossibleEvidence as error:
        if not allow:
            raise
        lost = error.lost
    return AllowedBeliefs(TreeBeliefs.of(graph, _without(evidence, lost), room), evidence, lost)


def _without(evidence: BoundStates, lost: Mask) -> BoundStates:
    """The evidence of a batch, with that of lost runs taken out; the mask `lost` is (runs,).

    The observed states of lost runs become −1, "not observed", and their weights of soft evidence
    become one, ln 1 = 0. If all runs are lost, the result has no evidence at all.
    """
    if lost.all():
        return BoundStates(evidence.lead, {}, {})
    states = {v: np.where(lost, -1, state) for v, state in evidence.states.items()}
    weights = {v: np.where(lost[:, None], 0.0, each) for v, each in evidence.weights.items()}
    return BoundStates(evidence.lead, states, weights)


@dataclass(frozen=True, eq=False)
class AllowedBeliefs:
    """The calibrated beliefs of a tree, where some runs have impossible evidence.

    possible: The beliefs of all runs; lost runs were calibrated without evidence.
    evidence: The evidence as it was given, that of lost runs included.
    lost: (runs,): which runs have evidence of probability zero.
    """

    possible: TreeBeliefs
    evidence: BoundStates
    lost: Mask

    @property
    def storage(self) -> Storage:
        """Where each cluster's table stands in the flat array of calibrated tables."""
        return self.possible.storage

    def marginal(self, variable: Discrete) -> Array:
        """The marginal of a variable given the evidence, (states, [runs]); NaN in lost runs."""
        return self._where_lost(np.nan, self.possible.marginal(variable))

    def read(self, reader: Callable[[Array], Array]) -> Array:
        """The result of `reader`, a function of the calibrated tables, with NaN in lost runs.

        `reader` takes the flat array, (entries of clusters + entries of sepsets, [runs]), in which
        ``storage.table(array, cluster)`` is the table of a cluster, and returns an array
        (..., [runs]). It may be called for some of the runs at a time.
        """
        return self._where_lost(np.nan, self.possible.read(reader))

    def log_evidence(self) -> Array:
        """The value ln p(evidence), ([runs]); −∞ in lost runs."""
        return self._where_lost(-np.inf, self.possible.log_evidence())

    def log_total(self, cluster: int) -> Array:
        """The value ln p(evidence in the tree that has `cluster`), ([runs]); −∞ in lost runs.

        A lost run has −∞ even if the evidence is impossible only in another tree of the graph.
        """
        return self._where_lost(-np.inf, self.possible.log_total(cluster))

    def message(self, source: int, target: int) -> tuple[Array, Array]:
        """The message from one cluster to a neighbour: its values, and their log-scale, (runs,).

        The message is the values, (sizes of the sepset..., runs), times exp(log-scale). In lost
        runs the values are NaN.
        """
        values, log_scale = self.possible.message(source, target)
        return self._where_lost(np.nan, values), log_scale

    def _where_lost(self, value: float, found: Array) -> Array:
        """The array `found`, (..., [runs]), but with `value` for all its entries in lost runs."""
        lost = self.lost if self.lost.size > 1 else self.lost[0]
        return np.where(lost, value, found)
