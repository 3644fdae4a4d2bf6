"""What a pass of messages over a tree begins with: tables with potentials and evidence put in."""

from __future__ import annotations

import math

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.evidence.discrete import BoundStates
from pgm.inference.discrete.evidence import alone, multiply
from pgm.inference.discrete.tree_passes import Entry, collect, distribute
from pgm.inference.discrete.tree_plan import TreePlan
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import SUM_PRODUCT, Semiring

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
    evidence = alone(evidence)
    if plan.storage.entries > HELD:
        tables = plan.storage.potentials(semiring, plan.columns)
        multiply(plan.storage, tables, evidence, semiring)
        return Entry(tables, tables, plan.everything, plan.everything)
    potentials: Array | None = plan.logs
    active = plan.everything
    if semiring.linear:
        potentials, active = plan.graph.derived(conditionals, plan), plan.above(evidence)
    if potentials is None:
        raise FloatingPointError
    size = plan.storage.entries
    tail = () if evidence.runs == 1 else (evidence.runs,)
    tables = np.empty((size + plan.columns, *tail))
    entered = plan.everything
    if size <= SMALL:
        tables[:size] = potentials[:, None] if tail else potentials
    else:
        entered = plan.homes_of(evidence)
        for stack in plan.stacks:
            if stack.bit & entered:
                own = potentials[stack.entries]
                tables[stack.entries] = own[:, None] if tail else own
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
                each = sepsets[stack.columns]
                matrix = tables[stack.entries].reshape(stack.shape)
                np.divide(matrix, each[:, None] if stack.axis else each, out=matrix)
    except FloatingPointError:
        return None
    return tables[: plan.storage.entries]
