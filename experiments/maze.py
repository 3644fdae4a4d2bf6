"""A robot in a maze that feels the walls of its cell, with one mistake at most.

In summary.json ``filtered`` and ``smoothed`` are probabilities (steps, cells), ``cells`` their
names, ``possible`` how many cells have any, and ``path`` the most probable one.
"""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import pgm.plot
from experiments.record import Out, Record
from experiments.worlds import Located, at_step, locate
from models import worlds
from models.worlds.maze import named

# The drive of four steps, and the step at which the sensor of one side is mistaken.
START = "1,5"
ACTIONS = ("south", "south", "east", "east")
MISTAKEN = {2: "W"}
QUICK: dict[str, Any] = {}


def run(out: Out = None) -> None:
    """A robot that feels walls finds its cell of a maze in four steps, one of them misread."""
    record = Record("maze", out, start=START, actions=ACTIONS, mistaken=MISTAKEN)
    world = worlds.maze()
    truth, readings = drive(world)
    found = locate(world, ACTIONS, readings)
    filtered, smoothed = found.filtered.probabilities, found.smoothed.probabilities
    possible = (filtered > 0.0).sum(axis=-1)
    steps = np.arange(len(truth))
    record.table(
        "What the robot knows of its cell, step by step",
        ("step", "action", "walls read", "cells possible", "p of the right one", "smoothed"),
        [
            (
                k,
                ACTIONS[k - 1] if k else "",
                readings[k] or "",
                int(possible[k]),
                float(filtered[k, cell]),
                float(smoothed[k, cell]),
            )
            for k, cell in zip(steps.tolist(), truth, strict=True)
        ],
        about="Cells possible: with a probability that counts, given the readings so far. p: the "
        "probability of the robot's cell given the readings so far; smoothed: given all.",
    )
    path = [world.cell.states[k] for k in found.path]
    record.note(
        f"most probable path: {' → '.join(path)}; largest difference from the textbook's filter "
        f"and smoother {found.difference:.2g}"
    )
    record.figure(
        _figure(world, found, truth, readings),
        "beliefs",
        "The maze at each step, walls in grey: probabilities of the cells, above given the "
        "readings so far, below given all. Framed: the robot. The wrong reading of step 2 misleads "
        "the filter for a step, the smoother never.",
    )
    record.summary(
        cells=world.cell.states,
        truth=[world.cell.states[k] for k in truth],
        readings=readings,
        filtered=filtered,
        smoothed=smoothed,
        possible=possible,
        path=path,
        log_evidence=found.log_evidence,
        largest_difference=found.difference,
    )


def drive(world: worlds.World) -> tuple[list[int], list[str | None]]:
    """The robot's cells, and what it reads at each step but the first."""
    truth = [world.cell.index(START)]
    for action in ACTIONS:
        truth.append(int(world.motion[truth[-1], world.action.index(action)].argmax()))
    readings: list[str | None] = [None]
    for step, cell in enumerate(truth[1:], start=1):
        felt = [
            wall != (side == MISTAKEN.get(step))
            for wall, side in zip(worlds.walls()[cell], "NESW", strict=True)
        ]
        readings.append(named(felt))
    return truth, readings


def _figure(
    world: worlds.World, found: Located, truth: list[int], readings: list[str | None]
) -> Figure:
    kinds = {"filtered": found.filtered, "smoothed": found.smoothed}
    figure, axes = plt.subplots(
        len(kinds), len(truth), figsize=(3.2 * len(truth), 3.6), layout="constrained"
    )
    for line, (kind, belief) in zip(axes, kinds.items(), strict=True):
        for step, ax in enumerate(line):
            pgm.plot.belief_map(
                at_step(belief, step),
                places=world.places,
                most=1.0,
                truth=truth[step],
                numbers=False,
                outside="#767676",
                ax=ax,
            )
        line[0].set_ylabel(kind)
    for step, ax in enumerate(axes[0]):
        walls = f"{ACTIONS[step - 1]}, feels {readings[step]}" if step else "nothing known"
        mistaken = " (W is wrong)" if step in MISTAKEN else ""
        ax.set_title(f"step {step}: {walls}{mistaken}", fontsize="medium")
    figure.colorbar(axes[0, 0].collections[0], ax=axes, label="probability", shrink=0.8)
    plt.close(figure)
    return figure
