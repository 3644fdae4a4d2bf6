"""The Freiburg recording with the landmarks' identities hidden, and its odometry disturbed.

The reference is the smoothed path of the recording as it is, each sighting with its landmark. In
summary.json ``ways.<way>`` has the root mean square distance from it of the smoothed places [m]
(`error`), the normalised errors squared a component (`nees`), and the share of sightings that were
taken for the right landmark (`right`), as the step of the sighting had it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import typer
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.freiburg import log as recording
from experiments.path_errors import PLACE, errors
from experiments.record import Out, Record, Seed, note
from models import motion
from models.networks import landmark, odometry, pose, sighting
from models.networks.covariances import diagonal
from models.networks.observations import sees_landmark

QUICK: dict[str, Any] = {}
# Deviations of the recording's own sightings [m, rad], and of its motion a step [m, m, rad].
SENSOR_STD, MOTION_STD = (0.15, 0.07), np.array([0.03, 0.03, 0.02])
GATE = 0.9999
Array = npt.NDArray[np.float64]


def run(
    out: Out = None,
    seed: Seed = 0,
    path: Annotated[Path | None, typer.Option(help="The recording's folder.")] = None,
    disturbance: Annotated[
        float, typer.Option(min=0.0, help="Of each turn and way of the odometry [rad, m].")
    ] = 0.3,
) -> None:
    """A recorded robot does not know which landmarks it sees: the likeliest, or sums of all."""
    folder = path or recording.find()
    if folder is None:
        note(
            "unknown_landmarks: the recording is not there; give its folder with --path, or name "
            "the folder that holds it as freiburg/ in the environment variable "
            f"{recording.VARIABLE}"
        )
        return
    log = recording.load(folder)
    record = Record("unknown_landmarks", out, seed=seed, disturbance=disturbance)
    values = np.stack([log.ranges, log.sightings["bearing"]], axis=-1)
    drift = np.random.default_rng(seed).standard_normal(log.odometry.shape)
    odd = log.odometry + disturbance * drift
    named = pgm.sightings(values, step=log.step, given={landmark: log.places})
    wanted = pgm.smooth(_network(0.0), {odometry: log.odometry, sighting: named})[pose]
    model = _network(disturbance)

    def open_(**options: Any) -> Any:
        whose: dict[pgm.Variable, Any] = {landmark: pgm.unknown(log.landmarks, **options)}
        return pgm.sightings(values, step=log.step, given=whose)

    ways: dict[str, tuple[Any, pgm.Gaussians | None]] = {
        "named": (named, None),
        "the likeliest": (open_(gate=GATE, association="likelihood"), None),
        "joint compatibility": (open_(gate=GATE, association="joint"), None),
        "summed, 1": (open_(gate=GATE, association="sum"), pgm.Gaussians(1)),
        "exclusive, 4": (open_(gate=GATE, association="joint"), pgm.Gaussians(4)),
    }
    found: dict[str, dict[str, float]] = {}
    posteriors = {}
    for way, (seen, belief) in ways.items():
        posterior = pgm.smooth(model, {odometry: odd, sighting: seen}, belief=belief)
        posteriors[way] = posterior
        found[way] = _scores(posterior, wanted, None if way == "named" else log)
    record.table(
        f"Errors where odometry is disturbed by {disturbance} rad and m a step",
        ("whose a sighting is, Gaussians", "error [m]", "NEES", "right"),
        [(way, s["error"], s["nees"], s.get("right", "–")) for way, s in found.items()],
        about="Root mean square distance of the smoothed places from the smoothed path of the "
        "recording as it is; normalised errors squared a component, 1 where a belief is right "
        "about its errors; and the share of sightings taken for the right landmark, when they "
        "came. Named sightings of a step are linearised together, at the predicted pose; summed "
        "ones one after another, each at the pose that those before it leave.",
        best={"error [m]": -np.inf, "NEES": 1.0, "right": np.inf},
    )
    record.figure(
        _figure(posteriors, wanted, log.landmarks),
        "paths",
        "The smoothed paths of three ways, the reference, and the landmarks.",
    )
    record.summary(ways=found)


def _network(disturbance: float) -> pgm.DynamicBayesianNetwork:
    """The robot; both turns of a step are disturbed, and add up in its heading."""
    noise = np.hypot(MOTION_STD, disturbance * np.array([1.0, 1.0, np.sqrt(2.0)]))
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, np.zeros(3), cov=0.01)],
        transition=[
            pgm.NonlinearGaussianCPD(
                pose,
                given=(pose.previous, odometry),
                function=motion.odometry,
                cov=diagonal(noise.tolist()),
                jacobian={
                    pose.previous: motion.odometry_by_state,
                    odometry: motion.odometry_by_control,
                },
            )
        ],
        observation=[sees_landmark(SENSOR_STD)],
    )


def _scores(posterior: Any, wanted: Any, log: Any) -> dict[str, float]:
    own = errors(posterior.filtered[pose], posterior[pose], wanted.mean)
    found = {"error": own["smoother"], "nees": own["nees"]}
    if log is not None:
        taken = posterior.associations[sighting].candidate
        due = (log.places[:, None] == log.landmarks).all(axis=-1).argmax(axis=-1)
        found["right"] = float((taken == due).mean())
    return found


def _figure(posteriors: Any, wanted: Any, landmarks: Array) -> Figure:
    figure, ax = plt.subplots(figsize=(7.5, 5.5), layout="constrained")
    for way in ("exclusive, 4", "joint compatibility", "the likeliest"):
        pgm.plot.trajectory(
            posteriors[way][pose],
            truth=wanted.mean if way == "exclusive, 4" else None,
            landmarks=landmarks if way == "exclusive, 4" else None,
            components=PLACE,
            unit="m",
            label=way,
            every=1000,
            ax=ax,
        )
    plt.close(figure)
    return figure
