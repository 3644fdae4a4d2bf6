"""Draws of all variables of a tree of tables, each cluster's after its parent's.

The calibrated table of a cluster is p(its variables | evidence). A root's variables are drawn from
its table, and those that another cluster does not share with its parent from the columns of its
table that the shared variables' states pick. A run is one set of evidence of a batch.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.discrete.allowed import AllowedBeliefs
from pgm.beliefs.discrete.first_beliefs import FirstBeliefs
from pgm.beliefs.discrete.loopy_messages import LoopyBeliefs
from pgm.beliefs.discrete.storage import Storage, sepset_between
from pgm.beliefs.discrete.tree_beliefs import TreeBeliefs
from pgm.clustergraph import ClusterGraph
from pgm.clustergraph.structure import Forest
from pgm.errors import EvidenceError, GraphError
from pgm.factors.axes import sizes
from pgm.kernels.arrays import Array, Integers, ranks, unravelled
from pgm.kernels.stochastic import Dense
from pgm.resources import require_memory
from pgm.variables import Discrete, Variable


def draws(
    graph: ClusterGraph,
    beliefs: TreeBeliefs | AllowedBeliefs | FirstBeliefs | LoopyBeliefs,
    count: int,
    rng: np.random.Generator,
) -> dict[Variable, Integers]:
    """So many draws of each variable's state, (count, runs), for each run of the evidence."""
    if not graph.is_tree:
        raise GraphError(
            "draws of all variables together are of graphs without loops, whose clusters are drawn "
            "one after another; compile a junction tree, pgm.compile(network)"
        )
    if isinstance(beliefs, AllowedBeliefs):
        raise EvidenceError(
            "the evidence of some runs has probability zero, of which there are no draws; leave "
            "these runs out"
        )
    forest = Forest.of(graph)
    evidence, storage = beliefs.evidence, beliefs.storage
    which = beliefs.which if isinstance(beliefs, TreeBeliefs) else None
    # Runs of equal evidence share their tables, and each has draws of its own.
    counts = np.ones(1, dtype=np.intp) if which is None else np.bincount(which)
    most, runs = int(counts.max()), evidence.runs if which is None else counts.size
    variables = len(storage.homes)
    require_memory(
        2 * count * most * runs * variables,
        f"{count:,} draws of {variables:,} variables in {evidence.runs:,} runs",
        "draw fewer at a time",
    )

    def read(tables: Array) -> Array:
        states = _drawn(storage, forest, tables, count * most, rng)
        # Numbers, as all that is read of tables.
        found = np.stack([states[v] for v in storage.homes]).astype(np.float64)
        return found if tables.ndim > 1 else found[..., 0]

    reading = beliefs.read_each if isinstance(beliefs, TreeBeliefs) else beliefs.read
    found = reading(read)
    found = found.reshape(variables, most, count, runs).astype(np.intp)
    own = found[:, 0] if which is None else found[:, ranks(which), :, which].transpose(1, 2, 0)
    return dict(zip(storage.homes, own, strict=True))


def _drawn(
    storage: Storage, forest: Forest, tables: Array, count: int, rng: np.random.Generator
) -> dict[Discrete, Integers]:
    """The states of all variables by the calibrated tables, (count, runs)."""
    runs = tables.shape[1] if tables.ndim > 1 else 1
    each = np.arange(runs)
    states: dict[Discrete, Integers] = {}
    for level in forest.levels:
        for k in level.tolist():
            scope = storage.scopes[k]
            shared = sepset_between(storage.graph, k, int(forest.parent[k]))
            own = tuple(v for v in scope if v not in shared)
            if not own:
                continue
            order = [scope.index(v) for v in (*shared, *own)]
            table = storage.table(tables, k).reshape(*sizes(scope), runs)
            columns, rows = int(np.prod(sizes(shared), dtype=int)), int(np.prod(sizes(own)))
            table = table.transpose(*order, -1).reshape(columns, rows, runs)
            column = np.zeros((count, runs), dtype=np.intp)
            if shared:
                column = np.ravel_multi_index(tuple(states[v] for v in shared), sizes(shared))
            by_column = Dense(np.moveaxis(table, -1, 0).reshape(runs * columns, rows))
            row = by_column.draw(each * columns + column, rng)
            states |= dict(zip(own, unravelled(row, sizes(own)), strict=True))
    return states
