"""The calibrated beliefs of a tree, for as many runs at once as fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.errors import EvidenceError
from pgm.evidence.discrete import BoundStates
from pgm.evidence.indices import in_run
from pgm.factors import Table
from pgm.factors.axes import States
from pgm.factors.scope import names
from pgm.inference import limits
from pgm.inference.discrete.beliefs import Beliefs
from pgm.inference.discrete.entering import pieces
from pgm.inference.discrete.exchange import Exchange
from pgm.inference.discrete.joints import joint
from pgm.inference.discrete.passes import Calibrated, calibrate
from pgm.inference.discrete.plan import TreePlan
from pgm.inference.discrete.planner import make_plan
from pgm.inference.discrete.storage import Storage
from pgm.kernels.arrays import Array
from pgm.variables import Discrete


@dataclass(frozen=True, eq=False)
class TreeBeliefs(Beliefs):
    """The calibrated beliefs of a graph without loops.

    Attributes
    ----------
    plan : TreePlan
    evidence : BoundStates
    """

    plan: TreePlan
    evidence: BoundStates
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
            If its tables are too large.
        EvidenceError
            If the evidence has probability zero.
        """
        plan = graph.derived(make_plan)
        keep = evidence.runs == 1 or plan.storage.entries * evidence.runs <= limits.KEPT
        kept, marginals, tops = [], [], []
        for piece in pieces(plan.storage.entries, evidence):
            done = calibrate(plan, piece)
            tops.append((done.log_tops, piece.runs))
            if keep:
                kept.append((done, piece.runs))
            elif np.isfinite(done.log_tops).all():  # else the evidence is refused below
                marginals.append((plan.marginals.read(done.tables), piece.runs))
        log_tops = _joined(tops)
        require_possible(plan, evidence, log_tops)
        if keep:
            return cls(plan, evidence, kept, None, log_tops)
        return cls(plan, evidence, None, _joined(marginals), log_tops)

    @property
    def storage(self) -> Storage:  # type: ignore[override]
        """Where the tables stand."""
        return self.plan.storage

    @cached_property
    def _marginals(self) -> Array:
        return self.read(self.plan.marginals.read) if self._given is None else self._given

    def marginal(self, variable: Discrete) -> Array:
        """The probabilities of a variable, (states, [runs])."""
        return self._marginals[self.plan.marginals.where[variable]]

    def read(self, reader: Callable[[Array], Array]) -> Array:
        """What a function makes of the tables, whose last axis, if any, is of runs."""
        if self._kept is not None:
            return _joined([(reader(done.tables), runs) for done, runs in self._kept])
        some = pieces(self.storage.entries, self.evidence)
        return _joined([(reader(calibrate(self.plan, p).tables), p.runs) for p in some])

    def joint(self, scope: States) -> Array:
        """The probabilities of variables that no one cluster holds, (sizes..., [runs])."""
        return self.read(lambda tables: joint(self.storage, self.plan.forest, tables, scope))

    def log_evidence(self) -> Array:
        """The value ln p(evidence), ([runs])."""
        total: Array = np.asarray(self._log_tops.sum(axis=0))
        return total

    def log_total(self, cluster: int) -> Array:
        """The logarithm of p(evidence) of a cluster's tree, ([runs])."""
        mine = self.plan.tree_of_top == self.plan.tree[cluster]
        total: Array = np.asarray(self._log_tops[mine].sum(axis=0))
        return total

    @cached_property
    def _exchange(self) -> Exchange:
        return Exchange(self.storage, self.evidence, self.plan.logs)

    def message(self, source: int, target: int) -> Table:
        """The message from one cluster to a neighbour."""
        scope = self._exchange.sepset(source, target)
        logs = self._exchange.message(source, target)
        top = logs.max(axis=tuple(range(len(scope))))
        top = np.where(top == -np.inf, 0.0, top)
        with np.errstate(under="ignore"):
            values = np.exp(logs - top)
        runs = self.evidence.runs
        values = np.broadcast_to(values, (*values.shape[:-1], runs))
        return self.table(scope, values, np.broadcast_to(top, runs))


def _joined(parts: list[tuple[Array, int]]) -> Array:
    """Arrays (..., [runs]) of some runs, and how many, one after the other."""
    if len(parts) == 1:
        return parts[0][0]
    return np.concatenate([a if runs > 1 else a[..., None] for a, runs in parts], axis=-1)


def require_possible(plan: TreePlan, evidence: BoundStates, log_tops: Array) -> None:
    """Refuse evidence of probability zero: a scale whose logarithm, (tops, [runs]), is −∞.

    Raises
    ------
    EvidenceError
        Naming the first run and the variables with evidence in its tree.
    """
    # One sum finds out, whatever is infinite.
    if np.isfinite(np.add.reduce(log_tops, None)):
        return
    impossible = log_tops == -np.inf
    runs = impossible.any(axis=0)
    first = int(runs.argmax())
    lost = impossible[:, first] if runs.ndim else impossible
    root = plan.tree_of_top[lost.argmax()]
    involved = [
        v for v in (*evidence.states, *evidence.weights) if plan.tree[plan.storage.homes[v]] == root
    ]
    where = in_run(runs.reshape(evidence.lead))
    raise EvidenceError(
        f"the evidence has probability zero{where}: no assignment of the network agrees with that "
        f"for {names(involved)}; take some of it out, or give states that the tables hold for "
        "impossible a probability",
        variable=involved[0],
    )
