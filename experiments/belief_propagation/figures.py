"""Figures of messages on graphs with loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.belief_propagation.loops import Case, Numbers, titled
from experiments.kinds import as_gaussian
from experiments.side_by_side import side_by_side
from models.networks import landmark, pose
from pgm.plot.drawing.colours import DASHES, PALETTE

Sweep = Mapping[str, Mapping[str, Sequence[Numbers]]]  # by network and schedule
Methods = Mapping[str, Mapping[str, Numbers]]  # by network and method

# Where a mean of a run that diverged is drawn, in deviations.
_FAR = 1e3


def graphs(case: Case) -> Figure:
    """The graphs of a case, two in a row."""
    drawings = {
        titled(name): partial(pgm.plot.cluster_graph, graph, evidence=case.evidence)
        for name, graph in case.graphs.items()
    }
    return side_by_side(drawings, columns=2)


def convergence(records: Mapping[str, Mapping[str, pgm.results.Status]]) -> Figure:
    """The residuals of some schedules, one panel a network."""
    figure, axes = plt.subplots(
        1, len(records), sharey=True, figsize=(4.4 * len(records), 4.0), layout="constrained"
    )
    for ax, (title, statuses) in zip(axes, records.items(), strict=True):
        for name, status in statuses.items():
            pgm.plot.convergence(status, label=name, ax=ax)
        ax.set_ylim(1e-11, _FAR)
        ax.set_title(title)
        if legend := ax.get_legend():
            legend.remove()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    for ax in axes[1:]:
        ax.set_ylabel("")
    plt.close(figure)
    return figure


def coupling(swept: Mapping[str, Sweep], at: Mapping[str, Sequence[float]]) -> Figure:
    """Errors against the strength of coupling; crosses where messages did not converge."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13.5, 4.2), layout="constrained")
    _lines(left, swept["discrete"], at["discrete"], ("error",))
    left.set(title="spins: marginals", xlabel="coupling J", ylabel="largest error of a probability")
    left.set_ylim(-0.05, 1.25)  # with room for the legend
    left.set_yticks(np.linspace(0.0, 1.0, 6))
    gaussian, precisions = swept["gaussian"], at["gaussian"]
    _lines(middle, gaussian, precisions, ("std_ratio_min", "std_ratio_max"))
    middle.axhline(1.0, color="black", linewidth=0.8)
    middle.set(title="Gaussian: deviations", ylabel="deviation / exact, least and greatest")
    _lines(right, gaussian, precisions, ("mean_error",))
    right.set(title="Gaussian: means", ylabel="largest error of a mean [exact deviations]")
    right.set_yscale("log")
    right.set_ylim(1e-17, 10.0 * _FAR)
    for ax in (middle, right):
        ax.set_xscale("log", base=2)
        ax.xaxis.set_major_formatter("{x:g}")
        ax.set_xlabel("precision of a reading")
    left.legend(fontsize="small", loc="upper right")
    right.legend(fontsize="small", loc="center left")
    plt.close(figure)
    return figure


def _lines(ax: Axes, sweep: Sweep, at: Sequence[float], keys: Sequence[str]) -> None:
    """One colour a network, one line style a schedule; crosses break no line."""
    styles: tuple[dict[str, Any], ...] = (
        {"linestyle": "-", "marker": "o"},
        {"linestyle": "--", "marker": "s"},
    )
    for colour, (network, schedules) in zip(PALETTE, sweep.items(), strict=False):
        for style, lost, (schedule, found) in zip(styles, "x+", schedules.items(), strict=True):
            good = np.array([each["converged"] for each in found])
            style |= {"color": colour, "markersize": 4.0, "linewidth": 1.2}
            for key in keys:
                y = np.clip([each[key] for each in found], 1e-16, _FAR)
                label = f"{network}, {schedule}" if key == keys[0] else None
                ax.plot(at, np.where(good, y, np.nan), label=label, **style)
                if not good.all():
                    label = label and f"{label}: not converged"
                    bad = np.where(good, np.nan, y)
                    ax.plot(at, bad, lost, color=colour, markersize=7.0, label=label)


def methods(discrete: Methods, gaussian: Methods) -> Figure:
    """Errors against the largest cluster: a colour for each kind of network."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained")
    panels = (
        (left, discrete, "error_mean", "error of a marginal", "table entries"),
        (right, gaussian, "variance_error_mean", "relative error of a variance", "components"),
    )
    markers = {"Bethe": "s", "LTRIP": "^", "junction tree": "*"}
    style: dict[str, Any] = {"linestyle": "", "markersize": 9.0, "fillstyle": "none"}
    for ax, found, key, what, unit in panels:
        for colour, (network, by) in zip(PALETTE, found.items(), strict=False):
            joined = [numbers for name, numbers in by.items() if name.startswith("join graph")]
            x, y = ([numbers[k] for numbers in joined] for k in ("largest", key))
            ax.plot(x, y, "o-", color=colour, markersize=4.0, label=f"{network}, join graphs")
            for name, marker in markers.items():
                ax.plot(by[name]["largest"], by[name][key], marker, color=colour, **style)
        for name, marker in markers.items():
            ax.plot([], [], marker, color="black", label=name, **style)
        ax.set(xlabel=f"largest cluster [{unit}]", ylabel=f"mean {what}")
    figure.legend(
        *left.get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False
    )
    left.set_xscale("log", base=2)
    left.xaxis.set_major_formatter("{x:g}")
    right.xaxis.get_major_locator().set_params(integer=True)
    plt.close(figure)
    return figure


def scene(case: Case, truth: Mapping[pgm.Variable, Any], beliefs: Mapping[str, Any]) -> Figure:
    """The robot's path and the landmarks, as drawn and as believed."""
    figure, ax = plt.subplots(figsize=(7.0, 5.5), layout="constrained")
    poses = [v for v in case.hidden if v.template == pose]
    landmarks = [v for v in case.hidden if v.template != pose]
    path = np.array([truth[v] for v in poses])
    stars = np.array([truth[v] for v in landmarks])
    ax.plot(path[:, 0], path[:, 1], ".-", color="black", linewidth=0.8, label="true poses")
    ax.plot(stars[:, 0], stars[:, 1], "*", color="black", markersize=9, label="true landmarks")
    # Dashed, so that a belief beneath another is seen.
    for (name, posterior), colour, dash in zip(beliefs.items(), PALETTE, DASHES, strict=False):
        for template, group in ((pose, poses), (landmark, landmarks)):
            found = [as_gaussian(posterior[v]) for v in group]
            stack = pgm.Gaussian(template, [b.mean for b in found], [b.cov for b in found])
            pgm.plot.ellipses(
                stack, colour=colour, facecolor="none", linewidth=1.3, linestyle=dash, ax=ax
            )
        ax.plot([], [], dash, color=colour, label=f"{name}, 95 %")
    ax.set(aspect="equal", xlabel="east [m]", ylabel="north [m]")
    figure.legend(loc="outside upper center", ncols=4, frameon=False)
    plt.close(figure)
    return figure
