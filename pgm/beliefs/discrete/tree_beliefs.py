"""The calibrated beliefs of a tree, for as many runs at once as fit into memory.

A run is one set of evidence of a batch. In shapes, [runs] is an axis that a single run lacks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.beliefs.discrete.impossible import require_possible
from pgm.beliefs.discrete.run_pieces import Distinct, pieces, tree_pieces
from pgm.beliefs.discrete.storage import Storage
from pgm.beliefs.discrete.tree_messages import TreeMessages
from pgm.beliefs.discrete.tree_passes import Calibrated, calibrate
from pgm.beliefs.discrete.tree_plan import TreePlan, plan_for
from pgm.clustergraph import ClusterGraph
from pgm.evidence.static import BoundStates
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import exp
from pgm.schedules.impossible import OF_RUNS
from pgm.schedules.limits import Room, require_runs
from pgm.variables import Discrete


@dataclass(frozen=True, eq=False)
class TreeBeliefs:
    """The calibrated beliefs of a graph without loops.

    Runs of equal evidence are computed once. The tables of all different runs are kept if they fit
    into a limit. Else the marginals alone are kept, and the tables are calibrated anew, some runs
    at a time, whenever they are read. In fields with an underscore, runs are the different runs.

    plan: The layout of the passes of messages.
    storage: Where each cluster's table stands in the flat array of calibrated tables.
    evidence: The evidence of all runs.
    _room: How many table entries, times runs, are computed at once, and how many are kept.
    _distinct: The different runs, and which of them each run of the batch equals.
    _kept: The calibrated tables of consecutive parts of the runs, each with its number of runs;
        None where they would take too much room.
    _given: The marginals, (states of all variables, [runs]), where tables are not kept, else None.
    _log_tops: (tops, [runs]): logarithms of the scales taken out of messages; they sum to
        ln p(evidence).
    """

    plan: TreePlan
    storage: Storage
    evidence: BoundStates
    _room: Room
    _distinct: Distinct
    _kept: Sequence[tuple[Calibrated, int]] | None
    _given: Array | None
    _log_tops: Array

    @classmethod
    def of(cls, graph: ClusterGraph, evidence: BoundStates, room: Room) -> TreeBeliefs:
        """Calibrate a graph without loops, as many runs at a time as fit into `room`.

        `room` also limits the tables that are kept. Evidence of probability zero in some run raises
        `ImpossibleEvidence`; tables, or marginals of all runs, that are too large raise
        `GraphError`.
        """
        distinct = Distinct.of(evidence)
        runs = distinct.evidence.runs
        plan = plan_for(graph, runs, room.batch)
        storage = plan.storage
        keep = runs == 1 or storage.entries * runs <= room.kept
        if not keep:
            require_runs(plan.marginals.count, runs, "the marginals of all variables")
        kept, marginals, tops = [], _Gathered(runs), _Gathered(runs)
        for piece in tree_pieces(storage.entries, distinct.evidence, room.batch):
            done = calibrate(plan, piece)
            tops.add(done.log_tops, piece.runs)
            if keep:
                kept.append((done, piece.runs))
            elif np.isfinite(done.log_tops).all():  # else the evidence is refused below
                marginals.add(plan.marginals.read(done.tables), piece.runs)
            del done  # before the next ones are made
        log_tops = tops.whole
        if distinct.which is None or not np.isfinite(log_tops).all():
            require_possible(plan, evidence, distinct.spread(log_tops), OF_RUNS)
        if keep:
            return cls(plan, storage, evidence, room, distinct, kept, None, log_tops)
        return cls(plan, storage, evidence, room, distinct, None, marginals.whole, log_tops)

    @cached_property
    def _marginals(self) -> Array:
        """The marginals of all variables one after the other, (states of all variables, [runs]).

        The runs are the different ones, each once. ``plan.marginals.where[variable]`` is the slice
        of each marginal.
        """
        given = self.read_each(self.plan.marginals.read) if self._given is None else self._given
        # Tables of parts of it are handed out as they are.
        given.flags.writeable = False
        return given

    @property
    def which(self) -> Integers | None:
        """For each run the different one that it equals, (runs,); None if all are different."""
        return self._distinct.which

    def marginal(self, variable: Discrete) -> Array:
        """The marginal of a variable given the evidence, (states, [runs])."""
        return self._distinct.spread(self._marginals[self.plan.marginals.where[variable]])

    def read(self, reader: Callable[[Array], Array]) -> Array:
        """The result of a function of the calibrated tables, for all runs.

        `reader` takes the tables of some runs in one flat array, (entries of clusters + entries of
        sepsets, [runs]): the clusters' in the layout of `storage`, then the sepsets'. It returns an
        array (..., [runs]).
        """
        return self._distinct.spread(self.read_each(reader))

    def read_each(self, reader: Callable[[Array], Array]) -> Array:
        """The result of a function of the calibrated tables, for the different runs, each once.

        `reader` is called with parts of these runs; it takes their tables in one flat array,
        (entries of clusters + entries of sepsets, [runs]), and returns an array (..., [runs]).
        """
        found = _Gathered(self._distinct.evidence.runs)
        if self._kept is not None:
            for done, runs in self._kept:
                found.add(reader(done.tables), runs)
            return found.whole
        evidence, batch = self._distinct.evidence, self._room.batch
        for piece in tree_pieces(self.storage.entries, evidence, batch):
            found.add(reader(calibrate(self.plan, piece).tables), piece.runs)
        return found.whole

    def log_evidence(self) -> Array:
        """The value ln p(evidence), ([runs])."""
        return self._distinct.spread(np.asarray(self._log_tops.sum(axis=0)))

    def log_total(self, cluster: int) -> Array:
        """The value ln p(evidence in the tree that has `cluster`), ([runs])."""
        mine = self.plan.tree_of_top == self.plan.forest.roots[cluster]
        return self._distinct.spread(np.asarray(self._log_tops[mine].sum(axis=0)))

    @cached_property
    def _whole(self) -> TreeMessages:
        """The messages between clusters, for all different runs; each is computed on request."""
        return TreeMessages(self.storage, self._distinct.evidence)

    def message(self, source: int, target: int) -> tuple[Array, Array]:
        """The message from one cluster to a neighbour: its values, and their log-scale, (runs,).

        The message is the values, (sizes of the sepset..., runs), times exp(log-scale). The largest
        value of each run is one, or zero where the whole message is zero.
        """
        evidence, parts = self._distinct.evidence, []
        for piece in pieces(evidence, self._room.batch // self.storage.entries):
            several = piece is not evidence
            messages = TreeMessages(self.storage, piece) if several else self._whole
            parts.append(messages.message(source, target))
        logs = np.concatenate(parts, axis=-1)
        if self._distinct.which is not None:
            logs = logs[..., self._distinct.which]
        top = logs.max(axis=tuple(range(logs.ndim - 1)))
        top = np.where(top == -np.inf, 0.0, top)
        return exp(logs - top), top


class _Gathered:
    """The results of consecutive parts of the runs, (..., [runs]), gathered in one array, `whole`.

    runs: The number of runs in all; `whole` is complete once the results of so many were added.
    """

    whole: Array

    def __init__(self, runs: int) -> None:
        self.runs = runs
        self.done = 0

    def add(self, values: Array, runs: int) -> None:
        """Add `values`, the results (..., [runs]) of the next `runs` runs."""
        if runs == self.runs:
            self.whole = values
            return
        each = values if runs > 1 else values[..., None]
        if not self.done:
            self.whole = np.empty((*each.shape[:-1], self.runs))
        self.whole[..., self.done : self.done + runs] = each
        self.done += runs
