"""The declared networks and the simulator."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from models import networks, simulation
from models.networks import landmark, pose, sighting, velocity
from pgm import consistency


def test_jacobians_change_nothing():
    """Given derivatives and numerical ones must agree in the network as it is wired."""
    network = networks.range_bearing(0.2)
    plain = network.replace(
        transition=[
            pgm.NonlinearGaussianCPD(c.child, c.given, c.function, c.cov)
            for c in network.transition
        ],
        observation=[
            pgm.NonlinearGaussianCPD(c.child, c.given, c.function, c.cov)
            for c in network.observation
        ],
    )
    rng = np.random.default_rng(0)
    drive = simulation.drive(
        network,
        simulation.figure_of_eight(30, 0.2),
        np.array([[3.0, 2.0], [-1.0, 4.0]]),
        reach=10.0,
        rng=rng,
    )
    given, numerical = (pgm.smooth(n, drive.evidence) for n in (network, plain))
    assert_allclose(given[pose].mean, numerical[pose].mean, atol=1e-6)


def test_noise_grows_with_the_time_of_a_step():
    network = networks.range_only(
        start=[0, 0, 0], start_std=(0, 0, 0), position_rate=0.1, heading_rate=0.2, sensor_std=1.0
    )
    still = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 2.0]])
    belief = pgm.filter(network, {networks.travelled: still})[pose]
    assert_allclose(belief.cov[1], np.diag([0.01, 0.01, 0.04]) * 0.5, atol=1e-12)
    assert_allclose(np.diagonal(belief.cov[2])[:2], 0.01 * 2.5, atol=1e-12)


def test_what_is_out_of_reach_is_not_seen():
    network = networks.range_bearing(0.2)
    landmarks = np.array([[2.0, 0.0], [100.0, 0.0]])
    controls = simulation.figure_of_eight(40, 0.2)
    drive = simulation.drive(
        network, controls, landmarks, reach=3.0, runs=4, rng=np.random.default_rng(1)
    )
    seen = drive.evidence[sighting]
    assert (seen.given[landmark][:, 0] == 2.0).all()
    away = np.linalg.norm(drive.truth[:, seen.step, :2] - seen.given[landmark], axis=-1)
    assert (np.isnan(seen.values[..., 0]) == (away > 3.0)).all()
    assert drive.evidence[velocity].shape == (40, 2)


def test_the_figure_of_eight_turns_both_ways():
    controls = simulation.figure_of_eight(200, 0.25)
    assert controls[0, 1] > 0 > controls[150, 1]
    assert_allclose(0.25 * controls[:100, 1].sum(), 2 * np.pi, rtol=1e-9)


@pytest.mark.parametrize("kind", ["filter", "smoother"])
def test_a_linear_model_is_consistent(kind):
    """200 runs drawn by the model: mean NEES inside the 99 % band, at each of some steps."""
    model, steps = networks.linear(), 40
    sample = model.sample({networks.shift: np.tile([0.5, 0.2], (steps, 1))}, runs=200, rng=3)
    posterior = pgm.smooth(model, sample.evidence)
    beliefs = {"filter": posterior.filtered[networks.point], "smoother": posterior[networks.point]}
    nees = consistency.nees(beliefs[kind], sample[networks.point])
    low, high = consistency.mean_band(2, 200)
    for step in (0, steps // 2, steps):
        assert low < nees[:, step].mean() < high
    errors = {k: consistency.rmse(b, sample[networks.point]) for k, b in beliefs.items()}
    assert errors["smoother"] < errors["filter"]
