"""Fixes that are faulty for some steps: the fault as a hidden state, as robust noise, as a gate.

In summary.json ``methods.<name>`` has the root mean square errors of places, filtered and smoothed
[m], and the smoother's normalised errors squared a component (`nees`); ``found`` is the share of
steps at which the smoothed state of the fault is the right one.
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
from models.networks import fix, target

QUICK: dict[str, Any] = {"runs": 20}


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=1, help="Targets that are drawn.")] = 200,
    steps: Annotated[int, typer.Option(min=2, help="Steps of each.")] = 80,
) -> None:
    """Fixes that are faulty for a while: the fault as a state, robust noise, or a gate."""
    record = Record("outlier_cause", out, seed=seed, runs=runs, steps=steps)
    model = switching.faulty_fixes()
    drawn = model.sample(steps=steps, runs=runs, rng=seed)
    read = {fix: drawn[fix]}
    plain, robust = switching.plain_fixes(), switching.plain_fixes(pgm.StudentT(4.0))
    asked: dict[str, tuple[pgm.DynamicBayesianNetwork, dict[str, Any]]] = {
        "one noise": (plain, {}),
        "gate of 99 %": (plain, {"gate": 0.99}),
        "Student's t": (robust, {}),
        "fault as a state": (model, {}),
        "the same, 8 Gaussians": (model, {"belief": pgm.Gaussians(8)}),
    }
    found, posteriors = {}, {}
    for name, (own, options) in asked.items():
        again: dict[str, Any] = {"iterations": 100, "tolerance": 0.01} if own is robust else {}
        posteriors[name] = pgm.smooth(own, read, **options, **again)
        filtered = pgm.filter(own, read, **options)
        found[name] = errors(filtered[target], posteriors[name][target], drawn[target])
    told = posteriors["fault as a state"][switching.fault].probabilities
    right = float((told.argmax(axis=-1) == drawn[switching.fault]).mean())
    record.table(
        f"Errors over {runs} targets and {steps} steps",
        ("what a faulty fix is", "filter [m]", "smoother [m]", "NEES"),
        [(name, s["filter"], s["smoother"], s["nees"]) for name, s in found.items()],
        about="Root mean square errors of places, filtered and smoothed, and the smoother's "
        "normalised squared errors a component, 1 where it is right about its errors. The "
        "model that draws is that with the fault as a state.",
        best={"filter [m]": -np.inf, "smoother [m]": -np.inf, "NEES": 1.0},
    )
    record.note(f"the smoothed state of the fault is right at {right:.1%} of the steps")
    record.figure(
        _figure(posteriors, drawn),
        "fault",
        "The first target. Left: its fixes and its path, smoothed with one noise and with the "
        "fault as a state. Right: the smoothed probability of the fault, above the truth.",
    )
    record.summary(methods=found, found=right)


def _figure(posteriors: Any, drawn: Any) -> Figure:
    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.5), layout="constrained")
    fixes = drawn[fix][0]
    left.plot(*fixes.T, ".", color="#999999", label="fixes")
    for name in ("fault as a state", "one noise"):
        pgm.plot.trajectory(
            posteriors[name][target][0],
            truth=drawn[target][0] if name == "fault as a state" else None,
            components=PLACE,
            unit="m",
            label=name,
            every=200,
            ax=left,
        )
    table = posteriors["fault as a state"][switching.fault]
    first = pgm.Table(switching.fault, table.probabilities[0], lead=len(table.probabilities[0]))
    pgm.plot.bands(first, truth=drawn[switching.fault][0], ax=right)
    right.set_ylabel("probability, smoothed")
    plt.close(figure)
    return figure
