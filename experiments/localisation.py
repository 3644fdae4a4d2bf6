"""A simulated drive among landmarks: filters against smoothers, one lineariser against another."""

from __future__ import annotations

from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import typer
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.record import Out, Record, Seed, progress
from models import networks, simulation
from models.networks import pose
from pgm import consistency

LINEARISERS: dict[str, pgm.Lineariser] = {
    "Taylor": pgm.Taylor(),
    "Unscented": pgm.Unscented(),
    "MonteCarlo": pgm.MonteCarlo(100),
}
DT = 0.25  # s
REACH = 4.0  # m, how far the sensor sees
MOTION_STD = (0.06, 0.06, 0.04)  # m, m, rad a step
LANDMARKS = 8
FIELD = (-8.0, 9.0, -9.0, 10.0)  # west, east, south, north [m]
QUICK = {"runs": 5, "steps": 40}


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=1, help="Drives to average over.")] = 50,
    steps: Annotated[
        int, typer.Option(min=1, help="Steps of a drive, a quarter of a second each.")
    ] = 200,
) -> None:
    """Filter and smooth a simulated drive among landmarks, with three linearisers."""
    record = Record("localisation", out, seed=seed, runs=runs, steps=steps, dt=DT, reach=REACH)
    network, drive = simulate(seed, runs, steps)
    results, posteriors = compare(network, drive)
    linear = linear_check(seed)
    record.table(
        f"RMSE and mean NEES, {runs} simulated drives of {steps} steps",
        ("lineariser", "belief", "xy [m]", "heading [rad]", "NEES (3)", "ln p(z)"),
        [
            (name, kind, *(results[key][name][kind] for key in results))
            for name in LINEARISERS
            for kind in ("filter", "smoother")
        ],
        about="RMSE of position and heading over drives and steps; mean NEES, of which 3 is right; "
        "mean log-evidence, which is that of all readings for both.",
        best={"xy [m]": -np.inf, "heading [rad]": -np.inf, "NEES (3)": 3.0},
        within=("lineariser",),
    )
    record.note(
        f"linear model, {linear['runs']} runs: mean NEES filter {linear['nees']['filter']:.3f}, "
        f"smoother {linear['nees']['smoother']:.3f}; 99 % band of the mean at one step "
        f"{linear['band'][0]:.3f} to {linear['band'][1]:.3f}"
    )
    record.figure(_network_figure(network), "network", "The network, two slices.")
    record.figure(_graph_figure(network, steps), "cluster_graph", "Its cluster graph.")
    one = simulation.Drive(drive.truth[0], drive.landmarks, drive.evidence)
    record.figure(_trajectory_figure(posteriors, one), "trajectories", "The first drive.")
    record.figure(_error_figure(posteriors, one), "errors", "Its errors in bands of three σ.")
    record.summary(**results, linear=linear)


def simulate(
    seed: int, runs: int, steps: int
) -> tuple[pgm.DynamicBayesianNetwork, simulation.Drive]:
    """A network, and drives drawn from it."""
    rng = np.random.default_rng(seed)
    network = networks.range_bearing(DT, motion_std=MOTION_STD)
    controls = simulation.figure_of_eight(steps, DT)
    landmarks = simulation.scatter(LANDMARKS, FIELD, rng)
    return network, simulation.drive(network, controls, landmarks, reach=REACH, runs=runs, rng=rng)


def compare(
    network: pgm.DynamicBayesianNetwork, drive: simulation.Drive
) -> tuple[dict[str, dict[str, dict[str, float]]], dict[str, pgm.ChainPosterior]]:
    """Errors of the filter and the smoother by lineariser, and the smoothed posteriors."""
    results: dict[str, dict[str, dict[str, float]]] = {
        key: {name: {} for name in LINEARISERS}
        for key in ("rmse", "rmse_heading", "nees", "log_evidence")
    }
    posteriors = {}
    for name in progress(list(LINEARISERS), "localisation"):
        posterior = pgm.smooth(network, drive.evidence, lineariser=LINEARISERS[name])
        posteriors[name] = posterior
        for kind, belief in (("filter", posterior.filtered[pose]), ("smoother", posterior[pose])):
            rmse = consistency.rmse(belief, drive.truth, ("east", "north"))
            results["rmse"][name][kind] = rmse
            heading = consistency.rmse(belief, drive.truth, ("heading",))
            results["rmse_heading"][name][kind] = heading
            nees = consistency.nees(belief, drive.truth)
            results["nees"][name][kind] = float(nees.mean())
            results["log_evidence"][name][kind] = float(posterior.log_evidence.mean())
    return results, posteriors


def linear_check(seed: int, runs: int = 200, steps: int = 50) -> dict[str, Any]:
    """Is a right model right? NEES of a linear model's runs, at its last step and halfway."""
    model = networks.linear()
    controls = np.tile([0.5, 0.2], (steps, 1))
    sample = model.sample({networks.shift: controls}, runs=runs, rng=seed)
    posterior = pgm.smooth(model, sample.evidence)
    truth = sample[networks.point]
    beliefs = {"filter": posterior.filtered[networks.point], "smoother": posterior[networks.point]}
    return {
        "runs": runs,
        "steps": steps,
        "nees": {
            k: float(consistency.nees(b, truth)[:, steps // 2].mean()) for k, b in beliefs.items()
        },
        "band": consistency.mean_band(2, runs),
        "rmse": {k: consistency.rmse(b, truth) for k, b in beliefs.items()},
    }


def _network_figure(network: pgm.DynamicBayesianNetwork) -> Figure:
    figure, ax = plt.subplots(figsize=(5, 4))
    pgm.plot.network(network, steps=1, ax=ax)
    plt.close(figure)
    return figure


def _graph_figure(network: pgm.DynamicBayesianNetwork, steps: int) -> Figure:
    figure, ax = plt.subplots(figsize=(12, 2))
    graph = pgm.compile(network, steps=steps)
    pgm.plot.cluster_graph(graph, steps=min(4, steps), ax=ax)
    plt.close(figure)
    return figure


def _trajectory_figure(
    posteriors: dict[str, pgm.ChainPosterior], drive: simulation.Drive
) -> Figure:
    figure, axes = plt.subplots(
        1, len(posteriors), figsize=(13, 5.2), sharex=True, sharey=True, layout="constrained"
    )
    for ax, (name, posterior) in zip(axes, posteriors.items(), strict=True):
        pgm.plot.trajectory(
            posterior.filtered[pose].run(0),
            truth=drive.truth,
            landmarks=drive.landmarks,
            label=posterior.filtered.kind,
            ax=ax,
        )
        pgm.plot.trajectory(posterior[pose].run(0), label=posterior.kind, ax=ax)
        ax.set_title(name)
        ax.set_xlabel("east [m]")
        ax.set_ylabel("north [m]" if ax is axes[0] else "")
        if ax is not axes[-1] and (legend := ax.get_legend()):
            legend.remove()
    plt.close(figure)
    return figure


def _error_figure(posteriors: dict[str, pgm.ChainPosterior], drive: simulation.Drive) -> Figure:
    posterior = posteriors["Unscented"]
    figure, axes = plt.subplots(
        3, 2, figsize=(11, 6.5), sharex=True, sharey="row", layout="constrained"
    )
    times = DT * np.arange(len(drive.truth))
    beliefs = {found.kind: found[pose].run(0) for found in (posterior.filtered, posterior)}
    for column, (kind, belief) in enumerate(beliefs.items()):
        pgm.plot.errors(belief, drive.truth, times=times, axes=axes[:, column])
        axes[0, column].set_title(f"Unscented, {kind}")
        axes[-1, column].set_xlabel("time [s]")
    plt.close(figure)
    return figure
