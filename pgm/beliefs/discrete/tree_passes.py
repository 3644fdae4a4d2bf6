"""The two passes of messages over a tree of tables: towards the roots, and back.

A *stack* is some clusters of like shape and depth, computed together; a set of stacks is an integer
with a bit for each. The *entries* are those of all clusters' tables; a *column* is an entry of the
message from a cluster to its parent, or of their sepset. In shapes, [runs] is an axis that a single
run lacks. All arrays hold entries of the semiring: numbers, or logarithms.

A stack is *active* if its clusters send messages to their parents. The messages of other stacks'
clusters would be one everywhere, and are not sent: there is no evidence in these clusters or below
them, and their potentials are p(cluster | sepset with the parent).

Each message to a parent is divided by its largest entry, its *top*, lest products underflow. The
table of a *hub*, a cluster of many children, is divided by its largest entry in the same way,
whenever a few of the children's messages were multiplied into it; this is one more top. A root's
top is the sum of its table, so that the product of all tops of a tree is p(evidence in the tree).
With logarithms nothing is divided, and all tops are ln 1 = 0 except the roots'.
"""

import math
from dataclasses import dataclass

import numpy as np

from pgm.beliefs.discrete.entered_evidence import multiply
from pgm.beliefs.discrete.tree_plan import TreePlan
from pgm.clustergraph import ClusterGraph
from pgm.evidence.static import BoundStates, scaled
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import LOG_SUM_PRODUCT, SUM_PRODUCT, Semiring, exp


@dataclass(frozen=True, eq=False)
class Entry:
    """The tables with which the pass to the roots begins.

    tables: (entries + columns, [runs]): the tables of the clusters, then room for the sepsets'.
    potentials: (entries, [1]): the clusters' potentials without evidence, the same in all runs.
        They are read for the stacks that are not entered or not active; where all are both, this
        may be `tables` itself.
    entered: The set of the stacks whose `tables` hold potentials times evidence. The tables of the
        other stacks are not filled yet: no evidence enters them, and the pass to the roots takes
        their entries from `potentials`.
    active: The set of the active stacks, which send messages to the roots.
    """

    tables: Array
    potentials: Array
    entered: int
    active: int


@dataclass(frozen=True, eq=False)
class Collected:
    """The messages of the pass to the roots, and the scales taken out of them.

    Messages and tops of stacks that are not active are one.

    messages: (columns, [runs]): each message before it is divided by its top.
    tops: (tops, [runs]): the scales; the product of a tree's tops is p(evidence in the tree).
    """

    messages: Array
    tops: Array


def collect(plan: TreePlan, entry: Entry, semiring: Semiring) -> Collected:
    """Send the messages to the roots, from children to parents; returns them, and all tops.

    `entry` has the tables with the evidence entered, and the set of active stacks. In place, the
    table of each cluster in an active stack becomes the potential times the cluster's evidence and
    the messages from its children. The sum of this product over the variables that the parent does
    not have is the message to the parent.
    """
    tables, potentials, active = entry.tables, entry.potentials, entry.active
    tail = tables.shape[1:]
    room = np.empty((2 * plan.columns + plan.tops, *tail))
    room.fill(semiring.one)
    raw, tops = room[: plan.columns], room[2 * plan.columns :]
    messages = room[plan.columns : 2 * plan.columns] if semiring.linear else raw
    for stack in reversed(plan.stacks):
        if not stack.bit & active:
            continue
        entries = tables[stack.entries]
        matrix = entries.reshape(stack.shape + tail)
        source = entries if stack.bit & entry.entered else potentials[stack.entries]
        taken = stack.top.stop
        for product, senders in zip(stack.absorbed, stack.senders, strict=True):
            if not senders & active:
                continue
            product.multiply(source, messages, semiring, entries)
            source = entries
            # The product of a hub's many messages may underflow although none of them does: their
            # largest entries need not meet. So its table is rescaled after every few, and the
            # hub owns a scale for each time, beside that of its own message.
            if taken < stack.tops.stop and semiring.linear:
                top = stack.largest(np.maximum.reduce(matrix, stack.axis))
                tops[taken : taken + stack.clusters.size] = top
                taken += stack.clusters.size
                np.divide(matrix, stack.by_entry(stack.by_column(top)), out=matrix)
        if source is not entries:
            entries[...] = source
        found = semiring.total(matrix, stack.axis, out=raw[stack.columns])
        if semiring.linear:
            top = stack.largest(found)
            tops[stack.top] = top
            np.divide(found, stack.by_column(top), messages[stack.columns])
        elif stack.down is None:
            tops[stack.top] = found
    return Collected(raw, tops)


def distribute(plan: TreePlan, entry: Entry, done: Collected, semiring: Semiring) -> None:
    """Send the messages back: tables and sepsets become probabilities given the evidence.

    `entry` and `done` are what `collect` was given and returned. ``entry.tables`` is changed in
    place, from the roots down; a root's table is divided by its sum. The table of a sepset is the
    parent's table, summed over the variables outside the sepset. The table of a child that sent a
    message is multiplied by the ratio of the sepset's table to this message. That of a child which
    sent none becomes p(cluster | sepset) times the sepset's table. ``done.messages`` are
    overwritten.
    """
    tables = entry.tables
    tail = tables.shape[1:]
    divisor = done.messages
    # 0/0 becomes 0, for the dividend is zero too.
    np.copyto(divisor, semiring.one, where=divisor == semiring.zero)
    for stack in plan.stacks:
        matrix = tables[stack.entries].reshape(stack.shape + tail)
        if stack.down is None:
            sepset = tables[plan.storage.entries :][stack.columns]
            sepset[...] = semiring.one
        else:
            sepset = stack.down.apply(tables, semiring, tables)
        if stack.bit & entry.active:
            source, ratio = matrix, divisor[stack.columns]
            semiring.over(sepset, ratio, ratio)
        else:
            potentials = entry.potentials[stack.entries]
            source, ratio = potentials.reshape(stack.shape + potentials.shape[1:]), sepset
        semiring.times(source, stack.by_entry(ratio), matrix)


# Entries that are copied at once rather than by stack.
SMALL = 2**12
# Entries of potentials that are kept for the next evidence; those of more are made again, so that
# the largest graphs take their tables once, not twice.
HELD = 2**26


def enter(plan: TreePlan, evidence: BoundStates, semiring: Semiring) -> Entry:
    """The potentials of all clusters, with the evidence of some runs entered, for `collect`.

    With numbers, a cluster's potential is p(cluster | sepset with its parent) without evidence, and
    only the stacks of roots, and those on the ways from the evidence to the roots, are active. With
    logarithms, or in graphs of more than 2²⁶ table entries (`HELD`), potentials are products of
    CPDs, and all stacks are active.

    Raises
    ------
    FloatingPointError
        If the semiring is of numbers, and an entry underflows.
    """
    if plan.storage.entries > HELD:
        tables = plan.storage.potentials(semiring, plan.columns)
        if evidence.runs > 1:
            tables = tables[:, None].repeat(evidence.runs, axis=1)
        multiply(plan.storage, tables, evidence, semiring)
        return Entry(tables, tables, plan.everything, plan.everything)
    potentials: Array | None = plan.storage.logs
    active = plan.everything
    if semiring.linear:
        potentials, active = plan.graph.derived(conditionals, plan), plan.above(evidence)
    if potentials is None:
        raise FloatingPointError
    size = plan.storage.entries
    tail = () if evidence.runs == 1 else (evidence.runs,)
    potentials = potentials[:, None] if tail else potentials
    tables = np.empty((size + plan.columns, *tail))
    entered = plan.everything
    if size <= SMALL:
        tables[:size] = potentials
    else:
        entered = plan.homes_of(evidence)
        for stack in plan.stacks:
            if stack.bit & entered:
                tables[stack.entries] = potentials[stack.entries]
    multiply(plan.storage, tables, evidence, semiring)
    return Entry(tables, potentials, entered, active)


def conditionals(graph: ClusterGraph, plan: TreePlan) -> Array | None:
    """The probabilities p(cluster | sepset with its parent) without evidence, (entries,).

    They serve as potentials, for their product is that of all CPDs. With these potentials the
    message of a cluster to its parent is one everywhere if no evidence enters the cluster or those
    below it, and need not be sent. A root has no sepset: its table is scaled to the sum that the
    product of all factors in its tree has. Returns None if an entry, or that sum, is no number of
    float64.
    """
    try:
        with np.errstate(all="raise"):
            tables = plan.storage.potentials(SUM_PRODUCT, plan.columns)
            prior = Entry(tables, tables, plan.everything, plan.everything)
            done = collect(plan, prior, SUM_PRODUCT)
            distribute(plan, prior, done, SUM_PRODUCT)
            sepsets = SUM_PRODUCT.divisor(tables[plan.storage.entries :])
            logs_of_tops = np.log(done.tops)
            for stack in plan.stacks:
                if stack.down is None:
                    mine = (logs_of_tops[plan.tree_of_top == k] for k in stack.clusters)
                    sepsets[stack.columns] = [math.exp(-math.fsum(logs)) for logs in mine]
                matrix = tables[stack.entries].reshape(stack.shape)
                np.divide(matrix, stack.by_entry(sepsets[stack.columns]), out=matrix)
    except (FloatingPointError, OverflowError):
        return None
    return tables[: plan.storage.entries]


@dataclass(frozen=True, eq=False)
class Calibrated:
    """The tables of all clusters and sepsets after both passes, and the scales taken out.

    tables: (entries + columns, [runs]): probabilities given the evidence, of the clusters, then of
        the sepsets. If the evidence of any run is impossible the tables are not probabilities in
        any run, for no messages were sent back.
    log_tops: (tops, [runs]): the logarithms of the scales taken out of the messages to the roots,
        and of hubs' tables. Their sum over a tree is ln p(evidence in the tree), −∞ if the
        evidence is impossible.
    """

    tables: Array
    log_tops: Array


def calibrate(plan: TreePlan, evidence: BoundStates) -> Calibrated:
    """The tables of clusters and sepsets given the evidence of some runs, and the tops' logarithms.

    They are computed in numbers, and again in logarithms if a number underflows. In a network so
    small that the plan has the joint of all its variables, the tables of a single run without soft
    evidence are summed from this joint instead, without messages.
    """
    if evidence.runs == 1 and not evidence.weights and plan.enumeration is not None:
        tables, total = plan.enumeration.given(evidence.states)
        logs = np.zeros(plan.tops)
        logs[plan.stacks[0].tops.start] = math.log(total) if total > 0.0 else -math.inf
        return Calibrated(tables, logs)
    try:
        with np.errstate(all="raise"):
            return _calibrate(plan, evidence, SUM_PRODUCT)
    except FloatingPointError:
        return _calibrate(plan, evidence, LOG_SUM_PRODUCT)


def log_tops(plan: TreePlan, evidence: BoundStates, done: Collected, semiring: Semiring) -> Array:
    """The logarithms of the tops, (tops, [runs]), with the scales of soft evidence.

    The largest weight, by which `enter` has divided soft evidence, is taken in by the top of the
    root of its variable's tree.
    """
    found = semiring.logs(done.tops)
    if evidence.weights:
        found = found.copy()
    for variable, weights in evidence.weights.items():
        root = plan.forest.roots[plan.storage.homes[variable]]
        _, top = scaled(weights)
        found[int((plan.tree_of_top == root).argmax())] += top if found.ndim > 1 else top[0]
    return found


def _calibrate(plan: TreePlan, evidence: BoundStates, semiring: Semiring) -> Calibrated:
    """The tables and the tops' logarithms after both passes of messages in one semiring.

    Where the semiring is of numbers, the caller lets an underflow raise `FloatingPointError`. With
    logarithms, messages are not sent back if the evidence of any run is impossible.
    """
    entry = enter(plan, evidence, semiring)
    done = collect(plan, entry, semiring)
    tables, logs = entry.tables, log_tops(plan, evidence, done, semiring)
    if not semiring.linear and (logs == -np.inf).any():
        return Calibrated(tables, logs)
    distribute(plan, entry, done, semiring)
    if not semiring.linear:
        exp(tables, out=tables)
    return Calibrated(tables, logs)
