"""Errors for evidence of probability zero, which tell where it contradicts the tables.

On a graph without loops messages are sent to the roots of the trees, as a `TreePlan` lays out.
*Tops* are the scales that are taken out of the messages, and out of the roots' tables: if one of
them is zero, so is the probability of the evidence. On a graph with loops a message or belief that
is zero for all its states tells the same. A run is one set of evidence of a batch; in shapes,
[runs] is an axis that a single run lacks.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from pgm.beliefs.discrete.run_pieces import some_runs
from pgm.beliefs.discrete.tree_messages import TreeMessages
from pgm.beliefs.discrete.tree_plan import TreePlan
from pgm.clustergraph import Cluster
from pgm.errors import EvidenceError
from pgm.evidence.static import BoundStates
from pgm.factors.scope import in_run, names
from pgm.kernels.arrays import Array, Mask
from pgm.schedules.impossible import ImpossibleEvidence
from pgm.variables import Discrete

ADVICE = (
    "Leave some of it out; or, if it can happen, replace the zeros that forbid it in the CPDs' "
    "tables by small probabilities"
)


def require_possible(
    plan: TreePlan, evidence: BoundStates, log_tops: Array, of_runs: str = ""
) -> None:
    """Raise `ImpossibleEvidence` if the evidence has probability zero in some run.

    plan: The layout of the messages to the roots.
    log_tops: (tops, [runs]): logarithms of the scales, of which at least one is −∞ in a run with
        impossible evidence.
    of_runs: Advice for batches, appended to the error's text if the evidence has axes of runs.
    """
    # One sum finds out, whatever is infinite.
    if math.isfinite(np.add.reduce(log_tops, None)):
        return
    impossible = log_tops == -np.inf
    runs = impossible.any(axis=0)
    first = int(runs.argmax())
    lost = impossible[:, first] if runs.ndim else impossible
    root = int(plan.tree_of_top[lost.argmax()])
    alone = some_runs(evidence, slice(first, first + 1))
    cluster, involved = _contradiction(plan, alone, root)
    where = in_run(runs.reshape(evidence.lead))
    what = f"cluster {cluster.index} over {names(cluster.scope)}"
    raise ImpossibleEvidence(
        f"{told(where, involved, what)}{of_runs if evidence.lead else ''}",
        runs,
        evidence.lead,
        variable=next(iter(involved), None),
        cluster=cluster.index,
    )


def told(where: str, involved: Sequence[Discrete], what: str) -> str:
    """The text of an error: all states of something are impossible, by evidence for variables.

    No variable is involved where factors exclude one another, which CPDs never do. `where` names
    the run.
    """
    if involved:
        return (
            f"the evidence has probability zero{where}: that for {names(involved)} contradicts "
            f"itself, for all states of {what} are impossible given it. {ADVICE}"
        )
    return (
        f"the factors exclude one another{where}, whatever the evidence is: all states of {what} "
        "are impossible. Leave some of the factors out, or replace zeros of theirs"
    )


def _contradiction(
    plan: TreePlan, evidence: BoundStates, root: int
) -> tuple[Cluster, list[Discrete]]:
    """The cluster of a tree at which evidence contradicts itself, and this evidence's variables.

    `evidence` is that of one run, `root` the number of the tree's root. The cluster is the deepest
    whose message to its parent is zero throughout, or the root if there is no such message. The
    variables are those with evidence in this cluster or in clusters below it: first the observed
    ones, then those whose soft evidence enters one of these clusters.
    """
    forest, scopes = plan.forest, plan.storage.scopes
    messages = TreeMessages(plan.storage, evidence)
    upward = (
        k
        for level in reversed(forest.levels[1:])
        for k in level.tolist()
        if forest.roots[k] == root and (messages.message(k, int(forest.parent[k])) == -np.inf).all()
    )
    at = next(upward, root)
    below, waiting = [], [at]
    while waiting:
        below.append(waiting.pop())
        waiting += forest.children[below[-1]]
    members = {v for k in below for v in scopes[k]}
    states = [v for v, s in evidence.states.items() if v in members and np.min(s) >= 0]
    weights = [v for v in evidence.weights if plan.storage.homes[v] in below]
    return plan.graph.clusters[at], list(dict.fromkeys((*states, *weights)))


def contradicted(empty: Mask, clusters: Iterable[Cluster], lead: tuple[int, ...]) -> EvidenceError:
    """Make the error for a message or belief, on a graph with loops, that is zero throughout.

    The error is returned for the caller to raise. It names the first run in which a message or
    belief is zero, and the cluster of the first one that is.

    empty: (rows, runs): a row for each of some messages or beliefs, true in the runs in which it is
        zero throughout; at least one entry is true.
    clusters: Of each row, the sender of the message, or the cluster whose belief it is.
    lead: The lengths of the user's axes of runs, which are flattened to one in `empty`.
    """
    runs = empty.any(axis=0)
    row = int(empty[:, runs.argmax()].argmax())
    cluster = list(clusters)[row]
    return EvidenceError(
        f"the evidence has probability zero{in_run(runs.reshape(lead))}: all states of cluster "
        f"{cluster.index} over {names(cluster.scope)} are impossible given it and the messages "
        f"of the cluster's neighbours. {ADVICE}",
        cluster=cluster.index,
    )
