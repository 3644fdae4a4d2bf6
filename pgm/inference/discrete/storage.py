"""The layout of a graph's tables in one flat array, whose last axis is of runs; its evidence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import cast

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.cpds import TableCPD
from pgm.evidence.static import BoundStates
from pgm.factors.axes import States, discrete, spread
from pgm.inference.discrete.place import LARGE, Place, View, by_state
from pgm.inference.discrete.sums import Marginals
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.tables import LOG_SUM_PRODUCT, Semiring
from pgm.progress import counted
from pgm.variables import Discrete


@dataclass(frozen=True, eq=False)
class Storage:
    """The flat array of a graph's tables."""

    graph: ClusterGraph
    places: Sequence[Place]

    @cached_property
    def entries(self) -> int:
        """The length of the array."""
        return sum(self.graph.sizes)

    @cached_property
    def scopes(self) -> tuple[States, ...]:
        """The variables of each cluster, in its own order."""
        return tuple(discrete(cluster.scope) for cluster in self.graph.clusters)

    def table(self, entries: Array, cluster: int) -> Array:
        """A view of a cluster's table, with an axis for each variable, then of the runs, if any."""
        return self.places[cluster].view(self.scopes[cluster]).of(entries)

    @cached_property
    def holders(self) -> dict[Discrete, list[int]]:
        """The clusters that hold each variable."""
        found: dict[Discrete, list[int]] = {}
        for cluster, scope in enumerate(self.scopes):
            for variable in scope:
                found.setdefault(variable, []).append(cluster)
        return found

    @cached_property
    def homes(self) -> dict[Discrete, int]:
        """The smallest cluster that holds each variable, the first of equals."""
        sizes_of = self.graph.sizes
        return {v: min(found, key=sizes_of.__getitem__) for v, found in self.holders.items()}

    @cached_property
    def by_state(self) -> dict[Discrete, View]:
        """The home of each variable, with the axis of the variable first."""
        return {v: by_state(self.places[home], v) for v, home in self.homes.items()}

    @cached_property
    def logs(self) -> Array:
        """The logarithms of the clusters' potentials."""
        return self.potentials(LOG_SUM_PRODUCT)

    @cached_property
    def marginals(self) -> Marginals:
        """The sums of the tables to the probabilities of each variable."""
        homes = {variable: self.places[home] for variable, home in self.homes.items()}
        return Marginals.of(homes, self.entries)

    def potentials(self, semiring: Semiring, room: int = 0) -> Array:
        """The product of each cluster's CPDs, (entries + room,).

        Raises
        ------
        FloatingPointError
            If numbers are wanted, and one is below what a number holds.
        """
        flat = np.full(self.entries + room, semiring.one)
        for cluster, scope in zip(self.graph.clusters, self.scopes, strict=True):
            table = self.table(flat, cluster.index)
            for cpd in cast(tuple[TableCPD, ...], cluster.cpds):
                entries = spread(semiring.entries(cpd.table), (*cpd.given, cpd.child), scope)
                with np.errstate(under="raise"):
                    semiring.times(table, entries, out=table)
        return flat


def contiguous(graph: ClusterGraph) -> Storage:
    """One table after the other, each in the order of its cluster's scope."""
    starts = accumulate(graph.sizes, initial=0)
    clusters = zip(graph.clusters, starts, strict=False)
    return Storage(graph, [Place.of(discrete(c.scope), start, LARGE) for c, start in clusters])


def sepset_between(graph: ClusterGraph, i: int, j: int) -> States:
    """The variables that two neighbours share; none, where one is the parent of a root, −1."""
    return discrete(graph.sepsets[min(i, j), max(i, j)]) if min(i, j) >= 0 else ()


# Runs at once, less than which are computed one by one: loops over a few are short, and the tables
# of one run stay nearer the processor.
FEW = 64


def multiply(storage: Storage, tables: Array, evidence: BoundStates, semiring: Semiring) -> None:
    """Multiply evidence into tables, (entries, [runs])."""
    for variable, state in evidence.states.items():
        table = storage.by_state[variable].of(tables)
        if isinstance(state, int):
            table[:state] = semiring.zero
            table[state + 1 :] = semiring.zero
        else:
            _weigh(table, one_hot(state, variable.size), semiring)
    runs = tables.ndim > 1
    for variable, soft in evidence.weights.items():
        table = storage.by_state[variable].of(tables)
        _weigh(table, soft.T if runs else soft[0], semiring)


def _weigh(table: Array, weights: Array, semiring: Semiring) -> None:
    """Multiply weights (states, [runs]) into a table (states, others..., [runs])."""
    shape = (len(weights), *(1,) * (table.ndim - weights.ndim), *weights.shape[1:])
    semiring.times(table, semiring.entries(weights.reshape(shape)), table)


def enter_everywhere(storage: Storage, evidence: BoundStates) -> Array:
    """Logarithms of the potentials times the evidence, (entries, runs).

    States enter every cluster that has the variable, so that no message has to bring them; weights
    enter one.
    """
    tables = np.repeat(storage.logs[:, None], evidence.runs, axis=1)
    for variable, state in evidence.states.items():
        shown = one_hot(np.reshape(state, -1), variable.size)
        for cluster in storage.holders[variable]:
            _weigh(by_state(storage.places[cluster], variable).of(tables), shown, LOG_SUM_PRODUCT)
    for variable, soft in evidence.weights.items():
        _weigh(storage.by_state[variable].of(tables), soft.T, LOG_SUM_PRODUCT)
    return tables


def entered(storage: Storage, evidence: BoundStates, cluster: int) -> Array:
    """Logarithms of the potential of one cluster times its evidence, (sizes..., runs)."""
    scope = storage.scopes[cluster]
    table = np.repeat(storage.table(storage.logs, cluster)[..., None], evidence.runs, axis=-1)
    for variable, state in evidence.states.items():
        if variable in scope:
            shown = one_hot(np.reshape(state, -1), variable.size)
            _weigh(np.moveaxis(table, scope.index(variable), 0), shown, LOG_SUM_PRODUCT)
    for variable, soft in evidence.weights.items():
        if storage.homes[variable] == cluster:
            _weigh(np.moveaxis(table, scope.index(variable), 0), soft.T, LOG_SUM_PRODUCT)
    return table


def one_hot(states: Integers, size: int) -> Array:
    """One where a state is the one observed, or none is: (size, runs)."""
    found: Array = ((states == np.arange(size)[:, None]) | (states < 0)).astype(float)
    return found


def put_in(evidence: BoundStates, scope: States) -> tuple[int | slice, ...]:
    """The index that puts in the states that are one and the same for all runs."""
    states = evidence.states
    return tuple(s if isinstance(s := states.get(v), int) else slice(None) for v in scope)


def axes_left(evidence: BoundStates, scope: States) -> States:
    """The variables that messages and beliefs have axes of: those that are not put in."""
    return tuple(v for v in scope if not isinstance(evidence.states.get(v), int))


def at_once(entries: int, batch: int) -> int:
    """The runs of a tree that are calibrated at once: as many as fit, or one if only few do."""
    size = batch // entries
    return size if size >= FEW else 1


def tree_pieces(entries: int, evidence: BoundStates, batch: int) -> Iterator[BoundStates]:
    """Some runs after the other, as many as are calibrated at once."""
    for piece in pieces(evidence, at_once(entries, batch)):
        yield _of_one(piece) if piece.lead and piece.runs == 1 else piece


def _of_one(evidence: BoundStates) -> BoundStates:
    known = {v: s if isinstance(s, int) else int(s[0]) for v, s in evidence.states.items()}
    observed = {v: state for v, state in known.items() if state >= 0}
    return BoundStates(evidence.lead, observed, evidence.weights)


def pieces(evidence: BoundStates, size: int) -> Iterator[BoundStates]:
    """Some runs after the other, so many at a time or one."""
    size = max(1, size)
    if evidence.runs <= size:
        yield evidence
        return
    for start in counted(range(0, evidence.runs, size), "parts of the runs"):
        yield some_runs(evidence, slice(start, start + size))


def some_runs(evidence: BoundStates, which: slice | Integers) -> BoundStates:
    """The evidence of some runs."""
    count = np.arange(evidence.runs)[which].size
    states = {
        v: s if isinstance(s, int) or s.size == 1 else s[which] for v, s in evidence.states.items()
    }
    weights = {v: w if len(w) == 1 else w[which] for v, w in evidence.weights.items()}
    return BoundStates((count,), states, weights)


# Codes of runs are whole numbers of 64 bits.
CODES = 2**62


@dataclass(frozen=True, eq=False)
class Distinct:
    """The runs of some evidence, each different one once.

    which: (runs,): which of them each run is; None if all differ.
    """

    evidence: BoundStates
    which: Integers | None

    @classmethod
    def of(cls, evidence: BoundStates) -> Distinct:
        """Find the runs that differ; those with weights of their own are not compared."""
        if evidence.runs == 1 or any(len(weights) > 1 for weights in evidence.weights.values()):
            return cls(evidence, None)
        codes = np.zeros(evidence.runs, dtype=np.int64)
        count = 1
        for variable, state in evidence.states.items():
            if isinstance(state, int) or state.size == 1:
                continue
            if count * (variable.size + 1) > CODES:
                codes = np.unique(codes, return_inverse=True)[1]
                count = evidence.runs
            codes = codes * (variable.size + 1) + state + 1
            count *= variable.size + 1
        _, first, which = np.unique(codes, return_index=True, return_inverse=True)
        if first.size == evidence.runs:
            return cls(evidence, None)
        return cls(some_runs(evidence, first), which)

    def spread(self, values: Array) -> Array:
        """Values (..., [runs that differ]) as those of all runs, (..., [runs])."""
        if self.which is None:
            return values
        if self.evidence.runs == 1:
            return np.broadcast_to(values[..., None], (*values.shape, self.which.size))
        return values[..., self.which]
