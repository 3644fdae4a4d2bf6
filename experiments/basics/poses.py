"""A robot's pose in the plane, and the velocities that lead from one pose to the next."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, FancyArrowPatch

from models.motion import Velocity
from pgm.plot.drawing.colours import CLUSTER, INK, MUTED, PALETTE

Array = npt.NDArray[np.float64]

POSE = np.array([3.0, 2.0, 0.7])  # east [m], north [m], heading [rad]
BEFORE = np.array([1.2, 1.0, 0.5])
VELOCITIES = np.array([2.4, 0.45])  # [m/s, rad/s]
DT = 1.5  # s
_RADIUS = 0.42  # of the robot


def pose() -> Figure:
    """One pose: where the robot is, and the way it looks."""
    figure, ax = plt.subplots(figsize=(4.6, 3.3), layout="constrained")
    _robot(ax, POSE, "t")
    _heading(ax, POSE, "t")
    _frame(ax, (4.6, 3.2))
    plt.close(figure)
    return figure


def two_poses() -> Figure:
    """A pose and the next, and the directions of the two velocities."""
    figure, ax = plt.subplots(figsize=(5.6, 4.6), layout="constrained")
    after = Velocity(DT)(BEFORE, VELOCITIES)
    parts = np.linspace(0.0, 1.0, 60)
    path = np.array([Velocity(DT * part)(BEFORE, VELOCITIES) for part in parts[1:]])
    path = np.concatenate([BEFORE[None], path])
    ax.plot(*path[:, :2].T, "--", color=MUTED, lw=1.2, zorder=1.0)
    _robot(ax, BEFORE, "t−1")
    _robot(ax, after, "t")
    _heading(ax, BEFORE, "t−1")
    _heading(ax, after, "t")

    middle = path[len(path) // 2]
    way = np.array([np.cos(middle[2]), np.sin(middle[2])])
    side = np.array([-way[1], way[0]])
    _arrow(ax, middle[:2], middle[:2] + 0.9 * way, PALETTE[1])
    x, y = middle[:2] + 0.55 * way - 0.25 * side
    ax.text(x, y, "$v_t$", color=PALETTE[1], ha="center")
    # The robot turns to the left, anticlockwise, at a positive ω.
    start, end = middle[:2] + 0.55 * (0.5 * way + side), middle[:2] - 0.55 * (0.5 * way - side)
    _arrow(ax, start, end, PALETTE[2], bend=0.5)
    x, y = middle[:2] + side
    ax.text(x, y, "$\\omega_t$", color=PALETTE[2], ha="center", va="center")
    _frame(ax, (5.6, 4.7))
    plt.close(figure)
    return figure


def step_by_formula() -> Array:
    """The next pose by equation (3.12), without its noise."""
    (x, y, theta), (v, omega) = BEFORE, VELOCITIES
    turned = theta + omega * DT
    return np.array(
        [
            x + v / omega * (np.sin(turned) - np.sin(theta)),
            y - v / omega * (np.cos(turned) - np.cos(theta)),
            turned,
        ]
    )


def _robot(ax: Axes, at: Array, time: str) -> None:
    """A disc, its nose, and its coordinates on the axes."""
    x, y, heading = at
    ax.add_patch(Circle((x, y), _RADIUS, facecolor=CLUSTER, edgecolor=INK, lw=1.2, zorder=2.0))
    nose = np.array([np.cos(heading), np.sin(heading)])
    _arrow(ax, at[:2], at[:2] + 1.9 * _RADIUS * nose, INK)
    ax.plot(x, y, "o", color=INK, markersize=3, zorder=3.0)
    ax.plot([x, x, 0.0], [0.0, y, y], ":", color=MUTED, lw=1.0, zorder=0.5)
    ax.annotate(f"$x_{{{time}}}$", (x, 0.0), (0, -14), textcoords="offset points", ha="center")
    ax.annotate(
        f"$y_{{{time}}}$", (0.0, y), (-6, 0), textcoords="offset points", ha="right", va="center"
    )


def _heading(ax: Axes, at: Array, time: str) -> None:
    """The angle of a pose, from east."""
    x, y, heading = at
    reach = 2.0 * _RADIUS * 1.35
    ax.plot([x, x + 0.75 * reach], [y, y], color=MUTED, lw=0.9, zorder=2.5)
    ax.add_patch(
        Arc((x, y), reach, reach, theta2=np.degrees(heading), color=INK, lw=1.1, zorder=2.6)
    )
    half = 0.5 * heading
    ax.text(
        x + 0.62 * reach * np.cos(half),
        y + 0.62 * reach * np.sin(half),
        f"$\\theta_{{{time}}}$",
        ha="left",
        va="center",
    )


def _arrow(ax: Axes, start: Array, end: Array, colour: str, bend: float = 0.0) -> None:
    ax.add_patch(
        FancyArrowPatch(
            tuple(start),
            tuple(end),
            arrowstyle="-|>",
            mutation_scale=13,
            color=colour,
            lw=1.6,
            shrinkA=0,
            shrinkB=0,
            connectionstyle=f"arc3,rad={bend}",
            zorder=3.0,
        )
    )


def _frame(ax: Axes, size: tuple[float, float]) -> None:
    """Axes with arrows, from the origin."""
    width, height = size
    _arrow(ax, np.zeros(2), np.array([width, 0.0]), INK)
    _arrow(ax, np.zeros(2), np.array([0.0, height]), INK)
    ax.annotate("x, east", (width, 0.0), (0, 6), textcoords="offset points", ha="right")
    ax.annotate("y, north", (0.0, height), (6, 0), textcoords="offset points", va="top")
    ax.set(xlim=(-0.75, width + 0.1), ylim=(-0.55, height + 0.1))
    ax.set_aspect("equal")
    ax.axis("off")
