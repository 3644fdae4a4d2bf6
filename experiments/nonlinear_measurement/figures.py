"""Figures: KL against cost, and what the posteriors look like."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

import pgm
import pgm.plot
from experiments.nonlinear_measurement.cases import HEADINGS, SENSORS
from experiments.nonlinear_measurement.study import EXACT, Solved, Study
from experiments.nonlinear_measurement.truth import draw
from pgm.plot.drawing.colours import INK, MUTED, PALETTE

# A colour and a marker for each rule, and a factor that puts rules of equal cost side by side.
STYLES = {
    "Taylor": (INK, "s", 1.0),
    "Unscented": (PALETTE[0], "o", 1.08),
    "Cubature": (PALETTE[5], "D", 0.92),
    "GaussHermite5": (PALETTE[2], "^", 1.1),
    "MonteCarlo10": (PALETTE[4], "v", 0.95),
    "MonteCarlo100": (PALETTE[4], "P", 0.95),
    "Antithetic10": (PALETTE[3], "X", 1.1),
    "IteratedCubature": (PALETTE[1], "*", 1.0),
    "IteratedSmoother": (PALETTE[1], "p", 0.9),
    "IteratedLag": (PALETTE[1], "d", 1.12),
    "TaylorSmoother": (INK, "p", 1.0),
}
SCENES = {"near": ("Unscented", "IteratedCubature"), "collinear": ("Cubature", "IteratedCubature")}
SCENE_HEADING = 0.6
# Whose 90th percentile of KL chooses the simulation shown.
_CHOSEN_BY = {"near": "Unscented", "collinear": "IteratedCubature"}
SCENES_CAPTION = (
    "Two simulations at s = 0.6 rad, with places drawn from their exact posteriors and ellipses of "
    "95 %; each is at the 90th percentile of KL, left of the unscented rule, right of iterated "
    "cubature. Left, points spread over the wide prediction take the bearing's bend for noise, and "
    "the ellipse is too large; at the posterior it fits. Right, two distances leave two places: "
    "iterating settles at one of them and is too sure of it."
)
_SIZES = (18.0, 40.0, 75.0)


def kl_against_cost(found: Study) -> Figure:
    """One panel a sensor; rules by colour and marker, s by size."""
    figure, axes = plt.subplots(2, 3, figsize=(12.0, 7.5), sharey=True, layout="constrained")
    panels = list(axes.flat)
    for ax, sensor in zip(panels, found.scores, strict=False):
        for rule, (colour, marker, aside) in STYLES.items():
            across = aside * found.costs[sensor][rule].evaluations
            kl = [found.scores[sensor][str(s)][rule].kl for s in HEADINGS]
            x = np.full(len(kl), across)
            ax.plot(x, kl, color=colour, linewidth=1.0, alpha=0.6)
            size = np.multiply(_SIZES, 1.8 if marker == "*" else 1.0)
            ax.scatter(x, kl, size, color=colour, marker=marker, edgecolor="white", linewidth=0.5)
        ax.set(title=SENSORS[sensor].title, xscale="log", yscale="log", xlim=(1.5, 400.0))
        ax.set_xticks([2, 5, 10, 20, 50, 100, 200], ["2", "5", "10", "20", "50", "100", "200"])
        ax.minorticks_off()
        ax.grid(which="major", color="#E5E5E5", linewidth=0.6)
        ax.set_axisbelow(True)
        ax.set_xlabel("evaluations of functions in a step")
    for ax in axes[:, 0]:
        ax.set_ylabel("mean KL(exact ‖ approximation) [nats]")
    for ax in axes[0, 1:]:
        ax.tick_params(labelleft=False)
    _legend(panels[-1])
    plt.close(figure)
    return figure


def scenes(solved: Mapping[tuple[str, str], Solved]) -> Figure:
    """Two posteriors and the ellipses of rules that are far from them, or near."""
    figure, axes = plt.subplots(1, len(SCENES), figsize=(13.0, 4.9), layout="constrained")
    for ax, (sensor, shown) in zip(axes, SCENES.items(), strict=True):
        one = solved[sensor, str(SCENE_HEADING)]
        order = np.argsort(one.kl[_CHOSEN_BY[sensor]])
        k = int(order[int(0.9 * (len(order) - 1))])
        run = int(one.kept[k])
        points = draw(one.case, run, 1500, seed=0)
        ax.plot(*points.T, ".", color=MUTED, markersize=2.0, alpha=0.5, label="exact posterior")
        for rule in (EXACT, *shown):
            belief = one.beliefs[rule].run(k)
            colour = MUTED if rule == EXACT else STYLES[rule][0]
            style = "--" if rule == EXACT else "-"
            name = "its moments" if rule == EXACT else rule
            label = name if rule == EXACT else f"{name}, KL {one.kl[rule][k]:.2g}"
            pgm.plot.ellipses(
                belief, colour=colour, facecolor="none", linewidth=1.8, linestyle=style, ax=ax
            )
            ax.plot(*belief.mean[:2], "+", color=colour, markersize=9)
            ax.plot([], [], style, color=colour, label=label)
        ax.plot(*one.case.truth[run, :2], "k*", markersize=11, label="drawn pose")
        _landmarks(ax, one, run)
        ax.set(title=f"{SENSORS[sensor].title}, s = {SCENE_HEADING:g} rad", aspect="equal")
        ax.set(xlabel="east [m]", ylabel="north [m]")
        ax.legend(fontsize="small", loc="lower right")
    plt.close(figure)
    return figure


def _landmarks(ax: Axes, one: Solved, run: int) -> None:
    """Landmarks and the circles of places that have the distances read from them."""
    places, readings = np.array(one.case.sensor.landmarks), one.case.readings[run]
    if len(places) > 1:
        ax.set(xlim=(-2.4, 4.4), ylim=(-2.0, 2.4))
    else:  # with room for the landmark, and for the legend
        (west, east), (south, north) = ax.get_xlim(), ax.get_ylim()
        east = max(east, places[0, 0]) + 0.3
        ax.set(xlim=(west, max(east, west + 2.2)), ylim=(min(south, 0.0), max(north, 1.2)))
    ax.plot(*places.T, "k^", markersize=8, label="landmark")
    for place, (distance, *_) in zip(places, readings, strict=True):
        ax.add_patch(Circle(tuple(place), distance, fill=False, color=MUTED, linewidth=0.8))
    ax.plot([], [], color=MUTED, linewidth=0.8, label="distance read")


def _legend(ax: Axes) -> None:
    ax.axis("off")
    for rule, (colour, marker, _) in STYLES.items():
        ax.plot([], [], marker, color=colour, markersize=7, label=rule)
    for s, size in zip(HEADINGS, _SIZES, strict=True):
        ax.scatter([], [], size, color=MUTED, label=f"s = {s:g} rad")
    ax.legend(loc="center", frameon=False, fontsize="medium", title="lower is nearer to exact")
