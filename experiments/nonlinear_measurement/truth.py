"""The exact posterior of both poses, its moments and log-evidence, by importance sampling.

The first heading θ₀ and the new position (x, y) are sampled; the new heading, which only a bearing
tells of, and the first position are Gaussian given these three and integrated in closed form:

    θ₀ ~ N(0, s²)        (x, y) | θ₀ ~ N(c (cos, sin)(θ₀ + ω/2), (p² + r²) I)
    θ' | θ₀ ~ N(θ₀ + ω, r_θ²)
    (x₀, y₀) | θ₀, x, y ~ N(g ((x, y) − c (cos, sin)(θ₀ + ω/2)), g r² I),  g = p² / (p² + r²)

Points are Sobol's: a quarter from the prior, the others from a product of Student's t along the
axes of a pilot's covariance, about its mean. Weights are the posterior over the density of the
mixture, so that no part of it is missed where it has two modes. The prior's points are the first
pilot; a simulation with a small effective sample takes its own result for another.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln, ndtri, stdtrit
from scipy.stats import qmc

from experiments.nonlinear_measurement.cases import (
    BEARING_STD,
    CONTROL,
    FIX_STD,
    MOTION_STD,
    RANGE_STD,
    START_STD,
    Array,
    Case,
    Sensor,
)

PRIOR_SHARE = 0.25
FREEDOM = 5.0
ROUNDS = 4
_BLOCK = 16  # simulations at a time, so that their points stay in the cache

_TURN = CONTROL[1]
_CHORD = CONTROL[0] * np.sin(_TURN / 2) / (_TURN / 2)
_PLACE = START_STD**2 + MOTION_STD[0] ** 2  # variance of either coordinate given θ₀
_BACK = START_STD**2 / _PLACE  # how much of the new position's surprise the first one takes
_HEADING = MOTION_STD[2] ** 2
# How much of a bearing's surprise the new heading takes, given the rest.
_GAIN = _HEADING / (_HEADING + BEARING_STD**2)


@dataclass(frozen=True, eq=False)
class Truth:
    """The exact beliefs that approximations are compared with.

    Attributes
    ----------
    poses_mean, poses_cov : ndarray
        (runs, 6), (runs, 6, 6): of the poses before and after the step given the readings.
    log_evidence : ndarray
        (runs,): ln p(readings).
    effective : ndarray
        (runs,): effective sample sizes.
    """

    poses_mean: Array
    poses_cov: Array
    log_evidence: Array
    effective: Array

    @property
    def mean(self) -> Array:
        """(runs, 3): of the pose after the step."""
        return self.poses_mean[:, 3:]

    @property
    def cov(self) -> Array:
        """(runs, 3, 3): of the pose after the step."""
        return self.poses_cov[:, 3:, 3:]


class _Cloud(NamedTuple):
    """Moments of (θ₀, x, y) and of both poses, log-evidence and effective sample sizes."""

    centre: Array
    spread: Array
    mean: Array
    cov: Array
    log_evidence: Array
    effective: Array


def posterior(case: Case, log2_points: int, enough: float, seed: int) -> Truth:
    """Moments of the poses given the readings, and log-evidence.

    Parameters
    ----------
    case : Case
    log2_points : int
        Base-2 logarithm of the number of points.
    enough : float
        The effective sample size below which a simulation is done again from a better pilot.
    seed : int
        Of the scrambling.
    """
    base = qmc.Sobol(3, seed=seed).random_base2(log2_points)
    share = int(PRIOR_SHARE * len(base))
    pilot = _prior_points(ndtri(base), case.heading_std)[:, None]
    prior, student = pilot[..., :share], np.asarray(stdtrit(FREEDOM, base[share:].T), dtype=float)
    clouds = []
    for first in range(0, len(case.readings), _BLOCK):
        z = case.readings[first : first + _BLOCK]
        cloud = _weigh(pilot, *log_likelihood(case.sensor, pilot, z))
        lost = np.full(len(z), True)
        for _ in range(ROUNDS):
            proposal = cloud.centre[lost], cloud.spread[lost]
            again = _sample(case, prior, student, *proposal, z[lost])
            for old, new in zip(cloud, again, strict=True):
                old[lost] = new
            lost = cloud.effective < enough
            if not lost.any():
                break
        clouds.append(cloud)
    joined = _Cloud(*(np.concatenate(part) for part in zip(*clouds, strict=True)))
    return Truth(*joined[2:])


def log_likelihood(sensor: Sensor, points: Array, z: Array) -> tuple[Array, Array]:
    """Log-likelihood ln p(z | θ₀, x, y), and a bearing's shift of θ'.

    Parameters
    ----------
    sensor : Sensor
    points : ndarray
        (3, b or 1, N): θ₀, x, y.
    z : ndarray
        (b, readings, d).

    Returns
    -------
    ndarray
        (b, N).
    ndarray
        (b, N), or () of 0 without a bearing.
    """
    heading, east, north = points
    if not sensor.landmarks:
        off = (z[:, 0, :1] - east) ** 2 + (z[:, 0, 1:] - north) ** 2
        return off / (-2.0 * FIX_STD**2) - np.log(2.0 * np.pi * FIX_STD**2), np.zeros(())
    log, shift = np.zeros(()), np.zeros(())
    for k, (m_east, m_north) in enumerate(sensor.landmarks):
        off = z[:, k, :1] - np.hypot(m_east - east, m_north - north)
        log = log - off**2 / (2.0 * RANGE_STD**2) - 0.5 * np.log(2.0 * np.pi * RANGE_STD**2)
        if sensor.bearing:
            bearing = np.arctan2(m_north - north, m_east - east) - heading - _TURN
            surprise = z[:, k, 1:] - bearing
            surprise -= 2.0 * np.pi * np.round(surprise / (2.0 * np.pi))
            variance = _HEADING + BEARING_STD**2
            log = log - surprise**2 / (2.0 * variance) - 0.5 * np.log(2.0 * np.pi * variance)
            shift = -_GAIN * surprise
    return log, shift


def _sample(
    case: Case, prior: Array, student: Array, centre: Array, spread: Array, z: Array
) -> _Cloud:
    """Weigh the prior's points and Student's t about a centre, (b, 3), by the mixture."""
    lower = np.linalg.cholesky(spread)
    drawn = np.einsum("bij,jn->ibn", lower, student) + centre.T[..., None]
    points = np.concatenate([np.broadcast_to(prior, (*drawn.shape[:2], prior.shape[2])), drawn], 2)
    off = points[..., : prior.shape[2]] - centre.T[..., None]
    white = np.linalg.solve(lower, off.transpose(1, 0, 2)).transpose(1, 0, 2)
    volume = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)[:, None]
    known = np.broadcast_to(_log_student(student), drawn.shape[1:])
    log_student = np.concatenate([_log_student(white), known], axis=1) - volume
    ratio = np.exp(np.minimum(log_student - _log_prior(points, case.heading_std), 700.0))
    log, shift = log_likelihood(case.sensor, points, z)
    return _weigh(points, log - np.log(PRIOR_SHARE + (1.0 - PRIOR_SHARE) * ratio), shift)


def _weigh(points: Array, log_weights: Array, shift: Array) -> _Cloud:
    """Moments of weighted points; a shift that is none comes with a heading's whole noise."""
    peak = log_weights.max(axis=1, keepdims=True)
    weights = np.exp(log_weights - peak)
    log_evidence = peak[:, 0] + np.log(weights.mean(axis=1))
    weights /= weights.sum(axis=1, keepdims=True)
    heading, east, north = points
    course = heading + _TURN / 2
    first = _BACK * (east - _CHORD * np.cos(course)), _BACK * (north - _CHORD * np.sin(course))
    poses = np.broadcast_arrays(*first, heading, east, north, heading + _TURN + shift)
    mean, cov = _moments(weights, poses)
    sampled = np.array([2, 3, 4])
    centre, spread = mean[:, sampled], cov[:, sampled[:, None], sampled]
    cov[:, [0, 1], [0, 1]] += _BACK * MOTION_STD[0] ** 2
    cov[:, 5, 5] += _HEADING * (1.0 - _GAIN if shift.ndim else 1.0)
    return _Cloud(centre, spread, mean, cov, log_evidence, 1.0 / np.sum(weights**2, axis=1))


def _moments(weights: Array, components: Iterable[Array]) -> tuple[Array, Array]:
    """Means (b, n) and covariances (b, n, n) of components (b or 1, N)."""
    parts = list(components)
    mean = np.stack([np.sum(weights * part, axis=1) for part in parts], axis=-1)
    off = [part - mean[:, k, None] for k, part in enumerate(parts)]
    cov = np.empty((*mean.shape, len(parts)))
    for i, a in enumerate(off):
        weighted = weights * a
        for j, b in enumerate(off[: i + 1]):
            cov[:, i, j] = cov[:, j, i] = np.sum(weighted * b, axis=1)
    return mean, cov


def _prior_points(normal: Array, heading_std: float) -> Array:
    """Points (3, N) of θ₀, x, y from standard normal ones, (N, 3)."""
    heading = heading_std * normal[:, 0]
    course = heading + _TURN / 2
    east = _CHORD * np.cos(course) + np.sqrt(_PLACE) * normal[:, 1]
    north = _CHORD * np.sin(course) + np.sqrt(_PLACE) * normal[:, 2]
    return np.stack([heading, east, north])


def _log_prior(points: Array, heading_std: float) -> Array:
    heading, east, north = points
    course = heading + _TURN / 2
    off = (east - _CHORD * np.cos(course)) ** 2 + (north - _CHORD * np.sin(course)) ** 2
    constant = np.log(heading_std * _PLACE) + 1.5 * np.log(2.0 * np.pi)
    return np.asarray(-0.5 * ((heading / heading_std) ** 2 + off / _PLACE) - constant)


def _log_student(t: Array) -> Array:
    """Log-density of three independent t's, over the first axis."""
    half = 0.5 * (FREEDOM + 1.0)
    constant = gammaln(half) - gammaln(0.5 * FREEDOM) - 0.5 * np.log(FREEDOM * np.pi)
    return np.asarray(3.0 * constant - half * np.log(np.prod(1.0 + t**2 / FREEDOM, axis=0)))


def draw(case: Case, run: int, count: int, seed: int) -> Array:
    """Places (count, 2) drawn from the exact posterior of one simulation, by resampling."""
    rng = np.random.default_rng(seed)
    points = _prior_points(rng.standard_normal((2**19, 3)), case.heading_std)
    log, _ = log_likelihood(case.sensor, points[:, None], case.readings[run : run + 1])
    weights = np.exp(log[0] - log.max())
    chosen = rng.choice(len(weights), count, p=weights / weights.sum())
    return points[1:, chosen].T
