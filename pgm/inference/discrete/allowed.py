"""Runs whose evidence has probability zero: refused, or allowed, with −∞ and beliefs of NaN."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.errors import ModelError
from pgm.evidence.static import BoundStates
from pgm.inference.discrete.impossible import ImpossibleEvidence
from pgm.inference.discrete.storage import Storage
from pgm.inference.discrete.tree_beliefs import TreeBeliefs
from pgm.inference.limits import Room
from pgm.kernels.arrays import Array, Mask
from pgm.variables import Discrete

RAISE, ALLOW = "raise", "allow"


def allows(impossible: object) -> bool:
    """Whether impossible evidence is allowed, from the user's ``"raise"`` or ``"allow"``."""
    if impossible not in (RAISE, ALLOW):
        raise ModelError(f'impossible is "{RAISE}" or "{ALLOW}", not {impossible!r}')
    return impossible == ALLOW


def beliefs_of(
    graph: ClusterGraph, evidence: BoundStates, room: Room, *, allow: bool
) -> TreeBeliefs | AllowedBeliefs:
    """Calibrate a tree.

    With `allow`, runs of impossible evidence are calibrated without their evidence.
    """
    try:
        return TreeBeliefs.of(graph, evidence, room)
    except ImpossibleEvidence as error:
        if not allow:
            raise
        lost = error.lost
    return AllowedBeliefs(TreeBeliefs.of(graph, _without(evidence, lost), room), evidence, lost)


def _without(evidence: BoundStates, lost: Mask) -> BoundStates:
    """The evidence with nothing observed in the `lost` runs, (runs,)."""
    if lost.all():
        return BoundStates(evidence.lead, {}, {})
    states = {v: np.where(lost, -1, state) for v, state in evidence.states.items()}
    weights = {v: np.where(lost[:, None], 1.0, each) for v, each in evidence.weights.items()}
    return BoundStates(evidence.lead, states, weights)


@dataclass(frozen=True, eq=False)
class AllowedBeliefs:
    """The calibrated beliefs of a tree, where some runs have impossible evidence.

    possible: The beliefs of all runs, those that are lost without any evidence.
    evidence: As it was given.
    lost: (runs,): which runs have evidence of probability zero.
    """

    possible: TreeBeliefs
    evidence: BoundStates
    lost: Mask

    @property
    def storage(self) -> Storage:
        """The layout of the tables that `read` is given."""
        return self.possible.storage

    def marginal(self, variable: Discrete) -> Array:
        """The probabilities of a variable, (states, [runs])."""
        return self._where_lost(np.nan, self.possible.marginal(variable))

    def read(self, reader: Callable[[Array], Array]) -> Array:
        """The result of a function of the tables, whose last axis, if any, is of runs."""
        return self._where_lost(np.nan, self.possible.read(reader))

    def log_evidence(self) -> Array:
        """The value ln p(evidence), ([runs])."""
        return self._where_lost(-np.inf, self.possible.log_evidence())

    def log_total(self, cluster: int) -> Array:
        """The logarithm of p(evidence) of a cluster's tree, ([runs]); −∞ if of any tree it is."""
        return self._where_lost(-np.inf, self.possible.log_total(cluster))

    def message(self, source: int, target: int) -> tuple[Array, Array]:
        """The message from one cluster to a neighbour, (sizes..., runs), and its log-scale."""
        values, log_scale = self.possible.message(source, target)
        return self._where_lost(np.nan, values), log_scale

    def _where_lost(self, value: float, found: Array) -> Array:
        lost = self.lost if self.lost.size > 1 else self.lost[0]
        return np.where(lost, value, found)
