"""Errors against numbers, ways of drawing anew, numbers over time, and the reference's pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogLocator, NullFormatter
from matplotlib.transforms import blended_transform_factory, offset_copy

import pgm
import pgm.plot
from experiments.differential_drive.problems import DT, LANDMARK, SCALE, Problem
from experiments.particle_counts.choices import Adapted, Drawn
from experiments.particle_counts.study import KALMAN, Study, label
from models.sensors import range_bearing
from pgm.plot.drawing.colours import INK, MUTED, PALETTE

Array = npt.NDArray[np.float64]

_PARTICLES, _READING = PALETTE[0], PALETTE[1]
_STYLES = {"exact": "-", "Taylor": "--", "Unscented": ":"}
_TITLE = 20.0  # points, over which a legend stands
HIGHEST = 1.4  # of the ratios drawn: few particles in few drives are anywhere
_PLACE = {"xlabel": "east [m]", "ylabel": "north [m]"}


def errors(studies: Mapping[str, Study]) -> Figure:
    """Distance from the exact answer, and RMSE in units of its RMSE, by the number of particles."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 5.2), layout="constrained")
    for k, (colour, (name, study)) in enumerate(zip(PALETTE, studies.items(), strict=False)):
        found, numbers = study.distances(), study.numbers()
        counts = np.array(list(found))
        beside = counts * 1.05 ** (k - 1)  # so that bars do not hide each other
        distance = np.array([(each.value, 2.0 * each.error) for each in found.values()]).T
        style: dict[str, Any] = {"color": colour, "fmt": "o", "markersize": 4, "capsize": 3}
        left.errorbar(beside, *distance, label=f"problem {name}", **style)
        fine = np.geomspace(counts[0], counts[-1])
        left.plot(fine, study.constant() * study.falling(fine), color=colour, lw=0.8)
        ratios = np.array([study.ratio(numbers[label(count)]) for count in counts]).T
        right.errorbar(beside, ratios[0], 2.0 * ratios[1], ls="-", lw=0.8, **style)
        for rule in study.kalman:
            if rule != "exact":
                right.axhline(
                    study.ratio(numbers[KALMAN[rule]])[0],
                    color=colour,
                    lw=1.2,
                    ls=_STYLES[rule],
                    label=f"{KALMAN[rule]}, {name}",
                )
    right.axhline(1.0, color=INK, lw=0.6, label="exact")
    left.set(xscale="log", yscale="log", ylabel="RMS distance from the exact mean [m]")
    left.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    left.yaxis.set_major_formatter("{x:g}")
    left.yaxis.set_minor_formatter(NullFormatter())
    right.set(xscale="log", ylabel="RMSE, that of the exact mean being 1", ylim=(0.94, HIGHEST))
    for ax in (left, right):
        ax.set_xlabel("particles")
        ax.grid(color=MUTED, alpha=0.25, lw=0.6)
    handles, labels = (
        one + other
        for one, other in zip(
            left.get_legend_handles_labels(), right.get_legend_handles_labels(), strict=True
        )
    )
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    plt.close(figure)
    return figure


def resamplers(found: Mapping[str, Drawn]) -> Figure:
    """Distance and spread of each way of drawing anew, with bars of two standard errors."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 2.8), sharey=True, layout="constrained")
    rows = np.arange(len(found))
    for ax, name, title in zip(
        axes,
        ("distance", "spread"),
        ("RMS distance from the exact mean [m]", "RMS error of ln p(z)"),
        strict=True,
    ):
        each = [getattr(drawn, name) for drawn in found.values()]
        ax.errorbar(
            [e.value for e in each],
            rows,
            xerr=[2.0 * e.error for e in each],
            fmt="o",
            color=_PARTICLES,
            capsize=3,
        )
        ax.set_xlabel(title)
        ax.grid(axis="x", color=MUTED, alpha=0.25, lw=0.6)
    axes[0].set_yticks(rows, list(found))
    axes[0].set_ylim(len(found) - 0.5, -0.5)
    plt.close(figure)
    return figure


def adapted(found: Mapping[str, Adapted]) -> Figure:
    """The numbers that KLD-sampling chose over time, and how wide the belief was."""
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(9, 5.6), sharex=True, layout="constrained")
    for colour, each in zip(PALETTE, found.values(), strict=False):
        times = DT * np.arange(each.number.shape[1])
        upper.fill_between(
            times, each.number.min(axis=0), each.number.max(axis=0), color=colour, alpha=0.2, lw=0
        )
        upper.plot(times, np.median(each.number, axis=0), color=colour, label=each.title)
        lower.plot(times, each.spread, color=colour)
    upper.set(yscale="log", ylabel="particles")
    upper.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(found), frameon=False)
    lower.set(yscale="log", ylabel="deviation of the place [m]", xlabel="time [s]")
    ticks = (0.2, 0.5, 1.0, 2.0, 5.0)
    lower.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    lower.minorticks_off()
    for ax in (upper, lower):
        ax.grid(color=MUTED, alpha=0.25, lw=0.6)
    plt.close(figure)
    return figure


def drives(study: Study, count: int) -> Figure:
    """A drive as particles and as a Kalman filter have it: the reference's figure 2."""
    room = ConstrainedLayoutEngine(compress=True, rect=(0.0, 0.0, 1.0, 0.9))  # a legend above
    figure, axes = plt.subplots(1, 2, figsize=(11, 5), sharex=True, sharey=True, layout=room)
    problem = study.problem
    followed, (rule, kalman) = study.particles[count], list(study.kalman.items())[-1]
    beliefs = {
        f"{count} particles": pgm.Gaussian(problem.state, followed.mean[0], followed.cov[0]),
        KALMAN[rule]: pgm.Gaussian(problem.state, kalman.mean[0], kalman.cov[0]),
    }
    for ax, (title, belief) in zip(axes, beliefs.items(), strict=True):
        ax.plot(*study.truth[0, :, :2].T, color=INK, lw=1.0, label="truth")
        ax.plot(*belief.mean[:, :2].T, color=_PARTICLES, lw=1.0, label="estimate")
        at = pgm.Gaussian(
            problem.state, belief.mean[problem.measured], belief.cov[problem.measured]
        )
        pgm.plot.ellipses(at, ax=ax, colour=_READING, facecolor="none")
        ax.plot([], [], "o", mfc="none", color=_READING, ms=8, label="95 %, after a reading")
        if problem.given:
            ax.plot(*LANDMARK, "^", color=INK, label="landmark")
        ax.set(title=title, **_PLACE)
        ax.set_aspect("equal", adjustable="box")
        ax.label_outer()
    above = blended_transform_factory(figure.transFigure, axes[0].transAxes)
    figure.legend(
        *axes[0].get_legend_handles_labels(),
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        bbox_transform=offset_copy(above, figure, y=_TITLE, units="points"),
        ncols=4,
        frameon=False,
    )
    plt.close(figure)
    return figure


def tracked(study: Study, count: int) -> Figure:
    """Readings beside those that particles and truth would give: the reference's figures 3, 4."""
    problem, followed = study.problem, study.particles[count]
    names = ("range [m]", "bearing [rad]") if problem.given else ("east [m]", "north [m]")
    steps = np.arange(problem.steps + 1)
    figure, axes = plt.subplots(2, 1, figsize=(9, 5.2), sharex=True, layout="constrained")
    truth, belief = _read(problem, study.truth[0]), _read(problem, followed.mean[0])
    readings = study.readings[0] if problem.given else study.readings[0] / np.array(SCALE)
    for k, (ax, name) in enumerate(zip(axes, names, strict=True)):
        ax.plot(DT * steps, truth[:, k], color=INK, lw=1.0, label="truth")
        ax.plot(DT * steps, belief[:, k], color=_PARTICLES, lw=1.2, label=f"{count} particles")
        ax.plot(DT * problem.measured, readings[:, k], "o", color=_READING, ms=4, label="readings")
        if not problem.given:
            std = np.sqrt(followed.cov[0, :, k, k])
            band = (belief[:, k] - 1.96 * std, belief[:, k] + 1.96 * std)
            ax.fill_between(DT * steps, *band, color=_PARTICLES, alpha=0.18, lw=0, label="95 %")
        ax.set_ylabel(name)
        ax.grid(color=MUTED, alpha=0.25, lw=0.6)
    axes[-1].set_xlabel("time [s]")
    axes[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    plt.close(figure)
    return figure


def _read(problem: Problem, states: Array) -> Array:
    """The reading without noise at each of some states, (T+1, 2): a sighting, or the place."""
    if not problem.given:
        return states[:, :2]
    return np.asarray(range_bearing(states, np.broadcast_to(LANDMARK, (len(states), 2))))
