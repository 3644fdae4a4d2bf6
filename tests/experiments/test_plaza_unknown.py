"""What the Plaza recordings tell of their own sensors."""

import numpy as np
import pytest

import pgm
from experiments.plaza import log as plaza_log
from experiments.plaza.experiment import columns
from experiments.plaza.log import SETTINGS
from experiments.plaza.unknown import found, variants
from models.networks import calibration, distance


def cases(name):
    path = plaza_log.find(name)
    if path is None:
        pytest.skip("the recordings come with gtsam, which is not installed")
    return list(variants(path, SETTINGS[name]))


@pytest.fixture(scope="module")
def plaza2():
    return [found(log, model) for _, log, model in cases("plaza2")[1:]]


def require_calibration(mean, std, setting):
    """Within 0.5 % and 0.15 m of what fits the truth, and within three deviations."""
    apart = np.abs(mean - np.array([setting.scale, setting.offset]))
    assert (apart < [0.005 * setting.scale, 0.15]).all()
    assert (apart < 3.0 * np.asarray(std)).all()


@pytest.mark.parametrize("kind", ["filter", "smoother", "iterated"])
def test_plaza2_tells_its_own_range_calibration(plaza2, kind):
    for result in plaza2:
        mean, std = zip(result[kind]["scale"], result[kind]["offset"], strict=True)
        require_calibration(mean, std, SETTINGS["plaza2"])
        assert result[kind]["error"] < (0.39 if kind == "filter" else 0.22)


def test_plaza1_tells_its_own_range_calibration():
    _, log, model = cases("plaza1")[1]
    belief = pgm.filter(model, log.timeline.evidence)[calibration]
    require_calibration(belief.mean[-1], belief.std[-1], SETTINGS["plaza1"])


def test_ranges_at_their_own_times_are_likelier(plaza2):
    (_, moved, _), (_, own, _) = cases("plaza2")[1:3]
    assert moved.timeline.readings[distance].moved.all()
    assert not own.timeline.readings[distance].moved.any()
    assert own.timeline.readings[distance].kept.all()
    assert own.timeline.times[own.steps].tolist() == moved.timeline.times.tolist()
    assert plaza2[1]["log_evidence"] > plaza2[0]["log_evidence"] + 5.0


def test_the_gyro_of_plaza2_has_a_bias(plaza2):
    """The integrated gyro leaves the true heading by -5.4 mrad/s."""
    mean, std = plaza2[2]["smoother"]["rate"]
    assert abs(mean + 0.0054) < 3.0 * std < 0.0054
    assert plaza2[2]["log_evidence"] > plaza2[1]["log_evidence"] + 5.0


def test_the_table_has_what_was_unknown(plaza2):
    assert columns(plaza2[0])[-1] == ""
    assert columns(plaza2[2])[-1].startswith("-0.005")


@pytest.mark.slow
def test_the_gyro_of_plaza1_has_none():
    """Its true headings are the integrated gyro."""
    (_, _, plain), (_, log, drifting) = cases("plaza1")[2:]
    one, other = (pgm.filter(model, log.timeline.evidence) for model in (plain, drifting))
    assert other.log_evidence < one.log_evidence - 5.0
