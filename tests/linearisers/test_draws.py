"""What random rules draw: streams that do not overlap, and the balance of scrambled nets."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.stats.qmc import Sobol

from pgm.linearisers import sampled


def net(samples, dimension, step=0, seed=0):
    size = sampled.scrambling_size(samples, dimension)
    return sampled.scrambled_net(sampled.uniform(seed, "y", step, size, False), samples, dimension)


@pytest.mark.parametrize("step", range(4))
@pytest.mark.parametrize(("samples", "dimension"), [(64, 1), (64, 2), (256, 3)])
def test_a_scrambled_net_is_balanced(samples, dimension, step):
    """Every elementary box that one of the unscrambled points meets alone, one still does."""
    points = net(samples, dimension, step)
    plain = Sobol(dimension, scramble=False).random_base2(samples.bit_length() - 1)
    digits = samples.bit_length() - 1
    assert ((points >= 0.0) & (points < 1.0)).all()
    for k in range(dimension):  # each coordinate alone: one point to every stratum
        assert_array_equal(np.sort((points[:, k] * samples).astype(int)), np.arange(samples))
    if dimension < 2:
        return
    for share in range(digits + 1):  # the first two: every shape of box
        cells = 2 ** np.array([share, digits - share])
        for each in (plain, points):
            boxes = np.floor(each[:, :2] * cells).astype(int)
            assert len(np.unique(boxes, axis=0)) == samples


def test_scrambled_points_are_uniform_one_by_one():
    # Over many scramblings any one point, the origin of the plain net too, is uniform.
    points = net(8, 2, np.arange(20_000))
    assert points.shape == (20_000, 8, 2)
    error = 5 / np.sqrt(12 * 20_000)
    assert (np.abs(points.mean(axis=0) - 0.5) < error).all()
    for k in range(8):
        counts = np.histogram2d(points[:, k, 0], points[:, k, 1], bins=4, range=[[0, 1], [0, 1]])[0]
        assert np.abs(counts - 20_000 / 16).max() < 5 * np.sqrt(20_000 / 16)


def test_scramblings_are_more_than_shifts():
    """Digits below the net's own are random too: points do not stay on a lattice."""
    points = net(64, 2)
    within = (points * 64) % 1.0
    assert len(np.unique(within.round(9))) > 100


@pytest.mark.parametrize("samples", [10, 100, 1000])
def test_a_net_of_any_size_is_the_beginning_of_a_larger_one(samples):
    digits = (samples - 1).bit_length()
    assert_array_equal(net(samples, 3), net(2**digits, 3)[:samples])


@pytest.mark.parametrize("size", [1, 4, 9])
def test_streams_do_not_overlap(size):
    steps = np.broadcast_to(np.arange(50)[:, None], (50, 20))
    shared = sampled.uniform(3, "y", np.arange(50), size, fresh=False)
    fresh = sampled.uniform(3, "y", steps, size, fresh=True)
    assert np.unique(np.concatenate([shared.ravel(), fresh.ravel()])).size == 50 * 21 * size


def test_normal_quantiles_are_finite():
    ends = np.array([0.0, 2.0**-53, 0.5, 1.0 - 2.0**-53])
    found = sampled.normal(ends)
    assert np.isfinite(found).all()
    assert (np.diff(found) > 0).all()
    assert found[2] == 0.0
