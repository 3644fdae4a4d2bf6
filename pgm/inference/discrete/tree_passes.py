"""Messages over a tree of tables, to the roots and back, for many runs at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.evidence.discrete import BoundStates
from pgm.inference.discrete.evidence import enter
from pgm.inference.discrete.tree_plan import Stack, TreePlan
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import LOG_SUM_PRODUCT, SUM_PRODUCT, Semiring


@dataclass(frozen=True, eq=False)
class Collected:
    """What a pass to the roots leaves.

    Attributes
    ----------
    tables : ndarray
        (entries + columns, [runs]): each cluster's table times the messages from its children;
        then room for the sepsets.
    messages : ndarray
        (columns, [runs]): what was summed from the tables.
    tops : ndarray
        (tops, [runs]): the scales taken out of messages, whose product is p(evidence).
    """

    tables: Array
    messages: Array
    tops: Array


def collect(plan: TreePlan, tables: Array, semiring: Semiring) -> Collected:
    """Send the messages to the roots; the tables are overwritten."""
    tail = tables.shape[1:]
    raw = np.empty((plan.columns, *tail))
    messages = np.empty((plan.columns, *tail)) if semiring.linear else raw
    tops = np.full((plan.tops, *tail), semiring.one)
    for stack in reversed(plan.stacks):
        entries = tables[stack.entries]
        matrix = entries.reshape(*stack.shape, *tail)
        own = slice(stack.tops.start, stack.tops.start + stack.clusters.size)
        taken = own.stop
        for product in stack.absorbed:
            product.multiply(entries, messages, semiring)
            # The product of a hub's many messages may underflow although none of them does: their
            # largest entries need not meet. So its table is rescaled after every few, and the
            # hub owns a scale for each time, beside that of its own message.
            if stack.hub and semiring.linear and taken < stack.tops.stop:
                top = _largest(stack, np.maximum.reduce(matrix, stack.axis))
                tops[taken : taken + stack.clusters.size] = top
                taken += stack.clusters.size
                each = top.repeat(stack.widths, 0)
                np.divide(matrix, each[:, None] if stack.axis else each, out=matrix)
        found = semiring.total(matrix, stack.axis, raw[stack.columns])
        if semiring.linear:
            top = _largest(stack, found)
            tops[own] = top
            each = top if stack.clusters.size == 1 else top.repeat(stack.widths, 0)
            np.divide(found, each, messages[stack.columns])
        elif stack.down is None:
            tops[own] = found
    return Collected(tables, raw, tops)


def _largest(stack: Stack, columns: Array) -> Array:
    """The largest of each cluster's columns, (clusters, [runs])."""
    if stack.clusters.size == 1:
        return np.maximum.reduce(columns, 0, keepdims=True)
    if stack.clusters.size == stack.widths.sum():
        return columns
    return np.maximum.reduceat(columns, stack.first, 0)


def distribute(plan: TreePlan, done: Collected, semiring: Semiring) -> None:
    """Send the messages back: tables and sepsets become probabilities."""
    tables = done.tables
    tail = tables.shape[1:]
    divisor = semiring.divisor(done.messages)
    for stack in plan.stacks:
        matrix = tables[stack.entries].reshape(*stack.shape, *tail)
        ratio = divisor[stack.columns]
        if stack.down is None:
            sepset = tables[plan.storage.entries :][stack.columns]
            sepset[...] = semiring.one
        else:
            sepset = stack.down.apply(tables, semiring, tables)
        ratio = semiring.over(sepset, ratio, ratio)
        semiring.times(matrix, ratio[:, None] if stack.axis else ratio, matrix)


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Probabilities of a tree given evidence.

    Attributes
    ----------
    tables : ndarray
        (entries + columns, [runs]): of the clusters, then of the sepsets.
    log_tops : ndarray
        (tops, [runs]): logarithms of scales, whose sum over a tree is its ln p(evidence); −∞ where
        that is impossible.
    """

    tables: Array
    log_tops: Array


def calibrate(plan: TreePlan, evidence: BoundStates) -> Calibrated:
    """Both passes: with numbers, or where one would be lost to underflow with logarithms."""
    try:
        with np.errstate(all="raise"):
            return _calibrate(plan, evidence, SUM_PRODUCT)
    except FloatingPointError:
        return _calibrate(plan, evidence, LOG_SUM_PRODUCT)


def _calibrate(plan: TreePlan, evidence: BoundStates, semiring: Semiring) -> Calibrated:
    tables = enter(plan, evidence, semiring)
    done = collect(plan, tables, semiring)
    log_tops = semiring.logs(done.tops)
    if not semiring.linear and (log_tops == -np.inf).any():
        return Calibrated(tables, log_tops)
    distribute(plan, done, semiring)
    if not semiring.linear:
        with np.errstate(under="ignore"):
            np.exp(tables, out=tables)
    return Calibrated(tables, log_tops)
