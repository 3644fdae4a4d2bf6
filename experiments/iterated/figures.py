"""Figures of iterated filters and smoothers."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.iterated import chain
from experiments.iterated.case import Case
from experiments.iterated.methods import KINDS, TITLES, Array, Grid, Outcome
from experiments.iterated.published import GROWTH
from pgm.plot.drawing.colours import INK, MUTED, PALETTE

COLOURS = dict(zip(TITLES, PALETTE, strict=False))
_STYLES = {"Unscented": "-", "Taylor": "--"}
# Curves that coincide are seen: each is narrower than the one beneath it, and points stand aside.
_WIDTHS, _ASIDE = (3.4, 2.2, 1.2), (0.97, 1.0, 1.03)
_SENSORS = {"cubic": "z = x³/20", "square": "z = x²/20"}


def linearisations(grids: Mapping[str, Mapping[str, Grid]]) -> Figure:
    """RMSE of the growth model by number of linearisations."""
    figure, axes = plt.subplots(
        2, 2, figsize=(10, 7.5), sharex=True, sharey="row", layout="constrained"
    )
    for row, (sensor, by_lineariser) in zip(axes, grids.items(), strict=True):
        for ax, kind in zip(row, KINDS, strict=True):
            for name, grid in by_lineariser.items():
                _by_linearisations(ax, grid[kind], _STYLES[name], name)
                _published(ax, sensor, kind, name)
            ax.set(xscale="log", yscale="log", title=f"{_SENSORS[sensor]}, {kind}")
            counts = sorted({k for each in grid[kind].values() for k in each})
            ax.set_xticks(counts, [str(k) for k in counts])
            ax.xaxis.minorticks_off()
            low, high = ax.get_ylim()
            ticks = [t for t in (0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0) if low <= t <= high]
            ax.set_yticks(ticks, [f"{t:g}" for t in ticks])
            ax.yaxis.minorticks_off()
        row[0].set_ylabel("RMSE")
    for ax in axes[-1]:
        ax.set_xlabel("linearisations")
    handles, labels = axes[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize="small")
    plt.close(figure)
    return figure


def residuals(panels: Mapping[str, Mapping[str, Outcome]]) -> Figure:
    """How far each relinearisation still moved the means: the median run, and the middle 80 %."""
    figure, axes = plt.subplots(
        1, len(panels), figsize=(3.5 * len(panels), 3.8), sharey=True, layout="constrained"
    )
    for ax, (title, outcomes) in zip(axes, panels.items(), strict=True):
        for control, outcome in outcomes.items():
            # Zero, a step that was refused to the last digit, has no place on a log axis.
            moved = np.maximum(outcome.residuals, 1e-16)
            at = np.arange(2, len(moved) + 2)
            low, middle, high = np.quantile(moved, (0.1, 0.5, 0.9), axis=1)
            ax.semilogy(at, middle, ".-", color=COLOURS[control], label=TITLES[control])
            ax.fill_between(at, low, high, color=COLOURS[control], alpha=0.15, linewidth=0)
        ax.set(title=title, xlabel="linearisation")
        ax.xaxis.get_major_locator().set_params(integer=True, min_n_ticks=1)
        ax.yaxis.minorticks_off()
    axes[0].set_ylabel("largest move of a mean [standard deviations]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize="small")
    plt.close(figure)
    return figure


def over_time(grids: Mapping[str, Grid], growing: Mapping[str, Array], iterations: int) -> Figure:
    """RMSE of the position at each step of the chain."""
    figure, axes = plt.subplots(
        1, len(grids), figsize=(5.6 * len(grids), 4.3), sharey=True, layout="constrained"
    )
    steps = np.arange(1, chain.STEPS + 1)
    for ax, (name, grid) in zip(np.atleast_1d(axes), grids.items(), strict=True):
        filters, smoothers = grid["filter"], grid["smoother"]
        ax.plot(steps, filters["plain"][1].by_step, color=INK, label="filter, linearised once")
        for (control, each), width in zip(filters.items(), _WIDTHS, strict=True):
            ax.plot(
                steps,
                each[iterations].by_step,
                color=COLOURS[control],
                linewidth=width,
                label=f"filter, {iterations} linearisations, {TITLES[control]}",
            )
        if iterations > 2:
            ax.plot(
                steps,
                filters["damped"][2].by_step,
                color=COLOURS["damped"],
                linestyle="-.",
                label=f"filter, 2 linearisations, {TITLES['damped']}",
            )
        ax.plot(
            chain.ENDS,
            np.sqrt((growing[name] ** 2).mean(axis=0)),
            color=INK,
            linestyle="",
            marker="o",
            markersize=4,
            label="the same readings, all steps relinearised",
        )
        ax.plot(
            steps,
            smoothers["plain"][iterations].by_step,
            color=MUTED,
            linestyle="--",
            label=f"smoother, {iterations} linearisations, plain",
        )
        ax.set(title=name, xlabel="step of one second")
    highest = max(line.get_ydata().max() for ax in np.atleast_1d(axes) for line in ax.lines)
    np.atleast_1d(axes)[0].set(ylabel="RMSE of the position [m]", ylim=(0.0, 1.05 * highest))
    handles, labels = np.atleast_1d(axes)[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize="small")
    plt.close(figure)
    return figure


def failure(case: Case, outcomes: Mapping[str, Outcome], run: int) -> Figure:
    """One drive: the beliefs of some methods, each in its own panel."""
    figure, axes = plt.subplots(
        1,
        len(outcomes),
        figsize=(3.5 * len(outcomes), 4.6),
        sharex=True,
        sharey=True,
        layout="constrained",
    )
    for ax, (title, outcome) in zip(axes, outcomes.items(), strict=True):
        pgm.plot.trajectory(
            outcome.belief.run(run),
            truth=case.truth[run],
            landmarks=chain.LANDMARK[None],
            label="estimate",
            ax=ax,
        )
        ax.set_title(f"{title}\nRMSE {outcome.by_run[run]:.2f} m", fontsize="medium")
        ax.set(xlabel="east [m]", ylabel="north [m]" if ax is axes[0] else "")
        if legend := ax.get_legend():
            legend.remove()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    plt.close(figure)
    return figure


def _by_linearisations(
    ax: Axes, controls: Mapping[str, Mapping[int, Outcome]], style: str, name: str
) -> None:
    for (control, each), aside in zip(controls.items(), _ASIDE, strict=True):
        ax.errorbar(
            aside * np.array(list(each)),
            [outcome.score.rmse for outcome in each.values()],
            yerr=[outcome.score.rmse_se for outcome in each.values()],
            color=COLOURS[control],
            linestyle=style,
            marker="o",
            markersize=3,
            linewidth=1.3,
            label=f"{name}, {TITLES[control]}",
        )


def _published(ax: Axes, sensor: str, kind: str, name: str) -> None:
    numbers = [
        number
        for number in GROWTH[sensor].get(name, ())
        if number.method[0] == kind and number.quantity == "rmse"
    ]
    if numbers:
        ax.plot(
            [number.method[1] for number in numbers],
            [number.value for number in numbers],
            color="black",
            linestyle="",
            marker="x" if name == "Unscented" else "+",
            markersize=9,
            zorder=5,
            label=f"{name}, published",
        )
