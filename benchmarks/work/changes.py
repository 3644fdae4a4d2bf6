"""Ordinary changes of the model of range and bearing, and of its data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

import pgm
from benchmarks.work import robots
from benchmarks.work.robots import DRIVE, DT, Array, Robots
from models.networks import landmark, pose, sighting, velocity
from models.sensors import range_bearing

MISSING = 1e-5  # of all measurements
NOISE_STD = (0.0, 0.03, 0.02)  # as `robots.MOTION_STD`, but for the first component
BIAS_STD, DRIFT_STD = 0.01, 0.001  # [rad/s], at the start and of the walk a step
bias = pgm.Variable("b", components=("drift",))


def missing(work: Robots) -> Robots:
    """One measurement in 100,000 is not taken, and one at the least."""
    places = work.runs * work.steps
    rng = np.random.default_rng(0)
    run, step = np.divmod(
        rng.choice(places, max(1, round(MISSING * places)), replace=False), work.steps
    )
    readings = work.readings.copy()
    readings[run, step] = np.nan
    return replace(work, readings=readings)


def second_state(work: Robots) -> Robots:
    """The heading drifts at a rate that walks at random.

    x' = drive(x, u) + (0, 0, Δt b) + n,    b' = b + w
    """
    prior = pgm.GaussianCPD(bias, mean=0.0, cov=BIAS_STD**2)
    walk = pgm.LinearGaussianCPD(bias, given={bias.previous: 1.0}, cov=DRIFT_STD**2)
    drive = pgm.NonlinearGaussianCPD(
        pose,
        given=(pose.previous, bias.previous, velocity),
        function=biased,
        cov=work.motion_cov,
        jacobian={pose.previous: biased_by_state, bias.previous: biased_by_bias},
    )
    network = work.network
    return replace(
        work, network=network.replace(prior=[*network.prior, prior], transition=[drive, walk])
    )


def no_jacobian(work: Robots) -> Robots:
    """The motion is given without a Jacobian."""
    drive = pgm.NonlinearGaussianCPD(
        pose, given=(pose.previous, velocity), function=DRIVE, cov=work.motion_cov
    )
    return replace(work, network=work.network.replace(transition=[drive]))


def without_jacobians(work: Robots, *, traced: bool) -> Robots:
    """No Jacobian is given: derivatives are those of traces, or else differences."""
    drive, sight = (f if traced else _untraced(f) for f in (DRIVE, range_bearing))
    motion = pgm.NonlinearGaussianCPD(
        pose, given=(pose.previous, velocity), function=drive, cov=work.motion_cov
    )
    sensor = pgm.NonlinearGaussianCPD(
        sighting, given=(pose, landmark), function=sight, cov=work.sensor_cov
    )
    return replace(work, network=work.network.replace(transition=[motion], observation=[sensor]))


def _untraced(function: Callable[..., Array]) -> Callable[..., Array]:
    """The same function, which has no trace, since it makes its arguments arrays of floats."""

    def called(*arguments: Array) -> Array:
        return function(*(np.asarray(each, dtype=float) for each in arguments))

    return called


def singular(work: Robots) -> Robots:
    """The first component moves without noise, in the model and in the drives."""
    return robots.draw(work.runs, work.steps, motion_std=NOISE_STD)


def grouped(work: Robots) -> Robots:
    """The sightings of a step are linearised as one vector."""
    (sensor,) = work.network.observation
    assert isinstance(sensor, pgm.NonlinearGaussianCPD)
    return replace(
        work,
        network=work.network.replace(
            observation=[
                pgm.NonlinearGaussianCPD(
                    sensor.child,
                    given=sensor.given,
                    function=sensor.function,
                    cov=work.sensor_cov,
                    jacobian=sensor.jacobian,
                    grouped=True,
                )
            ]
        ),
    )


def one_fewer(work: Robots) -> Robots:
    """All runs but the last."""
    return replace(work, readings=work.readings[:-1], truth=work.truth[:-1])


class OwnTaylor:
    """Taylor's formula as a user writes it: F = f'(μ), b = f(μ) − F μ."""

    def __call__(
        self, function: pgm.linearisers.BoundFunction, at: pgm.Gaussian
    ) -> pgm.AffineGaussian:
        """The affine Gaussian, without an error."""
        value, slope = function(at.mean), function.jacobian(at.mean)
        offset = value - np.einsum("...ij,...j->...i", slope, at.mean)
        size = value.shape[-1]
        return pgm.AffineGaussian(slope, offset, np.zeros((size, size)))


def biased(x: Array, b: Array, u: Array) -> Array:
    """The drive, with a drift of the heading, (..., 3)."""
    moved = DRIVE(x, u)
    moved[..., 2] += DT * b[..., 0]
    return moved


def biased_by_state(x: Array, b: Array, u: Array) -> Array:
    """Differentiate `biased` by the pose, (..., 3, 3)."""
    return DRIVE.by_state(x, u)


def biased_by_bias(x: Array, b: Array, u: Array) -> Array:
    """Differentiate `biased` by the bias, (..., 3, 1)."""
    return np.broadcast_to([[0.0], [0.0], [DT]], (*x.shape[:-1], 3, 1))
