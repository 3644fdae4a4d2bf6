"""The exercise on a grid, and every lineariser's distance from it."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

import pgm
from experiments.freiburg import exercise
from experiments.freiburg.exercise import LINEARISERS
from experiments.freiburg.log import Log

# The motion's deviations a step are .45 m and 8 degrees, a range's .7 m. Cells half as wide change
# no filter's mean KL by more than .2 %.
CELL, TURN = 0.4, 7.5  # m, degrees
MARGIN = 6.0  # m, around the landmarks and the start


@dataclass(frozen=True, eq=False)
class Gridded:
    """The exercise on a grid.

    Attributes
    ----------
    posterior : Posterior
        Smoothed; ``.filtered`` is its forward sweep.
    seconds : float
        Of filter and smoother together.
    """

    posterior: pgm.results.Posterior
    seconds: float


def cells(log: Log) -> pgm.Grid:
    """A grid around the landmarks and the start; beliefs are kept as float32."""
    places = np.array([(0.0, 0.0), *log.landmarks])
    low, high = places.min(axis=0) - MARGIN, places.max(axis=0) + MARGIN
    count = np.ceil((high - low) / CELL).astype(int)
    return pgm.Grid(
        {
            "east": (low[0], low[0] + CELL * count[0], int(count[0])),
            "north": (low[1], low[1] + CELL * count[1], int(count[1])),
            "heading": round(360.0 / TURN),
        },
        dtype=np.float32,
    )


def gridded(log: Log) -> Gridded:
    """The smoothed posterior on the grid.

    Parameters
    ----------
    log : Log
    """
    began = time.perf_counter()
    posterior = pgm.smooth(exercise.network(), log.evidence, belief=cells(log))
    return Gridded(posterior, time.perf_counter() - began)


def compared(
    log: Log, posterior: pgm.results.Posterior, *, grouped: bool = False
) -> pgm.results.Comparison:
    """Every lineariser, as filter and as smoother, beside the grid.

    Parameters
    ----------
    log : Log
    posterior : Posterior
        Smoothed. The model is one, however its ranges are linearised.
    grouped : bool
        Whether sigma points see the ranges of a step as one vector.
    """
    model = exercise.network(grouped=grouped)
    return pgm.compare(model, log.evidence, linearisers=LINEARISERS, oracle=posterior)
