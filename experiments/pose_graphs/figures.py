"""A pose graph: its poses before and after, and the errors of its edges."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy import stats

from experiments.pose_graphs.given import Given
from experiments.pose_graphs.solving import Solved
from models.pose_graphs import PoseGraphNetwork
from pgm.plot.drawing.colours import INK, MUTED, PALETTE
from pgm.recordings import PoseGraph

Array = npt.NDArray[np.float64]
# So many of the poses have their ellipse.
ELLIPSES = 60
MARGIN = 0.1


def paths(
    made: PoseGraphNetwork,
    starts: dict[str, tuple[Array, Array]],
    poses: Array,
    landmarks: Array,
    covs: Array,
) -> Figure:
    """The starts and the optimum, each on the plane."""
    panels = starts | {"optimum": (poses, landmarks)}
    figure, axes = plt.subplots(1, len(panels), figsize=(13, 4.8), layout="constrained")
    closing, size = _closing(made), ""
    for ax, (label, (at, marks)) in zip(axes, panels.items(), strict=True):
        ax.add_collection(
            LineCollection(list(at[closing, :2]), colors=PALETTE[1], lw=0.5, alpha=0.5)
        )
        ax.add_collection(LineCollection(list(at[_leading(made), :2]), colors=INK, lw=0.8))
        known = at[:, :2]
        if len(marks):
            ax.plot(*marks.T, "^", color=PALETTE[2], ms=4)
            known = np.concatenate([known, marks])
        if label == "optimum":
            size = _ellipses(ax, at, covs)
        low, high = known.min(axis=0), known.max(axis=0)
        spare = MARGIN * np.maximum(high - low, 0.2 * (high - low).max() + 1e-9)
        ax.update_datalim([low - spare, high + spare])
        ax.margins(0.0)
        ax.set(xlabel="east [m]", title=label)
        ax.set_aspect("equal", adjustable="datalim")
    axes[0].set_ylabel("north [m]")
    handles = [
        Line2D([0, 1], [0, 1], color=INK, lw=0.8, label="edges of the tree"),
        Line2D([0, 1], [0, 1], color=PALETTE[1], lw=1.0, label="edges that close it"),
        Line2D([0, 1], [0, 1], color=PALETTE[0], lw=0.8, label=f"95 % ellipses{size}"),
    ]
    if len(landmarks):
        handles.append(
            Line2D([0], [0], color=PALETTE[2], marker="^", ls="", ms=4, label="landmarks")
        )
    figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure


def errors(made: PoseGraphNetwork, begin: str, before: Array, after: Array) -> Figure:
    """The share of edges whose error is larger, before (what that is, in words) and after."""
    figure, ax = plt.subplots(figsize=(7.5, 4), layout="constrained")
    share = np.arange(len(before), 0, -1) / len(before)
    floor = 1e-6
    for label, each, colour in (
        (begin, before, PALETTE[1]),
        ("optimum", after, PALETTE[0]),
    ):
        ax.step(np.maximum(np.sort(each), floor), share, where="pre", color=colour, label=label)
    at = np.geomspace(1e-2, 30.0, 200)
    ax.plot(at, stats.chi2.sf(at, 3), color=MUTED, ls=":", label="χ² of three components")
    low = max(floor, min(float(np.median(after)) * 1e-3, 1e-2))
    ax.set(
        xscale="log",
        yscale="log",
        xlim=(low, 2.0 * max(float(before.max()), 30.0)),
        ylim=(0.5 / len(before), 1.5),
        xlabel="error rᵀΩr of an edge",
        ylabel="share of edges above it",
    )
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def misled(given: Given, wrong: PoseGraph, led: Mapping[str, Solved], least: float) -> Figure:
    """Poses of a graph with false closures by each noise, beside the truth.

    False closures are drawn whose weight is above the least.
    """
    assert given.truth is not None
    figure, axes = plt.subplots(2, 2, figsize=(10.0, 10.0), layout="constrained")
    false = slice(len(given.graph.edges), len(wrong.edges))
    closing = np.stack([wrong.edges.first[false], wrong.edges.second[false]], axis=1)
    for k, (ax, (title, solved)) in enumerate(zip(axes.flat, led.items(), strict=True)):
        ax.plot(*given.truth[:, :2].T, color=MUTED, lw=2.5, alpha=0.6)
        ax.plot(*solved.poses[:, :2].T, color=PALETTE[0], lw=0.8)
        lines = list(solved.poses[closing[solved.weights[false] > least], :2])
        ax.add_collection(LineCollection(lines, colors=PALETTE[1], lw=0.8, alpha=0.8))
        ax.set(
            title=title,
            xlabel="east [m]" if k >= 2 else "",
            ylabel="north [m]" if k % 2 == 0 else "",
        )
        ax.set_aspect("equal", adjustable="datalim")
    handles = [
        Line2D([0, 1], [0, 1], color=MUTED, lw=2.5, alpha=0.6, label="truth"),
        Line2D([0, 1], [0, 1], color=PALETTE[0], lw=0.8, label="poses"),
        Line2D([0, 1], [0, 1], color=PALETTE[1], lw=0.8, label="false closures that are used"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    plt.close(figure)
    return figure


def _leading(made: PoseGraphNetwork) -> npt.NDArray[np.intp]:
    pairs = [(b.parent, b.child) for b in made.branches if not b.sees]
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)


def _closing(made: PoseGraphNetwork) -> npt.NDArray[np.intp]:
    used = [b.edge for b in made.branches if not b.sees]
    rest = np.setdiff1d(np.arange(len(made.graph.edges)), used)
    return np.stack([made.graph.edges.first[rest], made.graph.edges.second[rest]], axis=1)


def _ellipses(ax: Axes, poses: Array, covs: Array) -> str:
    """Ellipses of some poses, and in words how much smaller they are drawn."""
    some = np.unique(np.linspace(0, len(poses) - 1, ELLIPSES).astype(int))
    values, vectors = np.linalg.eigh(covs[some])
    axes = 2.0 * np.sqrt(-2.0 * np.log(0.05) * values.clip(0.0))
    extent = np.ptp(poses[:, :2], axis=0).max()
    smaller = 1
    while np.median(axes[:, 1]) / smaller > 0.1 * extent > 0.0:
        smaller *= 10
    axes /= smaller
    angle = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    ax.add_collection(
        EllipseCollection(
            axes[:, 1],
            axes[:, 0],
            angle,
            units="xy",
            offsets=poses[some, :2],
            offset_transform=ax.transData,
            facecolors="none",
            edgecolors=PALETTE[0],
            lw=0.8,
        )
    )
    return "" if smaller == 1 else f", 1/{smaller} as large"
