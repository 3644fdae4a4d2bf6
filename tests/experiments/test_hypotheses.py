"""Experiments whose modes and identities are hidden: what they say at their quick settings."""

import numpy as np
import pytest

from experiments.freiburg import log


@pytest.fixture
def summary(quick):
    """The summary.json of an experiment at its quick settings."""
    return lambda name: quick(name).summary


def test_knowing_the_turns_is_better_than_larger_noise(summary):
    methods = summary("manoeuvre")["methods"]
    one = methods.pop("one motion")
    for found in methods.values():
        assert found["smoother"] < found["filter"] < one["filter"]
        assert found["smoother"] < one["smoother"]
        assert found["nees"] == pytest.approx(1.0, abs=0.2)
        assert found["right"] > 0.9


def test_the_published_figures_of_the_incinerator(summary):
    found = summary("incinerator")
    for name in ("before", "after"):
        for each in found[name].values():
            assert each["mean"][1] == pytest.approx(each["mean"][0], abs=6e-3)
            assert each["std"][1] == pytest.approx(each["std"][0], abs=6e-4)
    for published, chance in found["states"].values():
        assert chance == pytest.approx(published, abs=6e-5)


def test_a_weight_tells_of_group_and_height(summary):
    """The middle weight against Bayes' rule by hand."""
    found = summary("height_and_group")
    mean, var = np.array([162.0, 176.0]), np.array([40.0, 50.0])
    slope, offset = np.array([0.8, 0.9]), np.array([-68.0, -78.0])
    spread = slope**2 * var + [60.0, 80.0]
    off = found["weights"][1] - slope * mean - offset
    likely = np.exp(-0.5 * off**2 / spread) / np.sqrt(spread)
    likely /= likely.sum()
    assert found["chance"][1] == pytest.approx(likely[0], rel=1e-12)
    height = likely @ (mean + slope * var / spread * off)
    assert found["height"][1] == pytest.approx(height, rel=1e-12)


def test_a_fault_as_a_state_is_better_than_other_ways(summary):
    found = summary("outlier_cause")
    methods = found["methods"]
    best = methods.pop("fault as a state")
    several = methods.pop("the same, 8 Gaussians")
    for each in methods.values():
        assert best["filter"] < each["filter"]
        assert best["smoother"] < each["smoother"]
    assert best["nees"] == pytest.approx(1.0, abs=0.15)
    assert several["smoother"] == pytest.approx(best["smoother"], rel=0.1)
    assert found["found"] > 0.97


def test_hypotheses_summed_keep_what_the_likeliest_loses(summary):
    methods = summary("two_targets")["methods"]
    likeliest = methods.pop("the likeliest, 1")
    for found in methods.values():
        assert found["filter"] < likeliest["filter"]
        assert found["nees"] == pytest.approx(1.0, abs=0.2)


@pytest.mark.skipif(log.find() is None, reason="the Freiburg recording is not here")
def test_sums_over_landmarks_follow_a_recorded_robot(summary):
    ways = summary("unknown_landmarks")["ways"]
    for way in ("summed, 1", "exclusive, 4"):
        assert ways[way]["error"] < ways["joint compatibility"]["error"]
        assert ways[way]["error"] < ways["named"]["error"]
        assert ways[way]["right"] >= ways["joint compatibility"]["right"] > 0.99
        assert ways[way]["nees"] < 2.0 < ways["the likeliest"]["nees"]
    assert ways["the likeliest"]["error"] > 1.5 * ways["named"]["error"]


def test_both_sides_of_the_beacons_are_found(summary):
    found = summary("mirror")
    assert found["found_both"] == 1.0
    assert np.all(np.array(found["adapted"]) < 0.05)
    assert np.all(np.array(found["divergence"]) < np.array(found["one"]) / 10.0)
