"""One step of a robot that moves, turns, and reads its heading: the numbers of a lecture.

The example is that of the lecture Intelligent Robotics (Hamburg, 2019): from an exactly
known pose (0, 0, 0) the robot moves 1 m and then turns by 1.6 rad, with variances 0.01 |d| and
0.01 |φ|; an inertial unit reads a heading of 2.0 rad with variance 0.01.
"""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Wedge

import pgm
import pgm.plot
from experiments.record import Out, Record
from models import networks
from models.networks import compass, move, pose
from pgm.plot.drawing.colours import INK, PALETTE

DISTANCE, TURN = 1.0, 1.6  # m, rad
READING = 2.0  # rad
RATE = 0.01  # variance by metre and by radian
PRINTED_RATE = 0.1  # what 0.16 in place of 0.01 · 1.6 = 0.016 amounts to
SENSOR_STD = 0.1  # rad: the variance 0.01
# As the reference prints them; it rounds the variance 0.16 / 17 = 0.0094 to 0.01.
PRINTED = {"gain": 16 / 17, "mean": 1.98, "variance": 0.01}
LINEARISERS: dict[str, pgm.Lineariser] = {
    "Taylor": pgm.Taylor(),
    "Unscented": pgm.Unscented(),
    "Cubature": pgm.Cubature(),
}
QUICK: dict[str, Any] = {}


def run(out: Out = None) -> None:
    """One step of a robot that moves, turns, and reads its heading, from an exactly known pose."""
    record = Record("imu_heading", out, distance=DISTANCE, turn=TURN, reading=READING)
    posterior = step(RATE)
    closed, ours = closed_form(RATE), numbers(posterior)
    slipped = numbers(step(PRINTED_RATE))
    record.table(
        "The heading [rad]: its variance before the reading, and what the reading makes of it",
        ("whose", "before", "gain", "mean", "variance"),
        [
            ("ours", *_row(ours)),
            ("closed form", *_row(closed)),
            ("reference, as printed", 0.16, "16/17", PRINTED["mean"], PRINTED["variance"]),
            ("ours with 0.16 for 0.016", *_row(slipped)),
        ],
        about="Before: the predicted variance [rad²]; gain: what share of the innovation the mean "
        "takes; mean [rad] and variance [rad²] after the reading.",
    )
    record.note(
        "The heading's variance grows by 0.01 · 1.6 = 0.016. The reference writes 0.16, and its "
        "gain 16/17, mean 1.98 and variance 0.16/17 = 0.0094 (rounded to 0.01) follow from that; "
        "0.016 gives 8/13, 1.846 and 0.00615."
    )
    spread = largest_difference({name: step(RATE, rule) for name, rule in LINEARISERS.items()})
    refusal = canonical_start(posterior)
    record.note(
        "The first covariance is zero, so that the first belief has no canonical form (asking for "
        f"it: “{refusal}”); its mean and covariance are ordinary, and the filter runs on them. "
        "With nothing unknown to linearise about, every lineariser is exact here: Taylor, "
        f"unscented and cubature differ by {spread:.1g} at most. No noise ties the heading to the "
        "position, so that the reading says nothing about the latter."
    )
    record.figure(
        figure(posterior),
        "poses",
        "Left, in metres: the known first pose, the predicted one and the one after the reading; "
        "the 95 % ellipse of the position is the same for both, the wedges hold the heading with "
        "95 %. Right: the heading's densities; dotted, where the reference's slip leads.",
    )
    position = posterior[pose].cov[-1][:2, :2]
    record.summary(
        ours=ours | {"position_cov": position},
        closed_form=closed,
        printed=PRINTED,
        with_the_slip=slipped,
        largest_difference_of_linearisers=spread,
        canonical_start=refusal,
        log_evidence=float(posterior.log_evidence),
    )


def step(heading_rate: float, lineariser: pgm.Lineariser | None = None) -> pgm.results.Posterior:
    """The step's posterior, where the heading's variance grows by a rate [rad²/rad]."""
    network = networks.turn_after_move(
        position_rate=RATE, heading_rate=heading_rate, sensor_std=SENSOR_STD
    )
    evidence = {move: np.array([[DISTANCE, TURN]]), compass: np.array([[READING]])}
    return pgm.filter(network, evidence, lineariser=lineariser or pgm.Taylor())


def numbers(posterior: pgm.results.Posterior) -> dict[str, Any]:
    """The filter's gain of the heading, P Hᵀ S⁻¹ of its own covariances."""
    predicted, after = posterior.predicted[pose], posterior[pose]
    innovation = posterior.innovations[compass]
    return {
        "predicted_mean": predicted.mean[-1],
        "predicted_variance": float(predicted.cov[-1, 2, 2]),
        "gain": float(predicted.cov[-1, 2, 2] / innovation.cov[0, 0, 0]),
        "mean": float(after.mean[-1, 2]),
        "variance": float(after.cov[-1, 2, 2]),
    }


def closed_form(heading_rate: float) -> dict[str, Any]:
    """The same by hand: one scalar Kalman update."""
    before, sensor = heading_rate * TURN, SENSOR_STD**2
    gain = before / (before + sensor)
    return {
        "predicted_mean": [DISTANCE, 0.0, TURN],
        "predicted_variance": before,
        "gain": gain,
        "mean": TURN + gain * (READING - TURN),
        "variance": (1.0 - gain) * before,
    }


def largest_difference(posteriors: dict[str, pgm.results.Posterior]) -> float:
    """How far moments of the linearisers' posteriors are apart."""
    beliefs = [posterior[pose] for posterior in posteriors.values()]
    means, covs = np.array([b.mean for b in beliefs]), np.array([b.cov for b in beliefs])
    return float(max(np.ptp(means, axis=0).max(), np.ptp(covs, axis=0).max()))


def canonical_start(posterior: pgm.results.Posterior) -> str:
    """The error for asking for the first belief as a canonical form."""
    try:
        posterior.belief(0)
    except pgm.NumericalError as error:
        return str(error)
    return ""


def figure(posterior: pgm.results.Posterior) -> Figure:
    """The poses on a map, and the densities of the heading."""
    result, (chart, lines) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    _draw_poses(posterior, chart)
    _draw_densities(posterior, lines)
    plt.close(result)
    return result


def _row(found: dict[str, Any]) -> tuple[float, float, float, float]:
    return found["predicted_variance"], found["gain"], found["mean"], found["variance"]


def _draw_poses(posterior: pgm.results.Posterior, ax: Axes) -> None:
    predicted, after = posterior.predicted[pose], posterior[pose]
    shown = (
        ("known start", after.mean[0], after.cov[0], INK, 0.45),
        ("predicted", predicted.mean[-1], predicted.cov[-1], PALETTE[0], 0.62),
        ("after the reading", after.mean[-1], after.cov[-1], PALETTE[1], 0.8),
    )
    for label, mean, cov, colour, length in shown:
        spread = np.degrees(1.96 * np.sqrt(cov[2, 2]))
        course = np.degrees(mean[2])
        if spread > 0.0:
            ax.add_patch(
                Wedge(mean[:2], length, course - spread, course + spread, color=colour, alpha=0.2)
            )
        tip = length * np.array([np.cos(mean[2]), np.sin(mean[2])])
        ax.annotate(
            "",
            mean[:2] + tip,
            mean[:2],
            arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8, "shrinkA": 0},
        )
        ax.plot(*mean[:2], "o", color=colour, markersize=5, label=label)
    pgm.plot.ellipses(pgm.Gaussian(pose, after.mean[-1], after.cov[-1]), colour=PALETTE[1], ax=ax)
    ax.set(xlim=(-0.25, 1.75), ylim=(-0.45, 1.0), xlabel="east [m]", ylabel="north [m]")
    ax.set_aspect("equal")
    ax.legend(loc="upper left", fontsize="small")


def _draw_densities(posterior: pgm.results.Posterior, ax: Axes) -> None:
    ours, slipped = numbers(posterior), numbers(step(PRINTED_RATE))
    heading = np.linspace(1.1, 2.5, 500)
    curves = (
        ("predicted", TURN, ours["predicted_variance"], PALETTE[0], "-"),
        ("the reading's likelihood", READING, SENSOR_STD**2, PALETTE[2], "--"),
        ("after the reading", ours["mean"], ours["variance"], PALETTE[1], "-"),
        ("with 0.16 for 0.016", slipped["mean"], slipped["variance"], INK, ":"),
    )
    for label, mean, variance, colour, style in curves:
        density = np.exp(-0.5 * (heading - mean) ** 2 / variance) / np.sqrt(2 * np.pi * variance)
        ax.plot(heading, density, color=colour, ls=style, lw=1.8, label=label)
    ax.set(xlabel="heading [rad]", ylabel="density [1/rad]", ylim=(0.0, None))
    ax.legend(loc="upper left", fontsize="small")
