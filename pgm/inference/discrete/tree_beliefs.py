"""The calibrated beliefs of a tree, for as many runs at once as fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.evidence.discrete import BoundStates
from pgm.factors import Table
from pgm.factors.axes import States
from pgm.inference import limits
from pgm.inference.discrete.beliefs import Beliefs
from pgm.inference.discrete.calibration import Calibrated, calibrate
from pgm.inference.discrete.distinct import Distinct
from pgm.inference.discrete.evidence import pieces, tree_pieces
from pgm.inference.discrete.impossible import require_possible
from pgm.inference.discrete.joints import joint
from pgm.inference.discrete.storage import Storage
from pgm.inference.discrete.tree_messages import TreeMessages
from pgm.inference.discrete.tree_plan import TreePlan
from pgm.inference.discrete.tree_planner import plan_for
from pgm.kernels.arrays import Array
from pgm.variables import Discrete


@dataclass(frozen=True, eq=False)
class TreeBeliefs(Beliefs):
    """The calibrated beliefs of a graph without loops.

    Attributes
    ----------
    plan : TreePlan
    storage : Storage
    evidence : BoundStates
    """

    plan: TreePlan
    storage: Storage
    evidence: BoundStates
    # What follows is of the runs that differ.
    _distinct: Distinct
    # Some runs after the other; None where all would take too much room.
    _kept: Sequence[tuple[Calibrated, int]] | None
    _given: Array | None
    _log_tops: Array

    @classmethod
    def of(cls, graph: ClusterGraph, evidence: BoundStates) -> TreeBeliefs:
        """Calibrate a graph without loops.

        Raises
        ------
        GraphError
            If its tables are too large, or the marginals of all runs.
        EvidenceError
            If the evidence has probability zero.
        """
        distinct = Distinct.of(evidence)
        runs = distinct.evidence.runs
        plan = plan_for(graph, runs)
        storage = plan.storage
        keep = runs == 1 or storage.entries * runs <= limits.KEPT
        if not keep:
            limits.require_runs(plan.marginals.count, runs, "the marginals of all variables")
        kept, marginals, tops = [], [], []
        for piece in tree_pieces(storage.entries, distinct.evidence):
            done = calibrate(plan, piece)
            tops.append((done.log_tops, piece.runs))
            if keep:
                kept.append((done, piece.runs))
            elif np.isfinite(done.log_tops).all():  # else the evidence is refused below
                marginals.append((plan.marginals.read(done.tables), piece.runs))
            del done  # before the next ones are made
        log_tops = _joined(tops)
        if distinct.which is None or not np.isfinite(log_tops).all():
            require_possible(plan, evidence, distinct.spread(log_tops))
        if keep:
            return cls(plan, storage, evidence, distinct, kept, None, log_tops)
        return cls(plan, storage, evidence, distinct, None, _joined(marginals), log_tops)

    @cached_property
    def _marginals(self) -> Array:
        given = self._read(self.plan.marginals.read) if self._given is None else self._given
        # Tables of parts of it are handed out as they are.
        given.flags.writeable = False
        return given

    def marginal(self, variable: Discrete) -> Array:
        """The probabilities of a variable, (states, [runs])."""
        return self._distinct.spread(self._marginals[self.plan.marginals.where[variable]])

    def read(self, reader: Callable[[Array], Array]) -> Array:
        """What a function makes of the tables, whose last axis, if any, is of runs."""
        return self._distinct.spread(self._read(reader))

    def _read(self, reader: Callable[[Array], Array]) -> Array:
        if self._kept is not None:
            return _joined([(reader(done.tables), runs) for done, runs in self._kept])
        some = tree_pieces(self.storage.entries, self._distinct.evidence)
        return _joined([(reader(calibrate(self.plan, p).tables), p.runs) for p in some])

    def joint(self, scope: States) -> Array:
        """The probabilities of variables that no one cluster holds, (sizes..., [runs])."""
        return self.read(lambda tables: joint(self.storage, self.plan.forest, tables, scope))

    def log_evidence(self) -> Array:
        """The value ln p(evidence), ([runs])."""
        return self._distinct.spread(np.asarray(self._log_tops.sum(axis=0)))

    def log_total(self, cluster: int) -> Array:
        """The logarithm of p(evidence) of a cluster's tree, ([runs])."""
        mine = self.plan.tree_of_top == self.plan.forest.roots[cluster]
        return self._distinct.spread(np.asarray(self._log_tops[mine].sum(axis=0)))

    @cached_property
    def _whole(self) -> TreeMessages | None:
        """The messages of all runs, if they fit at once."""
        evidence = self._distinct.evidence
        if evidence.runs > 1 and self.storage.entries * evidence.runs > limits.BATCH:
            return None
        return TreeMessages(self.storage, evidence, self.plan.logs)

    def _messages(self) -> Iterator[TreeMessages]:
        """Those of all runs, or of some runs after the other, none of which is kept."""
        if self._whole is not None:
            yield self._whole
            return
        for piece in pieces(self.storage.entries, self._distinct.evidence):
            yield TreeMessages(self.storage, piece, self.plan.logs)

    def message(self, source: int, target: int) -> Table:
        """The message from one cluster to a neighbour."""
        parts = []
        for messages in self._messages():
            logs = messages.message(source, target)
            parts.append(np.broadcast_to(logs, (*logs.shape[:-1], messages.evidence.runs)))
        logs = np.concatenate(parts, axis=-1)
        if self._distinct.which is not None:
            logs = logs[..., self._distinct.which]
        scope = messages.sepset(source, target)
        top = logs.max(axis=tuple(range(len(scope))))
        top = np.where(top == -np.inf, 0.0, top)
        with np.errstate(under="ignore"):
            values = np.exp(logs - top)
        return self.table(scope, values, top)


def _joined(parts: list[tuple[Array, int]]) -> Array:
    """Arrays (..., [runs]) of some runs, and how many, one after the other."""
    if len(parts) == 1:
        return parts[0][0]
    return np.concatenate([a if runs > 1 else a[..., None] for a, runs in parts], axis=-1)
