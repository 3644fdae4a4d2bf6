"""A simulated drive among landmarks: filters against smoothers, one lineariser against another."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import typer
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from scipy.stats import chi2

import pgm
import pgm.plot
from experiments.kinds import as_gaussian
from experiments.record import Out, Record, Seed, progress
from experiments.run_errors import run_errors
from models import networks, simulation
from models.networks import pose
from pgm import consistency
from pgm.plot.drawing.colours import INK, MUTED, PALETTE

LINEARISERS: dict[str, pgm.Lineariser] = {
    "Taylor": pgm.Taylor(),
    "Unscented": pgm.Unscented(),
    "MonteCarlo": pgm.MonteCarlo(100),
}
DT = 0.25  # s
REACH = 4.0  # m, how far the sensor sees
MOTION_STD = (0.06, 0.06, 0.04)  # m, m, rad a step
SENSOR_STD = (0.2, 0.05)  # m, rad
LANDMARKS = 8
FIELD = (-8.0, 9.0, -9.0, 10.0)  # west, east, south, north [m]
CONFIDENCE = 0.95
REGION = float(chi2(2).ppf(CONFIDENCE))  # of an ellipse, in the plane
WORST = (
    "The drive on which the filter with Taylor has the largest NEES: black is the truth, from the "
    "square on; coloured are the filter's mean and, every five seconds, its 95 % ellipse, joined "
    "to the truth; a time is written where the truth lies outside."
)
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
    record.figure(
        _network_figure(network),
        "network",
        "Two slices of the network: the pose x, the control u that drives it, and the sighting z "
        "of a landmark m. Shaded: known.",
    )
    record.figure(
        _graph_figure(network, steps),
        "cluster_graph",
        "Its cluster graph, the first steps: ellipses are clusters with their variables, "
        "rectangles sepsets; the dashed line leads to the steps not drawn.",
    )
    record.figure(worst_drive(network, drive), "trajectories", WORST)
    one = simulation.Drive(drive.truth[0], drive.landmarks, drive.evidence)
    record.figure(
        _error_figure(posteriors, one),
        "errors",
        "The first drive: errors of the unscented filter and smoother [m, m, rad] over time [s], "
        "in bands of three standard deviations of each belief.",
    )
    record.summary(**results, linear=linear)


def simulate(
    seed: int, runs: int, steps: int
) -> tuple[pgm.DynamicBayesianNetwork, simulation.Drive]:
    """A network, and drives drawn from it."""
    rng = np.random.default_rng(seed)
    network = networks.range_bearing(DT, motion_std=MOTION_STD, sensor_std=SENSOR_STD)
    controls = simulation.figure_of_eight(steps, DT)
    landmarks = simulation.scatter(LANDMARKS, FIELD, rng)
    return network, simulation.drive(network, controls, landmarks, reach=REACH, runs=runs, rng=rng)


def compare(
    network: pgm.DynamicBayesianNetwork, drive: simulation.Drive
) -> tuple[dict[str, dict[str, dict[str, float]]], dict[str, pgm.results.Posterior]]:
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


def sweep(
    runs: int,
    rng: np.random.Generator,
    *,
    lineariser: Literal["Taylor", "Unscented", "Cubature", "MonteCarlo"] = "Unscented",
    noise: float = 1.0,
    iterations: int = 1,
    belief: Literal["filter", "smoother"] = "filter",
    steps: int = 100,
) -> dict[str, npt.NDArray[np.float64]]:
    """Errors of the robot's pose over a drive: one part of a study.

    ``rmse`` [m] and ``rmse_heading`` [rad] over the steps, their mean ``nees``, of which 3 is
    right, and ``log_evidence``. The landmarks are those of the experiment's seed 0.

    Parameters
    ----------
    noise : float
        The sensor's standard deviations, in those of the experiment.
    iterations : int
        Linearisations; of the filter, of a step's sightings.
    """
    if noise <= 0.0 or steps < 1:
        raise pgm.ModelError(f"noise and steps are above 0; found {noise:g} and {steps}")
    network = networks.range_bearing(
        DT, motion_std=MOTION_STD, sensor_std=[noise * std for std in SENSOR_STD]
    )
    drive = simulation.drive(
        network,
        simulation.figure_of_eight(steps, DT),
        simulation.scatter(LANDMARKS, FIELD, np.random.default_rng(0)),
        reach=REACH,
        runs=runs,
        rng=rng,
    )
    sampled = pgm.MonteCarlo(100, seed=int(rng.integers(2**32)), fresh_per_run=True)
    rules = LINEARISERS | {"Cubature": pgm.Cubature(), "MonteCarlo": sampled}
    estimate = pgm.filter if belief == "filter" else pgm.smooth
    found = estimate(
        network, drive.evidence, lineariser=rules[lineariser], iterations=iterations, keep=[pose]
    )
    return run_errors(found, drive.truth)


def linear_check(seed: int, runs: int = 200, steps: int = 50) -> dict[str, Any]:
    """Is a right model right? NEES of a linear model's runs halfway, and RMSE over all steps."""
    controls = np.tile([0.5, 0.2], (steps, 1))
    methods = {"filter": pgm.Filtering(), "smoother": pgm.Smoothing()}
    shifts = {networks.shift: controls}
    found = pgm.study(networks.linear(), shifts, runs=runs, methods=methods, seed=seed)
    return {
        "runs": runs,
        "steps": steps,
        "nees": {name: float(found[name].nees.by_step[steps // 2]) for name in methods},
        "band": consistency.mean_band(2, runs),
        "rmse": {name: float(np.hypot(*found[name].rmse.value)) for name in methods},
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


def worst_drive(network: pgm.DynamicBayesianNetwork, drive: simulation.Drive) -> Figure:
    """The drive on which the filter with Taylor has the largest NEES, beside the unscented one.

    Of both: the truth, the mean, and an ellipse every five seconds, joined to the truth.
    """
    figure, axes = plt.subplots(1, 2, figsize=(8.0, 5.3), sharex=True, sharey=True)
    beliefs = {
        name: as_gaussian(pgm.filter(network, drive.evidence, lineariser=LINEARISERS[name])[pose])
        for name in ("Taylor", "Unscented")
    }
    nees = {name: consistency.nees(belief, drive.truth) for name, belief in beliefs.items()}
    worst = int(nees["Taylor"].mean(axis=-1).argmax())
    truth = drive.truth[worst]
    shown = np.arange(0, len(truth), round(5.0 / DT))
    for ax, (name, belief), colour in zip(axes, beliefs.items(), PALETTE[1::-1], strict=True):
        found = belief.run(worst)
        pgm.plot.trajectory(
            found,
            truth=truth,
            landmarks=drive.landmarks,
            confidence=CONFIDENCE,
            every=int(shown[1]) if len(shown) > 1 else None,
            colour=colour,
            ax=ax,
        )
        if legend := ax.get_legend():
            legend.remove()
        mean, right = found.mean[shown, :2], truth[shown, :2]
        ax.plot(*np.stack([mean, right]).transpose(2, 0, 1), color=MUTED, lw=0.8, zorder=2.2)
        ax.plot(*mean.T, "o", color=colour, markersize=3.5, zorder=2.6)
        ax.plot(*right.T, "o", color=INK, markersize=3.5, zorder=2.7)
        ax.plot(*truth[0, :2], "s", color=INK, markersize=7, fillstyle="none", zorder=2.8)
        outside = consistency.nees(found, truth, ("east", "north"))[shown] > REGION
        for step, (east, north) in zip(shown[outside], right[outside], strict=True):
            ax.annotate(
                f"{DT * step:.0f} s",
                (east, north),
                (4, 6),
                textcoords="offset points",
                fontsize=8,
                path_effects=[withStroke(linewidth=2.5, foreground="white")],
            )
        ax.set_title(
            f"{name}: mean NEES {nees[name][worst].mean():,.0f} here,\n"
            f"{nees[name].mean():.0f} over {len(drive.truth)} drives (3 is right)",
            fontsize=10,
        )
        ax.set_xlabel("east [m]")
        ax.set_ylabel("north [m]" if ax is axes[0] else "")
    figure.legend(handles=_legend(), ncols=3, loc="lower center", fontsize=8.5, frameon=False)
    figure.subplots_adjust(left=0.085, right=0.985, bottom=0.205, top=0.905, wspace=0.06)
    plt.close(figure)
    return figure


def _legend() -> list[Artist]:
    """The marks of the drive, for both panels."""
    return [
        Line2D([], [], color=INK, lw=0.8, marker="o", markersize=3.5, label="truth"),
        Line2D([], [], color=INK, lw=0, marker="s", markersize=7, fillstyle="none", label="start"),
        Line2D([], [], color=PALETTE[1], lw=1.8, label="mean of the filter, with Taylor"),
        Line2D([], [], color=PALETTE[0], lw=1.8, label="mean of the filter, unscented"),
        Patch(
            facecolor="none",
            edgecolor=MUTED,
            label=f"{100 * CONFIDENCE:.0f} % ellipse of the filter, every 5 s",
        ),
        Line2D([], [], color=INK, lw=0, marker="^", markersize=6, label="landmark"),
    ]


def _error_figure(posteriors: dict[str, pgm.results.Posterior], drive: simulation.Drive) -> Figure:
    posterior = posteriors["Unscented"]
    figure, axes = plt.subplots(
        3, 2, figsize=(11, 6.5), sharex=True, sharey="row", layout="constrained"
    )
    times = DT * np.arange(len(drive.truth))
    beliefs = {found.kind: found[pose].run(0) for found in (posterior.filtered, posterior)}
    for column, (kind, belief) in enumerate(beliefs.items()):
        pgm.plot.errors(belief, drive.truth, times=times, unit="m", axes=axes[:, column])
        axes[0, column].set_title(f"Unscented, {kind}", loc="left")
        axes[-1, column].set_xlabel("time [s]")
    for ax in axes[:, 1]:
        ax.set_ylabel("")
    plt.close(figure)
    return figure
