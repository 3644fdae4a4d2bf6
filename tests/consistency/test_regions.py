"""Coverage against counting, and its interval against scipy's binomial test."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import binomtest

import pgm
from models.networks import point
from pgm import consistency

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))


@pytest.mark.parametrize("won", [0, 1, 37, 199, 200])
@pytest.mark.parametrize("band", [0.9, 0.99])
def test_the_interval_is_that_of_clopper_and_pearson(won, band):
    mean = np.zeros((200, 3))
    mean[won:, 0] = 50.0
    found = consistency.coverage(pgm.Gaussian(x, mean, np.eye(3)), np.zeros(3), 0.5, band=band)
    due = binomtest(won, 200).proportion_ci(band, method="exact")
    assert_allclose([found.actual, found.low, found.high], [won / 200, due.low, due.high])
    assert found.runs == 200


def test_ellipses_hold_what_their_own_geometry_holds():
    rng = np.random.default_rng(2)
    roots = 0.2 * rng.normal(size=(400, 3, 3))
    belief = pgm.Gaussian(x, rng.normal(size=(400, 3)), roots @ roots.swapaxes(-1, -2))
    truth = belief.sample(rng=rng)
    offset = truth[:, 1:] - belief.mean[:, 1:]
    assert np.abs(offset[:, 1]).max() < np.pi  # nothing to wrap
    for confidence in (0.5, 0.9):
        ellipse = belief.ellipse(confidence, components=("north", "heading"))
        cos, sin = np.cos(ellipse.orientation), np.sin(ellipse.orientation)
        along = (offset[:, 0] * cos + offset[:, 1] * sin) / ellipse.half_axes[:, 0]
        across = (offset[:, 1] * cos - offset[:, 0] * sin) / ellipse.half_axes[:, 1]
        found = consistency.coverage(belief, truth, confidence, ("north", "heading"))
        assert_allclose(found.actual, np.mean(along**2 + across**2 < 1.0))


@pytest.mark.parametrize("components", [(), ("north",)])
def test_a_right_model_covers_as_it_says_and_a_wrong_one_does_not(right, wrong, truth, components):
    levels = np.array([0.1, 0.5, 0.9, 0.95, 0.99])
    found = consistency.coverage(right[point], truth, levels, components, band=0.999)
    assert found.runs == 300
    assert found.inside.all()
    assert np.abs(found.actual - levels).max() < 0.03
    bad = consistency.coverage(wrong[point], truth, levels, components, band=0.999)
    assert not bad.inside[1:].any()
    assert (bad.actual < levels).all()


def test_steps_sharpen_the_share_but_are_no_trials(right, truth):
    found = consistency.coverage(right[point], truth, 0.9)
    assert found.actual == np.mean(consistency.nees(right[point], truth) <= -2 * np.log(0.1))
    one = consistency.coverage(right[point].run(0), truth[0], 0.9)
    assert one.runs == 1
    assert one.high - one.low > 0.9


def test_refusals():
    belief = pgm.Gaussian(x, np.zeros(3), np.eye(3))
    for confidence in (0.0, 1.0, 95, [0.5, np.nan]):
        with pytest.raises(pgm.ModelError, match="between 0 and 1"):
            consistency.coverage(belief, np.zeros(3), confidence)
    with pytest.raises(pgm.ModelError, match="a confidence must be numbers"):
        consistency.coverage(belief, np.zeros(3), "much")
    with pytest.raises(pgm.NumericalError, match="singular"):
        consistency.coverage(pgm.Gaussian(x, np.zeros(3), np.zeros((3, 3))), np.zeros(3))
