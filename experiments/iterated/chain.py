"""A robot that circles past one landmark, seen by range and bearing."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import pgm
from experiments.iterated.case import Case
from experiments.unsettled import unsettled
from models import networks
from models.networks import landmark, pose, sighting, velocity

Array = npt.NDArray[np.float64]

STEPS = 25
# Steps at which all earlier ones are relinearised, the last among them.
ENDS = tuple(range(1, STEPS + 1, 4))
DT = 1.0  # s
CONTROL = (1.0, 0.4)  # m/s, rad/s
LANDMARK = np.array([2.0, 2.5])  # m
LINEARISERS: dict[str, pgm.Lineariser] = {
    "Taylor": pgm.Taylor(),
    "Cubature": pgm.Cubature(),
    "Unscented": pgm.Unscented(),
    "Unscented1e-3": pgm.Unscented(alpha=1e-3),
    "GaussHermite5": pgm.GaussHermite(5),
}
# A run whose errors have a root mean square above this has lost its way [m].
LOST = 1.0


def simulate(runs: int, seed: int) -> Case:
    """Draw drives of 25 steps, a sighting at each."""
    model = networks.range_bearing(
        DT,
        start_std=(0.3, 0.3, 0.6),
        motion_std=(0.05, 0.05, 0.05),
        sensor_std=(0.1, 0.05),
    )
    controls = np.tile(CONTROL, (STEPS, 1))
    inputs = {velocity: controls, landmark: pgm.constant(LANDMARK)}
    sample = model.sample(inputs, runs=runs, rng=seed)
    return Case(model, sample.evidence, pose, sample[pose], components=2, first=1, lost=LOST)


@unsettled()
def growing(case: Case, lineariser: pgm.Lineariser, iterations: int) -> Array:
    """Errors of the last position when all steps up to it are relinearised, (runs, ENDS).

    An iterated smoother of the first k readings has at step k what a filter has there, and may
    change its mind about all linearisations before.
    """
    errors = []
    for steps in ENDS:
        posterior = pgm.smooth(
            case.model,
            {
                velocity: case.evidence[velocity][..., :steps, :],
                sighting: case.evidence[sighting][..., :steps, :],
                landmark: case.evidence[landmark],
            },
            lineariser=lineariser,
            steps=steps,
            iterations=iterations,
            tolerance=1e-3,
        )
        last = posterior[pose].mean[:, -1, :2]
        errors.append(np.hypot(*np.moveaxis(last - case.truth[:, steps, :2], -1, 0)))
    return np.stack(errors, axis=-1)


def turned(belief: pgm.Gaussian, truth: Array) -> tuple[Array, Array]:
    """How far the robot is turned about the landmark, true error and claimed deviation [rad].

    The direction of the robot from the landmark, φ, is what no sighting tells: ranges and
    bearings stay the same when robot and heading turn about the landmark together.

    Returns
    -------
    error, std : ndarray
        (runs, steps) each, the deviation from the covariance of the position by ∂φ/∂(x, y).
    """
    east, north = np.moveaxis(belief.mean[..., :2] - LANDMARK, -1, 0)
    true_east, true_north = np.moveaxis(truth[..., :2] - LANDMARK, -1, 0)
    cross, dot = true_east * north - true_north * east, true_east * east + true_north * north
    slope = np.stack([-north, east], axis=-1) / (east**2 + north**2)[..., None]
    variance = np.einsum("...i,...ij,...j->...", slope, belief.cov[..., :2, :2], slope)
    return np.arctan2(cross, dot), np.sqrt(variance)
