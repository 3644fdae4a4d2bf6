"""Robust smoothing of a recorded drive whose ranges are skewed."""

import os
from pathlib import Path

import numpy as np
import pytest

import pgm

HERE = Path(os.environ.get("PGM_DATA") or Path(__file__).parents[3] / "../shared/data")
PLACE = HERE / "labyrinth"

X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
U = pgm.Variable("u", components=("ahead", "turn", "dt"))
Z, M = pgm.Variable("z"), pgm.Variable("m", components=("east", "north"))


def drive(x, u):
    heading = x[..., 2] + 0.5 * u[..., 1]
    steps = [u[..., 0] * np.cos(heading), u[..., 0] * np.sin(heading), u[..., 1]]
    return x + np.stack(steps, axis=-1)


def far(x, m):
    return np.linalg.norm(m - x[..., :2], axis=-1, keepdims=True)


@pytest.mark.skipif(not PLACE.is_dir(), reason="the Labyrinth recording is not here: PGM_DATA")
def test_robust_smoothing_of_labyrinth():
    """Ranges calibrated by their mean error, as in the baseline, whose smoother has 0.039 m."""
    found = pgm.recordings.read_labyrinth(PLACE)
    ranges, wheels, truth = found.sightings["uwb"], found.velocities, found.truth.values
    dt = np.diff(wheels.stamps)[:, None]
    places = np.array([found.landmarks[subject] for subject in ranges.subject])
    heard = {M: places}
    evidence = {
        U: np.hstack([wheels.values[:-1] * dt, dt]),
        Z: pgm.sightings(
            ranges.values - 0.118, step=np.searchsorted(wheels.stamps, ranges.stamps), given=heard
        ),
    }

    def error(noise):
        spread = np.square([0.01, 0.01, 0.02])
        model = pgm.DynamicBayesianNetwork(
            prior=[pgm.GaussianCPD(X, [*truth[0], np.pi], np.square([0.1, 0.1, 0.3]))],
            transition=[
                pgm.NonlinearGaussianCPD(
                    X,
                    (X.previous, U),
                    drive,
                    pgm.noise(lambda u: spread * u[..., 2:], U, diagonal=True),
                )
            ],
            observation=[pgm.NonlinearGaussianCPD(Z, (X, M), far, 0.0857**2, noise=noise)],
        )
        smoothed = pgm.smooth(model, evidence, iterations=100)
        assert smoothed.status.converged
        off = smoothed[X].mean[:, :2] - truth
        return np.sqrt((off**2).sum(axis=1).mean())

    assert 0.0375 < error(None) < 0.040
    assert error(pgm.StudentT(3.0)) < 0.031
    assert error(pgm.Cauchy(2.385)) < 0.031
    assert error(pgm.TruncatedLeastSquares(2.5)) < 0.031
