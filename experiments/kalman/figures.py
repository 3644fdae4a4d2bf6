"""Beliefs of a drive: 95 % ellipses, dots at the means, crosses where the robot was."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.kalman.comparison import Solved
from experiments.kalman.problems import Problem

Array = npt.NDArray[np.float64]


def drive(problem: Problem, solved: Solved) -> Figure:
    """The filtered beliefs of the first drive; the initial one black, but for the linear robot."""
    figure, ax = plt.subplots(figsize=(7.0, 4.4), layout="constrained")
    belief = solved.filtered[problem.state].run(0)
    start = 0 if problem.state.dimension == 2 else 1
    if start:
        _beliefs(ax, belief, slice(0, 1), "black", "initial belief")
    _beliefs(ax, belief, slice(start, None), problem.colour, f"{problem.title} filter")
    _finish(ax, solved.truth[0])
    ax.set_aspect("equal", adjustable="datalim")
    plt.close(figure)
    return figure


def smoothers(problems: dict[str, Problem], solved: dict[str, Solved]) -> Figure:
    """The same drives once messages have been sent back as well."""
    figure, axes = plt.subplots(
        1, len(problems), sharex=True, sharey=True, figsize=(14.0, 3.6), layout="compressed"
    )
    for ax, (name, problem) in zip(axes, problems.items(), strict=True):
        ours = solved[name]
        for posterior, colour in ((ours.filtered, "#999999"), (ours.smoothed, problem.colour)):
            belief = posterior[problem.state].run(0)
            _beliefs(ax, belief, slice(None), colour, str(posterior.kind))
        _finish(ax, ours.truth[0])
        ax.set_title(f"{problem.title} smoother")
        ax.set_aspect("equal")
        ax.label_outer()
    plt.close(figure)
    return figure


def _beliefs(ax: Axes, belief: pgm.Gaussian, steps: slice, colour: str, label: str) -> None:
    shown = pgm.Gaussian(belief.scope, belief.mean[steps], belief.cov[steps])
    pgm.plot.ellipses(shown, colour=colour, linewidth=1.3, ax=ax)
    ax.plot(*shown.mean[:, :2].T, "o", color=colour, markersize=4, label=label, zorder=3.0)


def _finish(ax: Axes, truth: Array) -> None:
    ax.plot(*truth[:, :2].T, "x", color="black", markersize=8, label="true position", zorder=4.0)
    ax.set(xlabel="east [m]", ylabel="north [m]")
    ax.legend(loc="upper left", fontsize="small")
