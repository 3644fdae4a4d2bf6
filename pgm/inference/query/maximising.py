"""Maxima over all joint states of a discrete tree, and the states that attain them.

Messages with maxima in place of sums go to the root of each tree, and the states of the maxima are
traced back from there. A *plan* is the layout of a graph's tables and messages. A cluster's table
is a matrix, with a *column* for each joint state of the variables that the cluster shares with its
parent (a root has one column), and a *row* for each joint state of its other variables. A *stack*
is some clusters of like shape and depth, whose matrices stand side by side in one. Tables and
messages have logarithms as entries. *Tops*, (tops, runs), sum to ln p(assignment, evidence): there
is one for each cluster, or several. That of a root is the largest entry of its table after all
messages came in, with the scales of soft evidence in its tree; all others are 0. The *home* of a
variable is the smallest cluster that holds it. The mapping ``plan.storage.homes`` gives the home of
each variable, and arrays (variables, runs) have the variables in the order of this mapping. A run
is one set of evidence of a batch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pgm.beliefs.discrete.place import steps
from pgm.beliefs.discrete.run_pieces import some_runs, tree_pieces
from pgm.beliefs.discrete.tree_passes import collect, enter, log_tops
from pgm.beliefs.discrete.tree_plan import Stack, TreePlan, plan_for
from pgm.clustergraph import ClusterGraph
from pgm.evidence.static import BoundStates
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.semirings import MAX_PRODUCT
from pgm.progress import counted
from pgm.workers.workers import Workers


@dataclass(frozen=True, eq=False)
class Search:
    """A search for the most probable assignment of some runs, in pieces that fit into memory.

    graph: The cluster graph of the network, without loops.
    evidence: The evidence of these runs.
    runs: The number of runs of the whole call, of which other workers may search the rest. The plan
        is chosen by this number, so that all workers have the same plan.
    batch: The limit on the table entries, times runs, that are computed at once.
    """

    graph: ClusterGraph
    evidence: BoundStates
    runs: int
    batch: int


def in_parts(workers: Workers, search: Search) -> list[tuple[Integers, Array]]:
    """Search all runs of `search`, divided into consecutive parts, one part for each worker.

    Returns a pair for each part, in the order of the runs: the most probable states, (variables,
    runs of the part), as indices; and the tops, (tops, runs of the part).
    """
    runs = search.runs
    edges = [runs * k // workers.count for k in range(workers.count + 1)]
    parts = [slice(*pair) for pair in pairwise(edges) if pair[0] < pair[1]]
    if len(parts) == 1:
        return [maxima(search)]
    jobs = [replace(search, evidence=some_runs(search.evidence, part)) for part in parts]
    work = workers.each(maxima, jobs, parts, large=False)
    return [done.result() for done in counted(work, "parts of the runs", len(parts))]


def maxima(search: Search) -> tuple[Integers, Array]:
    """The most probable states, (variables, runs), and the tops, (tops, runs).

    Variables are in the order of ``plan.storage.homes``; states are indices, in the smallest type
    of integers that holds them all. The tops of a run sum to ln p(assignment, evidence).
    """
    plan = plan_for(search.graph, search.runs, search.batch)
    homes = plan.storage.homes
    least = np.min_scalar_type(max((variable.size for variable in homes), default=1) - 1)
    pieces = tree_pieces(plan.storage.entries, search.evidence, search.batch)
    found = [_maximise(plan, piece) for piece in pieces]
    states = np.concatenate([states.astype(least) for states, _ in found], axis=1)
    return states, np.concatenate([tops for _, tops in found], axis=1)


def _maximise(plan: TreePlan, evidence: BoundStates) -> tuple[Integers, Array]:
    """The most probable states of some runs, (variables, runs), and the tops, (tops, runs).

    Messages with maxima in place of sums go to the roots. Then, parents before children, the states
    of the variables that a cluster shares with its parent pick a column of the cluster's table, and
    the largest entry of the column gives the states of its other variables. States are indices;
    variables are in the order of ``plan.storage.homes``.
    """
    runs = evidence.runs
    start = enter(plan, evidence, MAX_PRODUCT)
    done = collect(plan, start, MAX_PRODUCT)
    tables = start.tables.reshape(-1, runs)
    column = np.zeros((len(plan.graph), runs), dtype=np.intp)
    entry = np.zeros((len(plan.graph), runs), dtype=np.intp)
    for stack in plan.stacks:
        if stack.down is None:
            column[stack.clusters] = plan.first[stack.clusters][:, None]
        local = column[stack.clusters] - stack.columns.start
        row = _best_row(stack, tables[stack.entries], local)
        width = stack.shape[1]
        at = local * width + row if stack.axis else row * width + local
        for product in stack.absorbed:
            column[product.children] = product.columns(at)
        own = stack.widths[:, None]
        entry[stack.clusters] = row * own + local - stack.first[:, None]
    return _decode(plan, entry), log_tops(plan, evidence, done, MAX_PRODUCT).reshape(-1, runs)


def _best_row(stack: Stack, entries: Array, column: Integers) -> Integers:
    """The row of the largest entry in one column of each cluster's table, (clusters, runs).

    Of equal entries the first one counts. `entries`, (entries, runs), are the stack's tables;
    `column`, (clusters, runs), is the index of each cluster's column in the stack's matrix.
    """
    runs = entries.shape[1]
    matrix = entries.reshape(*stack.shape, runs)
    by_column = matrix if stack.axis else matrix.swapaxes(0, 1)
    best: Integers = by_column[column, :, np.arange(runs)].argmax(axis=-1)
    return best


def _decode(plan: TreePlan, entry: Integers) -> Integers:
    """The states of all variables, (variables, runs), in the order of ``plan.storage.homes``.

    `entry`, (clusters, runs), is for each cluster the index of the most probable entry of its
    table, counted row by row of the cluster's matrix. Each variable's state is read from its home's
    entry.
    """
    homes = plan.storage.homes
    scopes = {home: plan.storage.places[home].scope for home in homes.values()}
    strides = np.array([steps(scopes[home], 1)[variable] for variable, home in homes.items()])
    sizes = np.array([variable.size for variable in homes])
    states: Integers = entry[[*homes.values()]] // strides[:, None] % sizes[:, None]
    return states
