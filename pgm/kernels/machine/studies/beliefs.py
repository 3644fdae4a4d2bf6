"""Errors and NEES of Gaussian beliefs about truths that are known, summed over runs by step."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from pgm.kernels import step as steps_of
from pgm.kernels.arrays import Array, address
from pgm.kernels.machine.emitter.kinds import ADDRESS, FLOAT
from pgm.kernels.machine.emitter.memory import Memory, Runs
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.matrices.lines import Lines
from pgm.kernels.machine.studies.sums import (
    LANES,
    Cells,
    Given,
    Moments,
    Row,
    each_pack,
    padded,
    table,
)
from pgm.kernels.numbers import Matrix, most, where
from pgm.kernels.roots import NEGLIGIBLE

# The components from which on code in straight lines is long.
LARGEST = 12


class Judged(NamedTuple):
    """Sums over runs, and of each run its largest NEES and its last one.

    `moments` have the cells: the errors, their squares, the NEES, and whether the region of
    confidence holds the truth. The NEES and that are NaN at steps at which some covariance is
    singular; a run without any has −∞ for the largest, and NaN for the last.
    """

    moments: Moments
    most: Array
    last: Array


def judged(mean: Array, cov: Array, truth: Array, angles: tuple[bool, ...], limit: float) -> Judged:
    """The errors of means (runs, steps, n), and eᵀ P⁻¹ e, of truths of this shape.

    There are `LANES` runs at least and `LARGEST` components at most. Of components that are
    `angles` errors are wrapped; regions of confidence hold a NEES up to `limit`.
    """
    runs, steps, size = mean.shape
    width = padded(runs)
    cells = 2 * size + 2
    found, rows = Moments.empty(steps, cells, runs), np.full((cells, width), np.nan)
    largest, last = np.full(width, -np.inf), np.full(width, np.nan)
    arrays = [Cells.of(each) for each in (mean, cov, truth)]
    given = table(steps, runs, width, *arrays, rows, *found, largest, last)
    beside = tuple(each.across == 1 for each in arrays)
    _judged(angles, beside)(address(given), limit)
    return Judged(found.of(slice(None), runs), largest[:runs], last[:runs])


@lru_cache(maxsize=32)
def _judged(angles: tuple[bool, ...], beside: tuple[bool, ...]) -> Callable[[int, float], None]:
    code = Module().function("judged", (ADDRESS, FLOAT), lanes=LANES)
    given, limit, lines, size = Given(code, code.arguments[0]), code.arguments[1], Lines(code), 0
    size = len(angles)
    steps, runs, width = given.whole(), given.whole(), given.whole()
    means, covs, truths = (given.array(Runs.BESIDE if each else Runs.APART) for each in beside)
    rows = Memory(code, given.address())
    row = Row(code, width, rows, [given.address() for _ in Moments._fields])
    largest, last = given.address(), given.address()
    nees, held = 2 * size, 2 * size + 1
    with code.loop(steps) as step:
        proper = code.varying(True)
        with each_pack(code, runs) as run:
            mean, truth = (lines.column(each(step, run), size) for each in (means, truths))
            found = figures(lines, mean, lines.symmetric(covs(step, run), size), truth, angles)
            for k, error in enumerate(found.errors):
                row.at(k, run).store(0, error)
                row.at(size + k, run).store(0, error * error)
            proper.set(proper.get() & found.proper)
            row.at(nees, run).store(0, found.nees)
            row.at(held, run).store(0, (found.nees <= limit).number())
        with code.when(code.every(proper.get())), each_pack(code, runs) as run:
            square = row.at(nees, run).load(0)
            kept = Memory(code, largest + run)
            kept.store(0, most(kept.load(0), square))
            Memory(code, last + run).store(0, square)
        with code.otherwise(), each_pack(code, runs) as run:
            for cell in (nees, held):
                row.at(cell, run).store(0, math.nan)
        row.add(step, 2 * size + 2)
    return code.module.compile().callable("judged")


class Figures(NamedTuple):
    """The figures of a belief about a truth: errors, the NEES, and whether its covariance is one.

    The NEES is of no use where the covariance is singular.
    """

    errors: list[Any]
    nees: Any
    proper: Any


def figures(
    lines: Lines, mean: Matrix, cov: Matrix, truth: Matrix, angles: tuple[bool, ...]
) -> Figures:
    """The figures of a belief of the runs at hand; see `judged`."""
    off = lines.beside(mean - truth)
    errors = [_wrapped(e) if turns else e for e, turns in zip(off, angles, strict=True)]
    root = cov.root()
    white = root.solve(Matrix.column(errors))
    return Figures(errors, (white.T @ white)[0, 0], root.share > NEGLIGIBLE)


def _wrapped(angle: Any) -> Any:
    """An angle moved by whole turns into [−π, π)."""
    inside = angle - steps_of.turns(angle)
    return where(inside >= math.pi, -math.pi, inside)
