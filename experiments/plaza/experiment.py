"""A recorded robot among radio beacons: filters and smoothers against satellite positions."""

from __future__ import annotations

from typing import Any

import numpy as np

import pgm
from experiments.plaza import figures
from experiments.plaza import log as plaza_log
from experiments.plaza.log import SETTINGS, Data, File, Log, Setting
from experiments.record import Out, Record, Seed, progress
from models import networks
from models.networks import distance, pose
from pgm import consistency

QUICK = {"data": "plaza1"}
LINEARISERS: dict[str, pgm.Lineariser] = {"Taylor": pgm.Taylor(), "Unscented": pgm.Unscented()}


def run(
    out: Out = None,
    seed: Seed = 0,
    data: Data = None,
    path: File = None,
) -> None:
    """Filter and smooth a recorded mower that hears its distance to four beacons."""
    files = plaza_log.chosen("plaza", data, path)
    if not files:
        return
    record = Record(
        "plaza", out, seed=seed, data=list(files), position_rate=plaza_log.POSITION_RATE
    )
    results: dict[str, Any] = {}
    rows = []
    for name, file in files.items():
        log = plaza_log.load(file, SETTINGS[name])
        record.note(f"{name}: {log.recording!r}")
        record.note(f"{name}: {log.timeline!r}")
        results[name], posteriors = localise(log, SETTINGS[name], name)
        record.figure(
            figures.path(log, posteriors["Taylor"]),
            f"{name}_path",
            f"The recording {name}, filtered and smoothed with Taylor; places in metres. Over the "
            "whole drive (left) the paths hide each other; the part that is framed is enlarged on "
            "the right: there the filter strays most, and the smoother, which knows later ranges "
            f"too, stays nearer to the truth. Ellipses hold 95 % of a belief, {figures.RINGS} of "
            "each along the part. Below, how far each is from the satellite positions.",
        )
        record.figure(
            figures.errors(log, posteriors["Taylor"]),
            f"{name}_errors",
            f"Errors of {name} [m] over time [s], in bands of three standard deviations of each "
            "belief. The bands widen where beacons are silent; the smoother's are narrower, and "
            "errors outside them are jumps of the satellite positions or of ranges.",
        )
        rows.append((name, "dead reckoning", results[name]["dead_reckoning"], ""))
        rows += [
            (name, label, results[name][label]["filter"], results[name][label]["smoother"])
            for label in LINEARISERS
        ]
    record.table(
        "RMSE of the position over each recording [m]",
        ("data", "lineariser", "filter", "smoother"),
        rows,
        about="Against satellite positions. Dead reckoning has the odometry alone.",
        best={"filter": -np.inf, "smoother": -np.inf},
        within=("data",),
    )
    record.note(
        "Ranges were calibrated with the truth and the noise was tuned: these numbers check an "
        "engine, they claim no accuracy."
    )
    record.summary(**results)


def localise(
    log: Log, setting: Setting, name: str
) -> tuple[dict[str, Any], dict[str, pgm.results.Posterior]]:
    """Position RMSE of dead reckoning, and of each lineariser's filter and smoother."""
    model = networks.range_only(
        start=log.truth[0],
        start_std=plaza_log.START_STD,
        position_rate=plaza_log.POSITION_RATE,
        heading_rate=setting.heading_rate,
        sensor_std=setting.sensor_std,
    )
    plane = ("east", "north")
    evidence = log.timeline.evidence
    blind = {variable: value for variable, value in evidence.items() if variable != distance}
    reckoned = pgm.filter(model, blind)[pose]
    results: dict[str, Any] = {"dead_reckoning": consistency.rmse(reckoned, log.truth, plane)}
    posteriors = {}
    for label in progress(list(LINEARISERS), name):
        posterior = pgm.smooth(model, evidence, lineariser=LINEARISERS[label])
        posteriors[label] = posterior
        results[label] = {
            "filter": consistency.rmse(posterior.filtered[pose], log.truth, plane),
            "smoother": consistency.rmse(posterior[pose], log.truth, plane),
            "log_evidence": float(posterior.log_evidence),
        }
    return results, posteriors
