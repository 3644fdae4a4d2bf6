"""Messages over a tree of tables: towards the roots, and back."""

import math
from dataclasses import dataclass

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.evidence.static import BoundStates
from pgm.inference.discrete.entered_evidence import multiply
from pgm.inference.discrete.tree_plan import TreePlan
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import LOG_SUM_PRODUCT, SUM_PRODUCT, Semiring, exp


@dataclass(frozen=True, eq=False)
class Entry:
    """The tables with which a pass to the roots begins.

    tables: (entries + columns, [runs]): of the clusters, and room for the sepsets behind them.
    potentials: (entries, [1]): without evidence.
    entered: The set of the stacks whose tables hold potentials times evidence; others are empty,
        and have no evidence of their own.
    active: The set of the stacks that send messages to the roots. Those of others are one: their
        potentials are probabilities given the sepsets to their parents, and below them there is no
        evidence.
    """

    tables: Array
    potentials: Array
    entered: int
    active: int


@dataclass(frozen=True, eq=False)
class Collected:
    """The tables and messages after the upward pass.

    messages: (columns, [runs]): what was summed from the tables.
    tops: (tops, [runs]): the scales taken out of messages, whose product is p(evidence).
    """

    messages: Array
    tops: Array


def collect(plan: TreePlan, entry: Entry, semiring: Semiring) -> Collected:
    """Upward pass: each table, times its children's messages, is summed to its parent's message."""
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
        found = semiring.total(matrix, stack.axis, raw[stack.columns])
        if semiring.linear:
            top = stack.largest(found)
            tops[stack.top] = top
            np.divide(found, stack.by_column(top), messages[stack.columns])
        elif stack.down is None:
            tops[stack.top] = found
    return Collected(raw, tops)


def distribute(plan: TreePlan, entry: Entry, done: Collected, semiring: Semiring) -> None:
    """Send the messages back: tables and sepsets become probabilities."""
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
    """The tables of some runs, ready for `collect`.

    Raises
    ------
    FloatingPointError
        If an entry is too small for a number.
    """
    if plan.storage.entries > HELD:
        tables = plan.storage.potentials(semiring, plan.columns)
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
    """Without evidence, the probabilities of each cluster given the sepset to its parent.

    Potentials like the products of CPDs; but without evidence their messages to the roots are one,
    so that none has to be sent but from where there is some. Those of a root sum to what the
    product of its tree's CPDs sums to. None if an entry is too small for a number.
    """
    try:
        with np.errstate(all="raise"):
            tables = plan.storage.potentials(SUM_PRODUCT, plan.columns)
            prior = Entry(tables, tables, plan.everything, plan.everything)
            done = collect(plan, prior, SUM_PRODUCT)
            distribute(plan, prior, done, SUM_PRODUCT)
            sepsets = SUM_PRODUCT.divisor(tables[plan.storage.entries :])
            log_tops = np.log(done.tops)
            for stack in plan.stacks:
                if stack.down is None:
                    mine = (log_tops[plan.tree_of_top == k] for k in stack.clusters)
                    sepsets[stack.columns] = [math.exp(-math.fsum(logs)) for logs in mine]
                matrix = tables[stack.entries].reshape(stack.shape)
                np.divide(matrix, stack.by_entry(sepsets[stack.columns]), out=matrix)
    except FloatingPointError:
        return None
    return tables[: plan.storage.entries]


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Probabilities of a tree given evidence.

    tables: (entries + columns, [runs]): of the clusters, then of the sepsets.
    log_tops: (tops, [runs]): logarithms of scales, whose sum over a tree is its ln p(evidence); −∞
        where that is impossible.
    """

    tables: Array
    log_tops: Array


def calibrate(plan: TreePlan, evidence: BoundStates) -> Calibrated:
    """Both passes: with numbers, or where one would be lost to underflow with logarithms."""
    if evidence.runs == 1 and not evidence.weights and plan.enumeration is not None:
        tables, total = plan.enumeration.given(evidence.states)
        log_tops = np.zeros(plan.tops)
        log_tops[plan.stacks[0].tops.start] = math.log(total) if total > 0.0 else -math.inf
        return Calibrated(tables, log_tops)
    try:
        with np.errstate(all="raise"):
            return _calibrate(plan, evidence, SUM_PRODUCT)
    except FloatingPointError:
        return _calibrate(plan, evidence, LOG_SUM_PRODUCT)


def _calibrate(plan: TreePlan, evidence: BoundStates, semiring: Semiring) -> Calibrated:
    """Both passes over a tree in one semiring; only the first, where the evidence is impossible."""
    entry = enter(plan, evidence, semiring)
    done = collect(plan, entry, semiring)
    tables, log_tops = entry.tables, semiring.logs(done.tops)
    if not semiring.linear and (log_tops == -np.inf).any():
        return Calibrated(tables, log_tops)
    distribute(plan, entry, done, semiring)
    if not semiring.linear:
        exp(tables, out=tables)
    return Calibrated(tables, log_tops)
