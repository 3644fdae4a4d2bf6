"""A target that turns now and then: which of its motions holds when, and where it is.

In summary.json ``methods.<name>`` has the root mean square errors of places, filtered and smoothed
[m], the smoother's normalised errors squared a component (`nees`), the share of steps in whose
likeliest mode the target was (`right`), and the log-evidence, all as means over runs.
"""

from __future__ import annotations

from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import typer
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.path_errors import PLACE, errors
from experiments.record import Out, Record, Seed
from models import switching
from models.networks import target

QUICK: dict[str, Any] = {"runs": 20}


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=1, help="Targets that are drawn.")] = 200,
    steps: Annotated[int, typer.Option(min=2, help="Steps of each.")] = 80,
) -> None:
    """A target turns now and then: one motion, the interacting multiple model, and others."""
    record = Record("manoeuvre", out, seed=seed, runs=runs, steps=steps)
    model = switching.manoeuvring()
    drawn = model.sample(steps=steps, runs=runs, rng=seed)
    methods = {
        "one motion": None,
        "IMM": pgm.Gaussians(mix=True),
        "3 Gaussians": pgm.Gaussians(),
        "9 Gaussians": pgm.Gaussians(9),
    }
    found: dict[str, dict[str, float]] = {}
    shown = {}
    for name, belief in methods.items():
        own = switching.one_motion() if belief is None else model
        posterior = shown[name] = pgm.smooth(own, drawn.evidence, belief=belief)
        found[name] = _scores(posterior, drawn, with_modes=belief is not None)
    record.table(
        f"Errors over {runs} targets and {steps} steps",
        ("method", "filter [m]", "smoother [m]", "NEES", "right mode", "ln p"),
        [
            (name, s["filter"], s["smoother"], s["nees"], s.get("right", "–"), s["log_evidence"])
            for name, s in found.items()
        ],
        about="Root mean square errors of places, filtered and smoothed; the smoother's "
        "normalised squared errors a component, 1 where it is right about its errors; the share of "
        "steps whose likeliest mode, smoothed, is the target's; and the mean log-evidence.",
        best={
            "filter [m]": -np.inf,
            "smoother [m]": -np.inf,
            "NEES": 1.0,
            "right mode": np.inf,
            "ln p": np.inf,
        },
    )
    record.figure(
        _figure(shown["3 Gaussians"], shown["one motion"], drawn),
        "turns",
        "The first target. Left: its path, smoothed with three Gaussians and with one motion, and "
        "95 % ellipses, as dark as their Gaussians weigh. Right: the probabilities of its modes, "
        "filtered above and smoothed below; the strips are the right ones.",
    )
    record.summary(methods=found)


def _scores(posterior: Any, drawn: Any, *, with_modes: bool) -> dict[str, float]:
    found = errors(posterior.filtered[target], posterior[target], drawn[target])
    found["log_evidence"] = float(np.mean(posterior.log_evidence))
    if with_modes:
        likeliest = posterior[switching.mode].probabilities.argmax(axis=-1)
        found["right"] = float((likeliest == drawn[switching.mode]).mean())
    return found


def _figure(several: Any, one: Any, drawn: Any) -> Figure:
    figure = plt.figure(figsize=(11.0, 5.0), layout="constrained")
    axes = figure.subplot_mosaic([["path", "at once"], ["path", "in hindsight"]])
    pgm.plot.trajectory(
        several[target][0],
        truth=drawn[target][0],
        components=PLACE,
        unit="m",
        label="three Gaussians",
        ax=axes["path"],
    )
    pgm.plot.trajectory(
        one[target][0], components=PLACE, unit="m", label="one motion", ax=axes["path"]
    )
    for name, own in (("at once", several.filtered), ("in hindsight", several)):
        table = own[switching.mode]
        first = pgm.Table(switching.mode, table.probabilities[0], lead=len(drawn[target][0]))
        pgm.plot.bands(first, truth=drawn[switching.mode][0], ax=axes[name])
        axes[name].set_ylabel(f"probability, {own.kind}")
    legend = axes["in hindsight"].get_legend()
    assert legend is not None
    legend.remove()
    plt.close(figure)
    return figure
