"""A robot in a world of cells, located by the network and by the textbook."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.kinds import as_table
from experiments.textbook import bayes_filter, discrete_bayes_filter, discrete_smoother
from models.worlds import World

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class Located:
    """Beliefs of the robot's cell, over steps 0..T.

    Attributes
    ----------
    predicted, filtered, smoothed : Table
        (T+1, K): before a step's reading, after it, and given all readings.
    path : ndarray
        (T+1,): the most probable cells, all of them together.
    log_evidence : float
        ln p(z).
    difference : float
        The largest one of filtered and smoothed probabilities and of ln p(z) from the textbook's.
    """

    predicted: pgm.Table
    filtered: pgm.Table
    smoothed: pgm.Table
    path: Integers
    log_evidence: float
    difference: float


def locate(world: World, actions: Sequence[str], readings: Sequence[str | None]) -> Located:
    """Filter, smooth, and find the most probable path.

    Parameters
    ----------
    world : World
    actions : sequence of str
        Of steps 1..T.
    readings : sequence of str
        Of steps 0..T; None was not taken.
    """
    x, z = world.cell, world.reading
    model = world.network()
    seen = np.array([-1 if reading is None else z.index(reading) for reading in readings])
    evidence: dict[pgm.Variable, Any] = {
        world.action: [world.action.index(action) for action in actions],
        z: pgm.sightings(seen, step=np.arange(len(readings))),
    }
    posterior = pgm.smooth(model, evidence)
    best = pgm.most_probable(pgm.compile(model, steps=len(actions)), evidence)
    found = as_table(posterior.filtered[x]), as_table(posterior[x])
    log_evidence = float(posterior.log_evidence)
    filtered, smoothed, log_density = textbook(world, actions, readings)
    difference = max(
        float(np.abs(found[0].values - filtered).max()),
        float(np.abs(found[1].values - smoothed).max()),
        abs(log_evidence - log_density),
    )
    return Located(
        as_table(posterior.predicted[x]),
        *found,
        path=np.asarray(best.assignment[x]),
        log_evidence=log_evidence,
        difference=difference,
    )


def textbook(
    world: World, actions: Sequence[str], readings: Sequence[str | None]
) -> tuple[Array, Array, float]:
    """Filtered and smoothed beliefs (T+1, K) and ln p(z) by Algorithm 1 and its smoother."""
    u = [world.action.index(action) for action in actions]
    z = [-1 if reading is None else world.reading.index(reading) for reading in readings]
    weighed = world.prior * (world.sensor[:, z[0]] if z[0] >= 0 else 1.0)
    initial = weighed / weighed.sum()
    one_step = partial(discrete_bayes_filter, motion=world.motion, sensor=world.sensor)
    steps = bayes_filter(one_step, initial, u, z[1:])
    log_density = float(np.log(weighed.sum())) + sum(step.log_density for step in steps)
    filtered = np.array([initial, *(step.filtered for step in steps)])
    return filtered, np.array(discrete_smoother(initial, steps)), log_density


def at_step(belief: pgm.Table, step: int) -> pgm.Table:
    """The belief of one step, of beliefs over steps."""
    return pgm.Table(belief.scope, belief.probabilities[step])
