"""What a weight tells of a group and of a height: a mixture of two Gaussians, in one network.

In summary.json ``weights`` [kg] are those asked for, ``chance`` the probabilities of the first
group given each, ``height`` and ``std`` [cm] the moments of the height.
"""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.record import Out, Record
from models import mixed

QUICK: dict[str, Any] = {}
ASKED = (55.0, 70.0, 85.0)


def run(out: Out = None) -> None:
    """A weight tells of the group someone belongs to, and both of a height."""
    record = Record("height_and_group", out)
    graph = pgm.compile(mixed.height_and_group())
    posterior = pgm.infer(graph, {mixed.weight: np.array(ASKED)[:, None]})
    chance = posterior[mixed.group].probabilities[:, 0]
    heights = posterior[mixed.height]
    record.table(
        "Given a weight",
        ("weight [kg]", "p(f)", "height [cm]", "± [cm]"),
        list(zip(ASKED, chance, heights.mean[:, 0], heights.std[:, 0], strict=True)),
        about="The probability of the first group, and the mean and standard deviation of the "
        "height, which is a mixture of two Gaussians.",
    )
    record.figure(
        _figure(graph, heights),
        "heights",
        "Left: the probability of the first group by weight. Right: the density of the height "
        "given three weights; dashed are the parts of the groups.",
    )
    record.summary(
        weights=list(ASKED),
        chance=chance.tolist(),
        height=heights.mean[:, 0].tolist(),
        std=heights.std[:, 0].tolist(),
    )


def _figure(graph: Any, heights: Any) -> Figure:
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.0), layout="constrained")
    weights = np.linspace(40.0, 110.0, 141)
    known = pgm.infer(graph, {mixed.weight: weights[:, None]})[mixed.group]
    left.plot(weights, known.probabilities[:, 0], color="#222222")
    left.set(xlabel="weight [kg]", ylabel="p(f | weight)", ylim=(0.0, 1.0))
    places = np.linspace(140.0, 205.0, 261)
    for k, (asked, colour) in enumerate(zip(ASKED, ("#0072B2", "#D55E00", "#009E73"), strict=True)):
        own = heights[k]
        whole = np.exp(own.log_density(places[:, None]))
        right.plot(places, whole, color=colour, label=f"{asked:.0f} kg")
        for part, share in enumerate(own.weights):
            density = share * np.exp(own.components[part].log_density(places[:, None]))
            right.plot(places, density, "--", color=colour, lw=0.8)
    right.set(xlabel="height [cm]", ylabel="density [1/cm]", ylim=(0.0, None))
    right.legend(frameon=False, title="given")
    plt.close(figure)
    return figure
