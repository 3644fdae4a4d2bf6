"""Two targets cross, and no reading says whose it is, or whether it is of anything.

In summary.json ``methods.<name>`` has the root mean square error of places [m], filtered and
smoothed, the filter's normalised errors squared a component (`nees`), and the share of runs in
which the targets were swapped or lost at the end (`lost`).
"""

from __future__ import annotations

from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import typer
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.record import Out, Record, Seed
from models import switching
from models.switching import either, first, second

QUICK: dict[str, Any] = {"runs": 20}
VOLUME = 60.0  # metres, over which blips of nothing lie


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=1, help="Crossings that are drawn.")] = 200,
    steps: Annotated[int, typer.Option(min=2, help="Steps of each.")] = 40,
    clutter: Annotated[float, typer.Option(min=0.0, max=0.9, help="Blips of nothing.")] = 0.1,
) -> None:
    """Two targets cross and no reading says whose it is: all that it may be, or the likeliest."""
    record = Record("two_targets", out, seed=seed, runs=runs, steps=steps, clutter=clutter)
    drawn = switching.draw_crossing(runs, steps, clutter, seed)
    methods = {
        "the likeliest, 1": ("likelihood", 1),
        "summed, 1": ("sum", 1),
        "exclusive, 1": ("joint", 1),
        "exclusive, 6": ("joint", 6),
    }
    found, shown = {}, {}
    for name, (association, count) in methods.items():
        posterior = shown[name] = _tracked(drawn, association, count, clutter, steps)
        found[name] = _scores(posterior, drawn)
    record.table(
        f"Errors over {runs} crossings of {steps} steps",
        ("whose a blip is, Gaussians", "filter [m]", "smoother [m]", "NEES", "swapped or lost"),
        [(name, s["filter"], s["smoother"], s["nees"], s["lost"]) for name, s in found.items()],
        about="Root mean square errors of both places, filtered and smoothed; the filter's "
        "normalised squared errors a component, 1 where it is right about its errors; and the "
        "share of runs that end with a place off by more than 3 m, filtered.",
        best={
            "filter [m]": -np.inf,
            "smoother [m]": -np.inf,
            "NEES": 1.0,
            "swapped or lost": -np.inf,
        },
    )
    record.figure(
        _figure(shown["exclusive, 6"], drawn),
        "tracks",
        "The first crossing: what was read, and the places of both targets, smoothed with six "
        "Gaussians, with bands of two deviations; thin black lines are the truth.",
    )
    record.summary(methods=found)


def _tracked(
    drawn: switching.Crossing, association: str, count: int, clutter: float, steps: int
) -> Any:
    options: dict[str, Any] = {"association": association}
    if association == "joint":
        options["gate"] = 0.9999
    if clutter:
        options |= {"spurious": clutter, "volume": VOLUME}
    whose: dict[pgm.Variable, Any] = {either: pgm.unknown([first, second], **options)}
    evidence = {switching.blip: pgm.sightings(drawn.blips, step=drawn.step, given=whose)}
    model = switching.crossing()
    return pgm.smooth(model, evidence, steps=steps, belief=pgm.Gaussians(count))


def _scores(posterior: Any, drawn: switching.Crossing) -> dict[str, float]:
    found = {}
    for kind, own in (("filter", posterior.filtered), ("smoother", posterior)):
        joint = own.joint(first, second)
        error = joint.mean - drawn.truth
        found[kind] = float(np.sqrt((error[..., [0, 2]] ** 2).mean()))
        if kind == "filter":
            white = np.linalg.solve(joint.cov, error[..., None])[..., 0]
            found["nees"] = float((error * white).sum(axis=-1).mean()) / error.shape[-1]
            found["lost"] = float((np.abs(error[:, -1, [0, 2]]).max(axis=-1) > 3.0).mean())
    return found


def _figure(posterior: Any, drawn: switching.Crossing) -> Figure:
    figure, ax = plt.subplots(figsize=(8.0, 4.5), layout="constrained")
    ax.plot(drawn.step, drawn.blips[0, :, 0], ".", color="#999999", label="blips")
    steps = np.arange(drawn.truth.shape[1])
    for k, (variable, colour) in enumerate(((first, "#0072B2"), (second, "#D55E00"))):
        belief = posterior[variable]
        mean, std = belief.mean[0, :, 0], belief.std[0, :, 0]
        ax.fill_between(steps, mean - 2 * std, mean + 2 * std, color=colour, alpha=0.25, lw=0)
        ax.plot(steps, mean, color=colour, label=variable.name)
        ax.plot(steps, drawn.truth[0, :, 2 * k], color="#222222", lw=0.7)
    ax.set(xlabel="step", ylabel="place [m]", ylim=(-20, 20))
    ax.legend(frameon=False)
    plt.close(figure)
    return figure
