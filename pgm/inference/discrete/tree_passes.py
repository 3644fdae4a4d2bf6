"""Messages over a tree of tables, to the roots and back, for many runs at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.inference.discrete.tree_plan import Stack, TreePlan
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import Semiring


@dataclass(frozen=True, eq=False)
class Entry:
    """What a pass to the roots begins with.

    Attributes
    ----------
    tables : ndarray
        (entries + columns, [runs]): of the clusters, and room for the sepsets behind them.
    potentials : ndarray
        (entries,): without evidence.
    entered : int
        The set of the stacks whose tables hold potentials times evidence; others are empty, and
        have no evidence of their own.
    active : int
        The set of the stacks that send messages to the roots. Those of others are one: their
        potentials are probabilities given the sepsets to their parents, and below them there is no
        evidence.
    """

    tables: Array
    potentials: Array
    entered: int
    active: int


@dataclass(frozen=True, eq=False)
class Collected:
    """What a pass to the roots leaves.

    Attributes
    ----------
    messages : ndarray
        (columns, [runs]): what was summed from the tables.
    tops : ndarray
        (tops, [runs]): the scales taken out of messages, whose product is p(evidence).
    """

    messages: Array
    tops: Array


def collect(plan: TreePlan, entry: Entry, semiring: Semiring) -> Collected:
    """Send the messages to the roots: tables are multiplied by those of the children."""
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
        source = entries
        if not stack.bit & entry.entered:
            source = potentials[stack.entries, None] if tail else potentials[stack.entries]
        taken = stack.top.stop
        for product, senders in zip(stack.absorbed, stack.senders, strict=True):
            if not senders & active:
                continue
            product.multiply(source, messages, semiring, entries)
            source = entries
            # The product of a hub's many messages may underflow although none of them does: their
            # largest entries need not meet. So its table is rescaled after every few, and the
            # hub owns a scale for each time, beside that of its own message.
            if stack.hub and semiring.linear and taken < stack.tops.stop:
                top = _largest(stack, np.maximum.reduce(matrix, stack.axis))
                tops[taken : taken + stack.clusters.size] = top
                taken += stack.clusters.size
                each = top if stack.narrow else top.repeat(stack.widths, 0)
                np.divide(matrix, each[:, None] if stack.axis else each, out=matrix)
        if source is not entries:
            entries[...] = source
        found = semiring.total(matrix, stack.axis, raw[stack.columns])
        if semiring.linear:
            top = _largest(stack, found)
            tops[stack.top] = top
            each = top if stack.single or stack.narrow else top.repeat(stack.widths, 0)
            np.divide(found, each, messages[stack.columns])
        elif stack.down is None:
            tops[stack.top] = found
    return Collected(raw, tops)


def _largest(stack: Stack, columns: Array) -> Array:
    """The largest of each cluster's columns, (clusters, [runs])."""
    if stack.narrow:
        return columns
    if stack.single:
        top: Array = np.maximum.reduce(columns, 0)
        return top[None]
    return np.maximum.reduceat(columns, stack.first, 0)


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
            source, ratio = entry.potentials[stack.entries].reshape(stack.shape), sepset
            source = source[..., None] if tail else source
        semiring.times(source, ratio[:, None] if stack.axis else ratio, matrix)
