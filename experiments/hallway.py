"""A robot in a corridor with doors that look alike: beliefs of many peaks, which become one.

In summary.json ``truth``, ``actions`` and ``readings`` are the drive, ``path`` the most probable
cells, ``at_truth.<filter|smoother>`` the mean probability of the right cell over the steps, and
``peak`` the fraction of steps whose most probable cell is at most one from the right one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import typer
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.record import Out, Record, Seed
from experiments.worlds import Located, locate
from models import worlds
from models.worlds.hallway import DOORS

Integers = npt.NDArray[np.int_]

QUICK: dict[str, Any] = {}


def run(
    out: Out = None,
    seed: Seed = 0,
    steps: Annotated[int, typer.Option(min=1, help="Steps of the drive.")] = 20,
) -> None:
    """A robot that tells doors from walls finds out where in a corridor it is."""
    record = Record("hallway", out, seed=seed, steps=steps, doors=DOORS)
    world = worlds.hallway()
    truth, readings = drive(world, steps, seed)
    found = locate(world, ["ahead"] * steps, readings)
    at_truth, peak = {}, {}
    for kind, belief in (("filter", found.filtered), ("smoother", found.smoothed)):
        chances = belief.probabilities
        at_truth[kind] = float(chances[np.arange(steps + 1), truth].mean())
        peak[kind] = float((np.abs(chances.argmax(axis=-1) - truth) <= 1).mean())
    record.table(
        f"How well the robot knows its cell, over {steps} steps",
        ("belief", "probability of the right cell", "peak at it or beside it"),
        [(kind, at_truth[kind], peak[kind]) for kind in at_truth],
        about="Means over steps: of the probability of the cell the robot is in, and the share of "
        "steps whose most probable cell is that one or one beside it.",
        best={"probability of the right cell": np.inf, "peak at it or beside it": np.inf},
    )
    record.note(
        f"largest difference from the textbook's filter and smoother {found.difference:.2g}"
    )
    record.figure(
        _figure(found, truth, readings),
        "beliefs",
        "A step a row: bars are probabilities of the cells, filtered and smoothed. Shaded: the "
        "cells with a door; right: what was read; dotted: the robot. The first door may be any of "
        "them; the smoother knows which, since it knows what came later.",
    )
    record.summary(
        truth=truth,
        readings=readings,
        filtered=found.filtered.probabilities,
        smoothed=found.smoothed.probabilities,
        path=found.path,
        at_truth=at_truth,
        peak=peak,
        log_evidence=found.log_evidence,
        largest_difference=found.difference,
    )


def drive(world: worlds.World, steps: int, seed: int) -> tuple[Integers, list[str]]:
    """Cells (T+1,) and readings of steps 0..T of a robot that starts at the first door."""
    start = np.eye(world.cell.size)[DOORS[0]]
    model = replace(world, prior=start).network()
    ahead = [world.action.index("ahead")] * steps
    sights = pgm.sightings(step=np.arange(steps + 1))
    sample = model.sample({world.action: ahead, world.reading: sights}, steps=steps, rng=seed)
    seen = np.asarray(sample[world.reading], dtype=np.int_).tolist()
    return np.asarray(sample[world.cell]), [world.reading.states[k] for k in seen]


def _figure(found: Located, truth: Integers, readings: list[str]) -> Figure:
    count = len(truth)
    figure, ax = plt.subplots(figsize=(9.0, 1.0 + 0.45 * count), layout="constrained")
    for door in DOORS:
        ax.axvspan(door - 0.5, door + 0.5, color="#EEEEEE", zorder=0.5)
    steps = range(count)
    full = max(found.filtered.probabilities.max(), found.smoothed.probabilities.max())
    shared: dict[str, Any] = {"steps": steps, "ax": ax}
    pgm.plot.beliefs_over_time(
        found.filtered, label="filtered", truth=truth, full=float(full), **shared
    )
    pgm.plot.beliefs_over_time(found.smoothed, label="smoothed", **shared)
    ax.set_xlabel("cell")
    for step, reading in enumerate(readings):
        ax.annotate(
            reading, (1.01, step - 0.2), xycoords=ax.get_yaxis_transform(), fontsize="small"
        )
    plt.close(figure)
    return figure
