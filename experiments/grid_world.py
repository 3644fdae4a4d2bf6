"""The lecture's grid world: a Bayes filter by hand, and by the cluster graph.

In summary.json ``belief_1`` is the belief after the lecture's first reading, ``predicted_2`` that
after its second action and before a reading, each as two rows of three, the top row first;
``filtered`` and ``smoothed`` all steps, which are numbered from 0 there: step 0 is the lecture's 1.
"""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.record import Out, Record
from experiments.worlds import Located, at_step, locate
from models import worlds
from models.worlds.grid_world import SHAPE

# The lecture goes as far as the first action; what follows is ours.
ACTIONS = ("south", "east", "north")
READINGS = ("0", "0", "1", "1")
QUICK: dict[str, Any] = {}


def run(out: Out = None) -> None:
    """A robot in a world of six cells: the Bayes filter's numbers, worked out in a lecture."""
    record = Record("grid_world", out, actions=ACTIONS, readings=READINGS)
    world = worlds.grid_world()
    found = locate(world, ACTIONS, READINGS)
    belief, predicted = rows(found.filtered)[0], rows(found.predicted)[1]
    record.table(
        "Beliefs of the lecture, misprints corrected",
        ("row", "left", "middle", "right"),
        [
            (f"{name}, {row}", *numbers)
            for name, both in (("belief 1", belief), ("predicted 2", predicted))
            for row, numbers in zip(("top", "bottom"), both.tolist(), strict=True)
        ],
        about="Probabilities of the six cells, a row of the world a line: belief 1 after the first "
        "reading, predicted 2 after the motion that follows it.",
    )
    record.note(
        "The lecture prints .0504 in the bottom right, where .0336 follows from its rounded "
        "numbers; and nothing needs normalising after a motion. Its pictures of the motion and of "
        "the sensor are lost: ours give its numbers."
    )
    record.note(
        f"most probable path: {' '.join(world.cell.states[k] for k in found.path)}; largest "
        f"difference from the textbook's filter and smoother {found.difference:.2g}"
    )
    record.figure(
        _figure(world, found),
        "beliefs",
        "Probabilities of the six cells, step by step: the column is read, then the robot goes "
        "south, east and north. Above, before a step's reading; in the middle, with it; below, "
        "given all readings.",
    )
    record.summary(
        belief_1=belief,
        predicted_2=predicted,
        filtered=rows(found.filtered),
        smoothed=rows(found.smoothed),
        path=[world.cell.states[k] for k in found.path],
        log_evidence=found.log_evidence,
        largest_difference=found.difference,
    )


def rows(belief: pgm.Table) -> Any:
    """Probabilities of the cells as rows from the top, (steps, 2, 3)."""
    return belief.probabilities.reshape(-1, *SHAPE)


def _figure(world: worlds.World, found: Located) -> Figure:
    kinds = {"predicted": found.predicted, "filtered": found.filtered, "smoothed": found.smoothed}
    steps = len(READINGS)
    figure, axes = plt.subplots(len(kinds), steps, figsize=(3.1 * steps, 6.9), layout="constrained")
    for line, (kind, belief) in zip(axes, kinds.items(), strict=True):
        for step, ax in enumerate(line):
            pgm.plot.belief_map(at_step(belief, step), places=world.places, most=1.0, ax=ax)
        line[0].set_ylabel(kind)
    for step, ax in enumerate(axes[0]):
        action = f"step {step}: {ACTIONS[step - 1]}" if step else "step 0"
        ax.set_title(f"{action}, reads {READINGS[step]}", fontsize="medium")
    figure.colorbar(axes[0, 0].collections[0], ax=axes, label="probability", shrink=0.6)
    plt.close(figure)
    return figure
