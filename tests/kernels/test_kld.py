"""The number of draws that a distribution over bins needs."""

import numpy as np
import pytest
from scipy.stats import chi2

from pgm.kernels.bins import keys, occupied
from pgm.kernels.kld_sampling import draws_needed


@pytest.mark.parametrize("bins", [10, 100, 1000])
@pytest.mark.parametrize(("epsilon", "delta"), [(0.05, 0.01), (0.01, 0.05), (0.2, 0.1)])
def test_the_divergence_stays_within_epsilon(bins, epsilon, delta):
    rng = np.random.default_rng(bins)
    count = draws_needed(bins, epsilon, delta)
    uneven = np.r_[0.5, np.full(bins - 1, 0.5 / (bins - 1))]
    for true in (np.full(bins, 1.0 / bins), rng.dirichlet(np.ones(bins)), uneven):
        found = rng.multinomial(count, true, size=2000) / count
        with np.errstate(divide="ignore", invalid="ignore"):
            divergence = np.where(found > 0.0, found * np.log(found / true), 0.0).sum(axis=1)
        assert (divergence <= epsilon).mean() >= 1.0 - delta


def test_it_is_not_far_above_the_chi_squared_bound():
    for bins in (2, 10, 100, 1000, 10**5):
        bound = chi2.isf(0.01, bins - 1) / (2.0 * 0.05)
        assert bound <= draws_needed(bins, 0.05, 0.01) <= 1.2 * bound + 1.0


def test_one_bin_needs_one_draw():
    assert draws_needed(1, 0.05, 0.01) == draws_needed(0, 0.05, 0.01) == 1


def test_bins_are_counted_as_sets_of_rows():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(3, 5000)) * [[3.0], [2.0], [1.0]] + [[1e6], [-5e5], [0.0]]
    widths = np.array([0.5, 0.25, 0.4])
    found = keys(points, widths, np.array([False, False, False]))
    rows = set(map(tuple, np.floor(points / widths[:, None]).astype(int).T.tolist()))
    assert occupied(found) == len(rows)


def test_wide_ranges_are_counted_too():
    bins = np.array([[0, 2**50, 2**50, 0], [0, 2**51, 2**51, 1]])
    assert occupied(bins) == 3


def test_angles_share_bins_across_the_turn():
    widths, angles = np.array([np.pi / 2]), np.array([True])
    points = np.array([[0.1, 0.1 + 2.0 * np.pi, 0.1 - 20.0 * np.pi, -0.1, 2.0 * np.pi - 0.1]])
    np.testing.assert_array_equal(keys(points, widths, angles), [[0, 0, 0, 3, 3]])
    many = np.linspace(-30.0, 30.0, 10_001)[None]
    assert occupied(keys(many, np.array([0.1]), angles)) == 63
    assert keys(np.nextafter([[0.0]], -1.0), widths, angles).item() in (0, 3)


def test_points_too_far_for_a_bin_have_none():
    assert keys(np.array([[1e300]]), np.array([1e-3]), np.array([False])) is None
