"""Static states of a network at the noise that was tuned: range calibration, and a gyro's bias."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pgm
from experiments.plaza import log as plaza_log
from experiments.plaza.log import SETTINGS, Log, Setting
from experiments.record import progress
from models import networks
from models.networks import calibration, gyro_bias, pose, travelled
from pgm import consistency

# Standard deviations of the gyro's bias at first, and of its change after one second [rad/s].
BIAS_STD, BIAS_WALK = 0.02, 1e-4
ITERATIONS = 10
# Columns, and the components that stand in them.
UNKNOWN = {"scale": "scale", "offset [m]": "offset", "bias [rad/s]": "rate"}


def variants(file: Path, setting: Setting) -> Iterator[tuple[str, Log, pgm.DynamicBayesianNetwork]]:
    """Names of variants, logs and models of a recording, each told less than the one before."""
    plain = replace(setting, scale=1.0, offset=0.0)
    fitted, raw, own = (
        plaza_log.load(file, setting),
        plaza_log.load(file, plain),
        plaza_log.load(file, plain, every_stamp=True),
    )
    known: dict[str, Any] = {
        "start": fitted.truth[0],
        "start_std": plaza_log.START_STD,
        "position_rate": plaza_log.POSITION_RATE,
        "heading_rate": setting.heading_rate,
        "sensor_std": setting.sensor_std,
    }
    yield "ranges calibrated with the truth", fitted, networks.range_only(**known)
    model = networks.calibrated_range(**known)
    yield "scale and offset unknown", raw, model
    yield "and ranges at their own times", own, model
    rates = (known["position_rate"], known["position_rate"], known["heading_rate"])
    drifting = model.replace(
        prior=[*model.prior, pgm.GaussianCPD(gyro_bias, mean=0.0, cov=BIAS_STD**2)],
        transition=[
            networks.drifts(rates),
            *model.transition[1:],
            networks.walks(gyro_bias, BIAS_WALK, travelled),
        ],
    )
    yield "and the bias of the gyro unknown", own, drifting


def estimated(file: Path, name: str) -> dict[str, Any]:
    """Results of filter and smoothers, by what they are told."""
    return {
        label: found(log, model)
        for label, log, model in progress(list(variants(file, SETTINGS[name])), f"{name}, tuned")
    }


def found(log: Log, model: pgm.DynamicBayesianNetwork) -> dict[str, Any]:
    """Position errors [m] of filter and smoothers, and their last beliefs in what is unknown.

    ``result["iterated"]["scale"]`` is (mean, standard deviation).
    """
    smoothed = pgm.smooth(model, log.timeline.evidence)
    settled = pgm.smooth(model, log.timeline.evidence, iterations=ITERATIONS)
    result: dict[str, Any] = {"log_evidence": float(settled.log_evidence)}
    kinds: dict[str, Any] = {"filter": smoothed.filtered, "smoother": smoothed, "iterated": settled}
    for label, posterior in kinds.items():
        belief = posterior[pose]
        there = pgm.Gaussian(pose, belief.mean[log.steps], belief.cov[log.steps])
        result[label] = {"error": consistency.rmse(there, log.truth, ("east", "north"))}
        for state in (calibration, gyro_bias):
            if state in model.variables:
                mean, std = posterior[state].mean[-1], posterior[state].std[-1]
                told = zip(mean.tolist(), std.tolist(), strict=True)
                result[label] |= dict(zip(state.components, told, strict=True))
    return result


def columns(each: dict[str, Any]) -> list[object]:
    """The cells of a row."""
    told = (each["iterated"].get(key) for key in UNKNOWN.values())
    shown = ["" if of is None else f"{of[0]:.4f} ± {of[1]:.4f}" for of in told]
    errors = [each[kind]["error"] for kind in ("filter", "smoother", "iterated")]
    return [*errors, each["log_evidence"], *shown]
