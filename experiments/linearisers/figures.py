"""Pictures: beliefs of one simulation, and cost and error over the number of samples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import pgm
import pgm.plot
from experiments.linearisers import accuracy, timing
from experiments.linearisers.accuracy import Outcome, Trial
from experiments.linearisers.timing import Cost, Line
from models.networks import pose, velocity
from pgm.plot.drawing.colours import MUTED

TRUTH = "#D7191C"
COLOURS = {"MC100": "#0072B2", "MC10": "#009E73", "Taylor": "#CC79A7", "Unscented": "#E69F00"}
DASHES: dict[str, Any] = {
    "MC100": "solid",
    "MC10": "dashed",
    "Taylor": "dashdot",
    "Unscented": (0, (1.5, 1.5)),
}
TITLES = {
    "MC10000": "Monte Carlo 10000",
    "MC100": "Monte Carlo 100",
    "MC10": "Monte Carlo 10",
    "Taylor": "Taylor",
    "Unscented": "unscented",
}


def beliefs(trial: Trial, outcomes: Mapping[str, Outcome], run: int) -> Figure:
    """One simulation: the prior and the predictions in the plane, then the posteriors."""
    figure, axes = plt.subplots(1, 3, figsize=(13.5, 5.4), layout="constrained")
    now = pose.at(1)
    _cloud(axes[0], trial, 1500)
    _ellipse(axes[0], trial.best[pose.at(0)].run(run), "black", "solid", ("east", "north"))
    views = (("east", "north"), ("east", "north"), ("east", "heading"))
    for k, (ax, components) in enumerate(zip(axes, views, strict=True)):
        for name, outcome in outcomes.items():
            found = outcome.posterior.predicted if k == 0 else outcome.posterior
            _ellipse(ax, found[now].run(run), COLOURS[name], DASHES[name], components)
        found = trial.best.predicted if k == 0 else trial.best
        _ellipse(ax, found[now].run(run), TRUTH, "solid", components, width=2.2, below=True)
        east, other = (now.components.index(name) for name in components)
        ax.plot(*trial.sample[pose][run, 1, [east, other]], "x", color="black", markersize=7)
        ax.locator_params(nbins=6)
        ax.set_xlabel("east [m]")
        ax.set_ylabel("heading [rad]" if k == 2 else "north [m]")
        if k < 2:
            ax.set_aspect("equal", adjustable="datalim")
    axes[0].set_title("prior, and predictions at step 1")
    axes[1].set_title("posteriors at step 1")
    axes[2].set_title("posteriors at step 1, with the heading")
    handles = [Line2D([], [], color="black", label="prior")]
    for name, outcome in outcomes.items():
        label = f"{TITLES[name]}: KL {outcome.divergence[run]:.2g}"
        handles.append(Line2D([], [], color=COLOURS[name], linestyle=DASHES[name], label=label))
    handles += [
        Line2D([], [], color=TRUTH, linewidth=2.2, label="truth (best Gaussian)"),
        Line2D([], [], color="black", marker="x", linestyle="none", label="simulated pose"),
        Line2D([], [], color=MUTED, marker=".", linestyle="none", label="moved samples"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    plt.close(figure)
    return figure


def _cloud(ax: Axes, trial: Trial, count: int) -> None:
    """Where the motion takes samples of the prior, noise included."""
    drawn = trial.network.sample({velocity: trial.sample.evidence[velocity]}, runs=count, rng=0)[
        pose
    ][:, 1]
    ax.plot(drawn[:, 0], drawn[:, 1], ".", color=MUTED, markersize=1.5, alpha=0.5)


def _ellipse(
    ax: Axes,
    belief: pgm.Gaussian,
    colour: str,
    dashes: Any,
    components: tuple[str, str],
    *,
    width: float = 1.6,
    below: bool = False,
) -> None:
    pgm.plot.ellipses(
        belief,
        components=components,
        ax=ax,
        edgecolor=colour,
        facecolor="none",
        linestyle=dashes,
        linewidth=width,
        zorder=2 if below else 3,
    )


def cost(costs: Mapping[str, Cost], lines: Mapping[str, Line]) -> Figure:
    """Seconds over the number of samples, with the lines fitted, and the report's seconds."""
    figure, ax = plt.subplots(figsize=(8, 6), layout="constrained")
    fine = np.geomspace(timing.SAMPLES[0], timing.SAMPLES[-1], 200)
    for kind, colour, marker, label in (
        ("step", COLOURS["MC100"], "o", "one filter step, Monte Carlo"),
        ("linearisation", COLOURS["MC10"], "s", "the linearisation in it"),
    ):
        seconds = timing.seconds(costs, kind)["by_samples"].values()
        line = lines[kind]
        fitted = f"{1e3 * line.fixed:.2f} ms + {1e6 * line.per_sample:.2f} µs · N"
        ax.plot(timing.SAMPLES, list(seconds), marker, color=colour, label=label)
        ax.plot(fine, line(fine), color=colour, linewidth=1.0, label=fitted)
        ax.plot(line.knee, line(line.knee), "|", color=colour, markersize=22)
    for name in ("Unscented", "Taylor"):
        ax.axhline(
            costs[name].step,
            color=COLOURS[name],
            linestyle=DASHES[name],
            label=f"one filter step, {TITLES[name]}",
        )
    reported = {int(name[2:]): t for name, t in timing.REPORT.items() if name.startswith("MC")}
    ax.plot(
        list(reported),
        list(reported.values()),
        "D",
        color="black",
        markerfacecolor="none",
        label="Monte Carlo in the report, on its machine",
    )
    ax.set(xscale="log", yscale="log", xlabel="samples N", ylabel="time [s]")
    ax.grid(which="major", alpha=0.3)
    ax.legend(fontsize="small", loc="upper left")
    plt.close(figure)
    return figure


def error(by_samples: Mapping[str, Mapping[str, float]]) -> Figure:
    """Mean divergence over the number of samples, and the line c / N."""
    figure, ax = plt.subplots(figsize=(7, 4.5), layout="constrained")
    samples = np.array([float(n) for n in by_samples])
    means, errors = (
        np.array([each[what] for each in by_samples.values()])
        for what in ("mean", "standard_error")
    )
    ax.errorbar(
        samples,
        means,
        yerr=2.0 * errors,
        fmt="o",
        color=COLOURS["MC100"],
        capsize=3,
        label="Monte Carlo, ± 2 standard errors",
    )
    c = accuracy.constant(by_samples)
    ax.plot(samples, c / samples, color="black", linewidth=1.0, label=f"{c:.2f} / N")
    ax.set(xscale="log", yscale="log", xlabel="samples N", ylabel="mean KL(truth ‖ belief) [nats]")
    ax.grid(which="major", alpha=0.3)
    ax.legend(fontsize="small")
    plt.close(figure)
    return figure
