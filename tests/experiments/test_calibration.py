"""What the Plaza recordings tell of their own sensors."""

from dataclasses import replace

import numpy as np
import pytest

import pgm
from experiments import calibration as experiment
from experiments.calibration.learnt import WAYS, fitted, learnt, parametric, recorded, residual
from experiments.calibration.static_states import columns, found, variants
from experiments.plaza import log as plaza_log
from experiments.recordings.settings import SETTINGS
from models.networks import calibration, distance
from pgm import EvidenceError

# Scale and offset [m] that fit the truth.
FITTED = {"plaza1": (1.0693, 0.034), "plaza2": (1.0694, 0.020)}


def file(name):
    path = SETTINGS[name].find()
    if path is None:
        pytest.skip("the recordings come with gtsam, which is not installed")
    return path


def cases(name):
    return list(variants(file(name), plaza_log.SETTINGS[name]))


@pytest.fixture(scope="module", params=[pytest.param("plaza2", marks=pytest.mark.slow)])
def plaza2():
    return [found(log, model) for _, log, model in cases("plaza2")[1:]]


def require_calibration(name, scale, offset):
    """Within 0.5 % and 0.15 m of what fits the truth."""
    assert scale == pytest.approx(FITTED[name][0], rel=0.005)
    assert offset == pytest.approx(FITTED[name][1], abs=0.15)


def require_learnt(name, way, iterations, noise, smoother):
    """Calibration and noise from the data alone, and a smoother that gains by it."""
    drive = recorded(name, file(name))
    result, _ = learnt(drive, WAYS[way], iterations)
    start, end, trace = result["start"], result["end"], result["log_evidence"]
    require_calibration(name, end["scale"], end["offset"])
    # The truth's distances, which were not seen, say what the noise of a range is.
    assert end["range"] == pytest.approx(residual(drive, *FITTED[name]), rel=noise)
    assert trace[-1] > trace[0]
    assert (np.diff(trace) >= 0.0).all()
    assert (trace[0], trace[-1]) == pytest.approx((start["total"], end["total"]), rel=1e-12)
    assert end["smoother"] < smoother
    return result


@pytest.mark.slow
def test_plaza2_tells_its_calibration_and_noise():
    result = require_learnt("plaza2", "parameter", 8, noise=0.1, smoother=0.27)
    assert result["start"]["smoother"] > 2.0  # ranges as recorded
    assert (result["start"]["scale"], result["start"]["offset"]) == (1.0, 0.0)
    assert result["start"]["range"] > 3.0 * result["end"]["range"]


@pytest.mark.slow
def test_a_static_state_tells_its_deviations():
    result = require_learnt("plaza2", "state", 3, noise=0.1, smoother=0.27)
    for key, due in zip(("scale", "offset"), FITTED["plaza2"], strict=True):
        assert abs(result["end"][key] - due) < 3.0 * result["std"][key]
        assert 0.0 < result["std"][key] < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", FITTED)
def test_the_likeliest_noise_is_that_of_the_residuals(name, way):
    result = require_learnt(name, way, 200, noise=0.01, smoother=0.22)
    reference, _ = fitted(recorded(name, file(name)))
    # The prior of a state costs a few nats.
    assert result["end"]["total"] > reference["total"] - (0.0 if way == "parameter" else 10.0)
    assert result["end"]["smoother"] < 1.02 * reference["smoother"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor_std", "rates"), [(0.1, (0.01, 0.01, 0.002)), (8.0, (0.8, 0.8, 0.2))]
)
def test_other_starts_end_as_high(sensor_std, rates):
    """A fifth to a tenth of the tuned noise, and ten to sixteen times it."""
    drive = recorded("plaza2", file("plaza2"))
    way = WAYS["parameter"]
    one, _ = learnt(drive, way, 200)
    start = replace(way, model=lambda of: parametric(of, sensor_std, rates))
    other, _ = learnt(drive, start, 200)
    assert other["start"]["range"] == pytest.approx(sensor_std)
    assert other["end"]["total"] == pytest.approx(one["end"]["total"], abs=2.0)
    assert other["end"]["scale"] == pytest.approx(one["end"]["scale"], abs=1e-3)
    assert other["end"]["offset"] == pytest.approx(one["end"]["offset"], abs=0.02)
    assert other["end"]["range"] == pytest.approx(one["end"]["range"], rel=0.01)


def test_noise_of_a_step_is_that_of_its_duration():
    """At the tuned values a covariance for all steps is as likely as one that grows, nearly."""
    drive = recorded("plaza2", file("plaza2"))
    setting, given = SETTINGS["plaza2"], {calibration: pgm.constant(np.array(FITTED["plaza2"]))}
    model = parametric(drive, setting.sensors[0].std[0], setting.rates)
    one = pgm.filter(model, {**drive.evidence, **given}).log_evidence
    grown = model.replace(transition=drive.network().transition)
    other = pgm.filter(grown, {**drive.evidence, **given}).log_evidence
    assert one == pytest.approx(other, abs=5.0)
    assert one != other


@pytest.mark.parametrize("kind", ["filter", "smoother", "iterated"])
def test_plaza2_tells_its_own_range_calibration(plaza2, kind):
    for result in plaza2:
        (scale, by_scale), (offset, by_offset) = result[kind]["scale"], result[kind]["offset"]
        require_calibration("plaza2", scale, offset)
        apart = np.subtract((scale, offset), FITTED["plaza2"])
        assert (np.abs(apart) < 3.0 * np.array([by_scale, by_offset])).all()
        assert result[kind]["error"] < (0.39 if kind == "filter" else 0.22)


def test_plaza1_tells_its_own_range_calibration():
    _, log, model = cases("plaza1")[1]
    belief = pgm.filter(model, log.timeline.evidence)[calibration]
    require_calibration("plaza1", *belief.mean[-1])
    assert (np.abs(belief.mean[-1] - FITTED["plaza1"]) < 3.0 * belief.std[-1]).all()


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


def test_a_file_of_unknown_kind_is_refused(tmp_path):
    with pytest.raises(EvidenceError, match="--data"):
        experiment.run(out=tmp_path, path=tmp_path / "log.mat")
