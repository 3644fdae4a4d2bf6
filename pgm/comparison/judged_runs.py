"""Beliefs of a block of runs against their truths: the statistics of a study, by step and run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pgm import consistency
from pgm.comparison.row import proper
from pgm.comparison.tally import Tally
from pgm.consistency.regions import chi_squared
from pgm.factors import Gaussian
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array

if TYPE_CHECKING:
    from pgm.kernels.machine.studies.sums import Moments


class JudgedRuns(NamedTuple):
    """The statistics of a state.

    tallies: ``"error"`` and ``"square"`` by component, ``"nees"``, and ``"held"``, whether a region
        of confidence holds the truth.
    most, last: Of each run, (runs,), its largest NEES, −∞ where it has none, and that at the last
        step at which there is one, NaN where there is none.
    """

    tallies: Mapping[str, Tally]
    most: Array
    last: Array


def judged_runs(belief: Gaussian, truth: Array, confidence: float, *, compiled: bool) -> JudgedRuns:
    """The statistics of beliefs about a state at all steps, (runs, T+1, n), against its truths.

    There is no NEES at steps at which some covariance is singular. `compiled` asks for machine
    code, which is used if there are runs enough for a pack.
    """
    if compiled:
        # Here, as llvmlite may not be installed.
        from pgm.kernels.machine.studies import beliefs, sums

        runs, _, size = belief.mean.shape
        if runs >= sums.LANES and size <= beliefs.LARGEST:
            return _by_machine_code(belief, truth, confidence)
    return _by_arrays(belief, truth, confidence)


def tally_of(values: Array, *, compiled: bool) -> Tally:
    """The moments of values (runs, steps); see `Tally.of`."""
    if compiled:
        from pgm.kernels.machine.studies import sums

        if len(values) >= sums.LANES:
            return _tally(sums.of_values(values), 0)
    return Tally.of(values)


def _by_arrays(belief: Gaussian, truth: Array, confidence: float) -> JudgedRuns:
    # Wrapped, as headings of long drives go beyond a turn.
    angles = belief.scope[0].angle_mask
    errors = consistency.error(belief, difference(truth, np.zeros(1), angles))
    squares = np.full(truth.shape[:-1], np.nan)
    kept = proper(belief)
    if kept.any():
        squares[:, kept] = consistency.nees(belief[..., kept], truth[..., kept, :])
    none = np.isnan(squares)
    held = np.where(none, np.nan, squares <= chi_squared(confidence, truth.shape[-1]))
    values = {"error": errors, "square": errors**2, "nees": squares, "held": held}
    tallies = {name: Tally.of(each) for name, each in values.items()}
    most = np.where(none, -np.inf, squares).max(axis=1)
    last = squares[:, kept][:, -1] if kept.any() else np.full(len(squares), np.nan)
    return JudgedRuns(tallies, most, last)


def _by_machine_code(belief: Gaussian, truth: Array, confidence: float) -> JudgedRuns:
    from pgm.kernels.machine.studies import beliefs

    angles, size = tuple(belief.scope[0].angle_mask.tolist()), truth.shape[-1]
    limit = float(chi_squared(confidence, size))
    found = beliefs.judged(belief.mean, belief.cov, truth, angles, limit)
    cells = {"error": slice(size), "square": slice(size, 2 * size)}
    cells |= {"nees": 2 * size, "held": 2 * size + 1}
    tallies = {name: _tally(found.moments, own) for name, own in cells.items()}
    return JudgedRuns(tallies, found.most, found.last)


def _tally(moments: Moments, cells: int | slice) -> Tally:
    known, mean, spread = (each[:, cells].copy() for each in moments[:3])
    total, number = (each[cells].T for each in moments[3:])
    return Tally.of_sums(known, mean, spread, total, number)
