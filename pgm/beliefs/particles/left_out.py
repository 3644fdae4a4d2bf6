r"""The beliefs of a sensor's readings given all readings but their own, of smoothed particles.

Smoothed particles x_i of a reading's step, of weights w_i, know the reading z. Without it they have
the weights

.. math:: w_i^- \propto w_i / p(z \mid x_i),

the largest of which are smoothed by a fitted Pareto distribution. Its shape k tells whether they
can be trusted: where a reading is sharper than what the others tell, particles lie where it puts
them, and a few decide all. From k = 0.7 on, errors are large and the figures do not show them.

Vehtari, Gelman & Gabry, Practical Bayesian model evaluation using leave-one-out cross-validation
and WAIC, 2017; Vehtari, Simpson, Gelman, Yao & Gabry, Pareto smoothed importance sampling, 2024.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from pgm.beliefs.points.cloud import Cloud
from pgm.beliefs.points.laws import Some
from pgm.beliefs.points.measurements import left_out
from pgm.beliefs.points.model import ParticleModel, Sensor
from pgm.beliefs.points.point_mixture import PointMixture
from pgm.errors import ParticleWarning, levels_to_user
from pgm.kernels import pareto
from pgm.kernels.arrays import Array

# The Pareto shape above which a reading's weights are not to be trusted.
UNSOUND = 0.7


def without_each(model: ParticleModel, sensor: Sensor, clouds: Sequence[Cloud]) -> PointMixture:
    """The beliefs of a sensor's readings, each left out, in the order of the evidence.

    `clouds` are the smoothed ones by step. A ParticleWarning tells of readings whose weights are
    not to be trusted.
    """
    steps = sensor.reading.step.tolist()
    found, shapes = [], np.full((len(steps), model.bound.runs), np.nan)
    for row, step in enumerate(steps):
        cloud, shapes[row] = _without(sensor, row, step, clouds[step])
        found.append(cloud)
    mixture = left_out(model, sensor.reading, found, shapes)
    _warn(mixture)
    return mixture


def _without(sensor: Sensor, row: int, step: int, cloud: Cloud) -> tuple[Cloud, Array]:
    """A cloud without one of its step's readings, and the shape of its weights, (runs,)."""
    log_density = np.zeros(len(cloud.log_weights))
    for block in cloud.blocks():
        at = slice(block.first, block.last)
        states = cloud.states[:, at]
        some = Some(step, states, states, None if cloud.runs == 1 else cloud.owner[at])
        sensor.add(row, some, log_density[at])
    # Where no particle explained the reading, it was ignored, and has nothing to be removed.
    log_weights = cloud.log_weights - np.where(np.isneginf(log_density), 0.0, log_density)
    taken = np.broadcast_to(sensor.reading.taken[row].any(axis=-1), cloud.runs)
    shapes = np.full(cloud.runs, np.nan)
    for run in np.flatnonzero(taken).tolist():
        own = cloud.of(run)
        log_weights[own], shapes[run] = pareto.smoothed(log_weights[own])
    return cloud.normalised(log_weights)[0], shapes


def _warn(found: PointMixture) -> None:
    """Warn of readings that are sharper than particles can leave out."""
    assert found.pareto is not None
    if not (found.pareto > UNSOUND).any():
        return
    warnings.warn(
        f"left_out[{found.variable!r}]: readings whose .pareto is above {UNSOUND:g} cannot be left "
        "out by weights: a few particles decide, .effective says how many; smooth again without "
        "such a reading, NaN in its place, or take more particles",
        ParticleWarning,
        stacklevel=levels_to_user(),
    )
