"""Calibrating a tree: both passes, for many runs at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.evidence.discrete import BoundStates
from pgm.inference.discrete.entry import enter
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
    try:
        with np.errstate(all="raise"):
            return _calibrate(plan, evidence, SUM_PRODUCT)
    except FloatingPointError:
        return _calibrate(plan, evidence, LOG_SUM_PRODUCT)


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
