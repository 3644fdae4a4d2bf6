"""Filters and smoothers on many drawn drives: where each is consistent, by noise and distance."""

from __future__ import annotations

from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import typer
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.record import Out, Record, Seed, progress
from models import networks
from models.networks import landmark, sighting, velocity
from pgm.plot.drawing.colours import readable_on

METHODS: dict[str, Any] = {
    "EKF": pgm.Taylor(),
    "UKF": pgm.Unscented(),
    "iterated EKF": pgm.Filtering(iterations=4),
    "EKF smoother": pgm.Smoothing(),
    "UKF smoother": (pgm.Unscented(), pgm.Smoothing()),
}
DT = 0.5  # s
SPEED = 0.5  # m/s
MOTION_STD = (0.05, 0.05, 0.05)  # m, m, rad a step
START_STD = (0.3, 0.3, 0.2)  # m, m, rad
RANGE_STD = 0.1  # m
DISTANCES = (0.5, 1.0, 2.0, 4.0)  # m, of the robot from the landmark that it goes about
BEARING_STD = (0.02, 0.05, 0.15, 0.4)  # rad
HARD = (DISTANCES[0], BEARING_STD[0])
# NEES over its right value from which on a map has its darkest colour.
WORST = 4.0
QUICK = {"runs": 40, "steps": 4}

Array = npt.NDArray[np.float64]
Cells = dict[tuple[float, float], pgm.results.Study]


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=2, help="Drives of each cell.")] = 5_000,
    steps: Annotated[int, typer.Option(min=2, help="Steps of a drive, half a second each.")] = 40,
) -> None:
    """Judge filters and smoothers on thousands of drives about a landmark, near and far."""
    record = Record(
        "comparison_at_scale",
        out,
        seed=seed,
        runs=runs,
        steps=steps,
        distances=list(DISTANCES),
        bearing_std=list(BEARING_STD),
        range_std=RANGE_STD,
        motion_std=list(MOTION_STD),
        start_std=list(START_STD),
        dt=DT,
        speed=SPEED,
    )
    cells = {
        cell: study(*cell, runs=runs, steps=steps, seed=seed)
        for cell in progress([(d, b) for d in DISTANCES for b in BEARING_STD], record.name)
    }
    record.table(
        f"{runs:,} drives of {steps} steps in each cell",
        ("distance [m]", "bearing [rad]", "method", "xy [m]", "NEES (3)", "coverage (.95)", "lost"),
        [
            (distance, bearing, row.method, _position(row), *_told(row))
            for (distance, bearing), found in cells.items()
            for row in found.rows
        ],
        about="RMSE of the position, mean NEES and coverage of 95 % regions, with standard errors; "
        "lost: the share of drives whose last belief leaves out the truth, or whose method failed.",
    )
    record.figure(
        _maps(cells),
        "consistency",
        "Mean NEES over its right value, 3, by the robot's distance from the landmark [m] and the "
        "bearing's standard deviation [rad]. White is right, red too sure, blue not sure enough; a "
        "dot marks cells whose coverage is that of right beliefs, within 3 standard errors.",
    )
    record.figure(
        _gains(cells),
        "errors",
        "RMSE of the position over that of the EKF, by distance and bearing's deviation: below 1 "
        "the method is nearer to the truth.",
    )
    record.figure(
        _over_time(cells[HARD]),
        "over_time",
        f"Share of the drives whose truth is in the 95 % region, over the drives at {HARD[0]:g} m "
        f"with a bearing of {HARD[1]:g} rad, in bands of 1.96 standard errors; the line is right.",
    )
    record.summary(
        nees=_by_cell(cells, lambda row: float(row.nees.value)),
        nees_error=_by_cell(cells, lambda row: float(row.nees.error)),
        coverage=_by_cell(cells, lambda row: float(row.coverage.value)),
        rmse=_by_cell(cells, _position),
        lost=_by_cell(cells, _lost),
    )


def study(distance: float, bearing: float, *, runs: int, steps: int, seed: int) -> Any:
    """The methods on drives in a circle about a landmark, which is seen at every step."""
    network = networks.range_bearing(
        DT,
        start=(distance, 0.0, 0.5 * np.pi),
        start_std=START_STD,
        motion_std=MOTION_STD,
        sensor_std=(RANGE_STD, bearing),
    )
    turn = min(SPEED / distance, 1.0)  # rad/s, so that the circle's radius is the distance
    given = {
        velocity: np.tile([turn * distance, turn], (steps, 1)),
        sighting: pgm.sightings(
            step=np.arange(1, steps + 1), given={landmark: np.zeros((steps, 2))}
        ),
    }
    return pgm.study(network, given, runs=runs, methods=METHODS, seed=seed)


def _position(row: pgm.results.StudyRow) -> float:
    """The RMSE of the position."""
    return float(np.hypot(*row.rmse.value[:2]))


def _lost(row: pgm.results.StudyRow) -> float:
    """The share of the drives that diverged or failed."""
    failed = len(row.failed)
    return (len(row.diverged) + failed) / (row.runs + failed)


def _told(row: pgm.results.StudyRow) -> tuple[str, str, str]:
    figures = (f"{each.value:.3g} ± {each.error:.1g}" for each in (row.nees, row.coverage))
    return (*figures, f"{_lost(row):.2%}")  # type: ignore[return-value]


def _by_cell(cells: Cells, figure: Any) -> dict[str, dict[str, dict[str, float]]]:
    """A figure of each method by distance and bearing, for the summary."""
    return {
        name: {
            f"{distance:g} m": {
                f"{bearing:g} rad": figure(cells[distance, bearing][name])
                for bearing in BEARING_STD
            }
            for distance in DISTANCES
        }
        for name in METHODS
    }


def _table(cells: Cells, name: str, figure: Any) -> Array:
    """A figure of a method, (bearings, distances)."""
    return np.array([[figure(cells[d, b][name]) for d in DISTANCES] for b in BEARING_STD])


def _maps(cells: Cells) -> Figure:
    def relative(row: pgm.results.StudyRow) -> float:
        return float(row.nees.value) / row.nees.expected

    def errors(row: pgm.results.StudyRow) -> float:
        with np.errstate(divide="ignore"):
            return float(abs(row.coverage.value - row.coverage.expected) / row.coverage.error)

    maps = {name: _table(cells, name, relative) for name in METHODS}
    right = {name: _table(cells, name, errors) < 3.0 for name in METHODS}
    return _panels(maps, right, "NEES over its right value", WORST)


def _gains(cells: Cells) -> Figure:
    first = next(iter(METHODS))
    reference = _table(cells, first, _position)
    maps = {name: _table(cells, name, _position) / reference for name in METHODS if name != first}
    return _panels(maps, {}, f"RMSE over that of the {first}", 2.0)


def _panels(maps: dict[str, Array], marked: dict[str, Any], label: str, most: float) -> Figure:
    """Maps beside each other, of ratios in colours by their logarithms, 1 white."""
    figure, axes = plt.subplots(
        1, len(maps), figsize=(2.7 * len(maps) + 0.9, 3.1), layout="constrained", sharey=True
    )
    norm = TwoSlopeNorm(0.0, -np.log(most), np.log(most))
    colours = plt.get_cmap("RdBu_r")
    for ax, (name, values) in zip(axes, maps.items(), strict=True):
        with np.errstate(divide="ignore"):
            image = ax.imshow(np.log(values), cmap=colours, norm=norm, origin="lower")
        for (row, column), value in np.ndenumerate(values):
            text = f"{value:.2f}" if value < 9.995 else f"{value:.0f}" if value < 1e3 else "≫"
            ink = readable_on(colours(norm(np.log(value))))
            ax.text(column, row, text, ha="center", va="center", fontsize=7.5, color=ink)
            if name in marked and marked[name][row, column]:
                ax.plot(column, row - 0.32, ".", color=ink, ms=3)
        ax.set_title(name, fontsize=9)
        ax.set_xticks(range(len(DISTANCES)), [f"{d:g}" for d in DISTANCES])
        ax.set_yticks(range(len(BEARING_STD)), [f"{b:g}" for b in BEARING_STD])
        ax.set_xlabel("distance [m]")
    axes[0].set_ylabel("bearing's deviation [rad]")
    ticks = [1 / most, most**-0.5, 1.0, most**0.5, most]
    bar = figure.colorbar(image, ax=axes, ticks=np.log(ticks), extend="both", label=label)
    bar.ax.set_yticklabels([f"{tick:.3g}" for tick in ticks])
    return figure


def _over_time(found: pgm.results.Study) -> Figure:
    figure, ax = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    pgm.plot.study(found, statistic="coverage", times=DT * np.arange(found.steps + 1), ax=ax)
    ax.set_xlabel("time [s]")
    return figure
