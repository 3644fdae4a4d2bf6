"""A robot that hears two beacons on its line may be on either side of it: both modes are found.

In summary.json ``weights``, ``modes`` and ``divergence`` have a number for each drive: the weight
of the likelier mode, how many modes were found, and the KL divergence of a grid's belief at the
last step from the mixture [nats]; ``one`` is that from the likelier mode alone, ``adapted`` that
from the mixture as draws have adapted it. ``mean_divergence`` and ``mean_adapted`` are their means
over drives, ``found_both`` the share of drives in which two modes were found.
"""

from __future__ import annotations

from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import typer
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.record import Out, Record, Seed, progress
from models import switching
from models.switching import beacon, place, push, range_to

QUICK: dict[str, Any] = {"drives": 2}
STEPS = 20
BEACONS = np.array([[-3.0, 0.0], [2.0, 0.0]])
CELLS: dict[str | pgm.Variable, Any] = {"east": (-4, 5, 240), "north": (-4, 4, 220)}
Array = npt.NDArray[np.float64]


def run(
    out: Out = None,
    seed: Seed = 0,
    drives: Annotated[int, typer.Option(min=1, help="Drives that are drawn.")] = 10,
    starts: Annotated[int, typer.Option(min=1, help="Smoothers of each.")] = 8,
) -> None:
    """Ranges to two beacons leave two places open: smoothers from several starts find both."""
    record = Record("mirror", out, seed=seed, drives=drives, starts=starts)
    model = switching.mirrored()
    asked = {
        push: np.tile([0.05, 0.0], (STEPS, 1)),
        range_to: pgm.sightings(
            step=np.repeat(np.arange(1, STEPS + 1), 2),
            given={beacon: np.tile(BEACONS, (STEPS, 1))},
        ),
    }
    weights, modes, divergence, adapted, one = [], [], [], [], []
    first: Any = None
    for drive in progress(range(drives), "drives"):
        evidence = model.sample(asked, rng=seed + drive).evidence
        both = pgm.smooth(model, evidence, belief=pgm.Gaussians(4, starts=starts))
        drawn = pgm.smooth(model, evidence, belief=pgm.Gaussians(4, starts=starts, draws=4000))
        cells = pgm.filter(model, evidence, belief=pgm.Grid(CELLS))[place.at(STEPS)]
        last = both[place.at(STEPS)]
        better = drawn[place.at(STEPS)]
        first = first or (cells, better)
        weights.append(float(last.weights.max()))
        modes.append(int(both.status.modes))
        divergence.append(_divergence(cells, last.log_density))
        adapted.append(_divergence(cells, better.log_density))
        likelier = last.components[int(last.weights.argmax())]
        one.append(_divergence(cells, likelier.log_density))
    record.table(
        f"Modes of {drives} drives, by {starts} starts",
        ("drive", "modes", "weight of the likelier", "KL", "with draws", "of one mode"),
        [
            (drive, *row)
            for drive, row in enumerate(zip(modes, weights, divergence, adapted, one, strict=True))
        ],
        about="How many modes were found; the weight of the likelier of them; and the divergences "
        "of a grid's belief at the last step from the mixture, from the mixture as 4,000 draws "
        "have adapted it, and from the likelier mode alone, in nats.",
        best={"KL": -np.inf, "with draws": -np.inf, "of one mode": -np.inf},
    )
    record.figure(
        _figure(*first),
        "sides",
        "The first drive's last step: probabilities of cells by a grid, the beacons as triangles, "
        "and 95 % ellipses of the modes, adapted by draws, as dark as they weigh.",
    )
    record.summary(
        weights=weights,
        modes=modes,
        divergence=divergence,
        adapted=adapted,
        one=one,
        mean_divergence=float(np.mean(divergence)),
        mean_adapted=float(np.mean(adapted)),
        found_both=float(np.mean(np.array(modes) == 2)),
    )


def _divergence(cells: Any, log_density: Any) -> float:
    """KL of a grid's belief from a density, in nats."""
    edges = [np.linspace(low, high, count + 1) for low, high, count in CELLS.values()]
    centres = np.stack(np.meshgrid(*((e[1:] + e[:-1]) / 2 for e in edges), indexing="ij"), -1)
    area = np.prod([e[1] - e[0] for e in edges])
    chance = np.asarray(cells.values)
    some = chance > 1e-14
    logs = log_density(centres[some]) + np.log(area)
    return float((chance[some] * (np.log(chance[some]) - logs)).sum())


def _figure(cells: Any, mixture: Any) -> Figure:
    figure, ax = plt.subplots(figsize=(8.0, 4.6), layout="constrained")
    pgm.plot.grid_map(cells, unit="m", ax=ax)
    ax.plot(*BEACONS.T, "^", color="#222222", label="beacons")
    pgm.plot.ellipses(mixture, colour="#D55E00", label="modes", ax=ax)
    ax.legend(frameon=False, loc="upper right")
    ax.set_aspect("equal", adjustable="box")
    ax.set(xlim=(-3.6, 2.6), ylim=(-1.6, 1.6))
    plt.close(figure)
    return figure
