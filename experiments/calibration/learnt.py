"""Calibration and noise of a recorded drive, learnt from its ranges as they were recorded.

The scale and offset of ranges are learnt in two ways: as a parameter, a constant of which the
likeliest value is sought; or as a static state of the network, of which there is a belief. Noise is
learnt with either.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from experiments.recordings import drives
from experiments.recordings.drives import Drive
from experiments.recordings.settings import SETTINGS
from experiments.unsettled import unsettled
from models import networks
from models.networks import calibration, distance, landmark, pose
from pgm import consistency
from pgm.learning import Covariance, Parameter

Array = npt.NDArray[np.float64]

# The start: ranges as recorded, and noise several times that of the ranges and the motion.
CALIBRATION = (1.0, 0.0)  # scale, offset [m]
SENSOR_STD = 2.0  # m
RATES = (0.2, 0.2, 0.05)  # after one second [m, m, rad]
# Standard deviations of the static state's prior, about that start.
PRIOR_STD = (0.2, 2.0)
# Rounding of models that are linearised is far below this part of a nat.
TOLERANCE = 1e-2
PLANE = ("east", "north")
NAMES = ("scale", "offset", "range", "east", "north", "heading")


@dataclass(frozen=True)
class Way:
    """A way to learn a calibration.

    Attributes
    ----------
    model : callable
        From a drive to the network at the start.
    learn : mapping
        As of `pgm.fit`.
    given : mapping
        Evidence of the start, beside the recording's.
    """

    model: Callable[[Drive], pgm.DynamicBayesianNetwork]
    learn: dict[pgm.Variable, Any]
    given: dict[pgm.Variable, Any]


def recorded(name: str, path: Path) -> Drive:
    """A drive with its ranges as they were recorded."""
    setting = SETTINGS[name]
    raw = replace(setting, sensors=(replace(setting.sensors[0], scale=1.0, offset=0.0),))
    return drives.laid(name, raw, drives.read(raw, path))


def step(drive: Drive) -> float:
    """The duration of a step, the median [s]."""
    return float(np.median(np.diff(drive.timeline.times)))


def parametric(
    drive: Drive, sensor_std: float = SENSOR_STD, rates: tuple[float, ...] = RATES
) -> pgm.DynamicBayesianNetwork:
    """The network of a drive whose sensor has the calibration as a parent.

    Steps have nearly one duration, and one covariance, so that each of its components can be
    learnt: of noise that is a function, of the duration for one, a factor alone can be.
    """
    base = drive.network()
    (moves,) = base.transition
    assert isinstance(moves, pgm.NonlinearGaussianCPD)
    cov = np.diag(np.square(rates)) * step(drive)
    return base.replace(
        transition=[
            pgm.NonlinearGaussianCPD(
                pose, moves.given, moves.function, cov, jacobian=moves.jacobian
            )
        ],
        observation=[networks.sees_range(sensor_std, calibration=calibration)],
    )


def static(drive: Drive) -> pgm.DynamicBayesianNetwork:
    """The network with the calibration as a state that stays, as in `networks.calibrated_range`."""
    base = parametric(drive)
    prior = pgm.GaussianCPD(calibration, CALIBRATION, np.diag(np.square(PRIOR_STD)))
    return base.replace(
        prior=[*base.prior, prior], transition=[*base.transition, networks.stays(calibration)]
    )


_NOISE = {distance: Covariance(), pose: Covariance("diagonal")}
WAYS = {
    "parameter": Way(
        parametric,
        {calibration: Parameter(CALIBRATION, lower=(0.5, -10.0), upper=(2.0, 10.0)), **_NOISE},
        {calibration: pgm.constant(np.array(CALIBRATION))},
    ),
    "state": Way(static, _NOISE, {}),
}


@unsettled()
def learnt(drive: Drive, way: Way, iterations: int) -> tuple[dict[str, Any], pgm.results.Posterior]:
    """The way from the start to the end, and the posterior there.

    Keys are ``start`` and ``end``, each with the parameters by name, the errors of filter and
    smoother and the log-evidence; ``std``, of the parameters that are states; ``log_evidence``
    after each iteration; and ``status``.
    """
    model = way.model(drive)
    before = pgm.smooth(model, {**drive.evidence, **way.given})
    found = pgm.fit(
        model, drive.evidence, learn=way.learn, iterations=iterations, tolerance=TOLERANCE
    )
    after, status = found.posterior, found.status
    result: dict[str, Any] = {
        "start": {**_noise(drive, model), **judged(drive, before)},
        "end": {**_noise(drive, found.model), **judged(drive, after)},
        "log_evidence": found.log_evidence,
        "status": {
            "iterations": status.iterations,
            "e_steps": status.e_steps,
            "converged": status.converged,
            "stopped": status.stopped,
        },
    }
    result["start"] |= _named(np.array(CALIBRATION))
    if calibration in found.parameters:
        result["end"] |= _named(found.parameters[calibration])
        result["std"] = {}
    else:
        belief = after[calibration]
        result["end"] |= _named(belief.mean[-1])
        result["std"] = _named(belief.std[-1])
    return result, after


def fitted(drive: Drive) -> tuple[dict[str, Any], pgm.results.Posterior]:
    """The calibration fitted with the truth, told as that of an end, of ranges as recorded.

    ``residual`` is the standard deviation of the ranges about those of the true places [m], at the
    fitted calibration: what the noise of a range ought to be.
    """
    setting = SETTINGS[drive.name]
    (radio,) = setting.sensors
    model = parametric(drive, radio.std[0], setting.rates)
    values = np.array([radio.scale, radio.offset])
    posterior = pgm.smooth(model, {**drive.evidence, calibration: pgm.constant(values)})
    result = {**_named(values), **_noise(drive, model), **judged(drive, posterior)}
    return {**result, "residual": residual(drive, *values)}, posterior


def residual(drive: Drive, scale: float, offset: float) -> float:
    """The standard deviation of ranges about those of the true places [m]."""
    heard = drive.evidence[distance]
    assert drive.truth is not None
    places = np.asarray(heard.given[landmark])[:, :2]
    apart = np.linalg.norm(drive.truth[np.asarray(heard.step), :2] - places, axis=-1)
    return float(np.nanstd(np.asarray(heard.values)[:, 0] - scale * apart - offset))


def judged(drive: Drive, posterior: pgm.results.Posterior) -> dict[str, float]:
    """Errors of the position against the truth [m], and the log-evidence."""
    assert drive.truth is not None
    return {
        "filter": float(consistency.rmse(posterior.filtered[pose], drive.truth, PLANE)),
        "smoother": float(consistency.rmse(posterior[pose], drive.truth, PLANE)),
        "total": float(posterior.log_evidence),
    }


def _named(values: Array) -> dict[str, float]:
    return dict(zip(NAMES, values.tolist(), strict=False))


def _noise(drive: Drive, model: pgm.DynamicBayesianNetwork) -> dict[str, float]:
    """Standard deviations of a range [m], and of the motion after one second [m, m, rad]."""
    sees: Any = model.observation[0]
    moves: Any = model.transition[0]
    stds = np.sqrt([sees.cov[0, 0], *np.diagonal(moves.cov) / step(drive)])
    return dict(zip(NAMES[2:], stds.tolist(), strict=True))
