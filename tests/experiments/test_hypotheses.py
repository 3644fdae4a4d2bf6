"""Experiments whose modes and identities are hidden: what they say at their quick settings."""

import numpy as np
import pytest


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


def test_hypotheses_summed_keep_what_the_likeliest_loses(summary):
    methods = summary("two_targets")["methods"]
    likeliest = methods.pop("the likeliest, 1")
    for found in methods.values():
        assert found["filter"] < likeliest["filter"]
        assert found["nees"] == pytest.approx(1.0, abs=0.2)


def test_both_sides_of_the_beacons_are_found(summary):
    found = summary("mirror")
    assert found["found_both"] == 1.0
    assert np.all(np.array(found["adapted"]) < 0.05)
    assert np.all(np.array(found["divergence"]) < np.array(found["one"]) / 10.0)
