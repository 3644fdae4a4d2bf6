"""Calibrating a tree: both passes, for many runs at once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pgm.evidence.discrete import BoundStates
from pgm.inference.discrete.entry import enter
from pgm.inference.discrete.enumeration import Enumeration
from pgm.inference.discrete.evidence import states_of_one
from pgm.inference.discrete.tree_passes import collect, distribute
from pgm.inference.discrete.tree_plan import TreePlan
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import LOG_SUM_PRODUCT, SUM_PRODUCT, Semiring


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
    if evidence.runs == 1 and not evidence.weights and plan.enumeration is not None:
        return _enumerated(plan, plan.enumeration, evidence)
    try:
        with np.errstate(all="raise"):
            return _calibrate(plan, evidence, SUM_PRODUCT)
    except FloatingPointError:
        return _calibrate(plan, evidence, LOG_SUM_PRODUCT)


def _enumerated(plan: TreePlan, enumeration: Enumeration, evidence: BoundStates) -> Calibrated:
    tables, total = enumeration.given(states_of_one(evidence))
    log_tops = np.zeros(plan.tops)
    log_tops[plan.stacks[0].tops.start] = math.log(total) if total > 0.0 else -math.inf
    return Calibrated(tables, log_tops)


def _calibrate(plan: TreePlan, evidence: BoundStates, semiring: Semiring) -> Calibrated:
    entry = enter(plan, evidence, semiring)
    done = collect(plan, entry, semiring)
    tables, log_tops = entry.tables, semiring.logs(done.tops)
    if not semiring.linear and (log_tops == -np.inf).any():
        return Calibrated(tables, log_tops)
    distribute(plan, entry, done, semiring)
    if not semiring.linear:
        with np.errstate(under="ignore"):
            np.exp(tables, out=tables)
    return Calibrated(tables, log_tops)
