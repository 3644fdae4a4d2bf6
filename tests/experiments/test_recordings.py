"""Recorded drives: the position errors of textbook implementations on the same data."""

import numpy as np
import pytest

import pgm
from experiments import recordings, wide_start
from experiments.recordings import drives, methods
from experiments.recordings.settings import SETTINGS
from experiments.wide_start import cases
from experiments.wide_start.experiment import judged
from models.networks import distance, pose
from pgm import consistency

# RMSE [m] of dead reckoning, of an extended Kalman filter, and of its RTS smoother.
BASELINES = {
    "plaza1": (1.935, 0.256, 0.184),
    "plaza2": (31.65, 0.367, 0.208),
    "labyrinth": (0.214, 0.068, 0.039),
}
PLANE = ("east", "north")


def drive(name):
    path = SETTINGS[name].find()
    if path is None:
        pytest.skip(f"{name} is not here: {SETTINGS[name].needs}")
    return drives.load(name, path)


@pytest.mark.parametrize("name", BASELINES)
def test_errors_are_those_of_the_textbooks(name):
    found = drive(name)
    model = found.network()
    smoothed = pgm.smooth(model, found.evidence)
    reckoned = pgm.filter(model, found.motion)
    beliefs = (reckoned[pose], smoothed.filtered[pose], smoothed[pose])
    errors = [consistency.rmse(belief, found.truth, PLANE) for belief in beliefs]
    np.testing.assert_allclose(errors, BASELINES[name], rtol=0.03)


@pytest.mark.parametrize(
    ("name", "draws"),
    [("labyrinth", 1000), ("plaza2", 200), pytest.param("plaza1", 200, marks=pytest.mark.slow)],
)
def test_an_estimate_is_vouched_for_and_near_the_best_fixed_scheme(name, draws):
    found = drive(name)
    model, evidence = found.network(), found.evidence
    fixed = [
        consistency.rmse(belief, found.truth, PLANE)
        for lineariser in (pgm.Taylor(), pgm.Unscented(), pgm.Cubature())
        for belief in (
            pgm.smooth(model, evidence, lineariser=lineariser)[pose],
            pgm.smooth(model, evidence, lineariser=lineariser, iterations=10)[pose],
        )
    ]
    posterior = pgm.estimate(model, evidence)
    error = consistency.rmse(posterior[pose].gaussian(), found.truth, PLANE)
    assert error <= 1.02 * min(fixed)
    assert bool(posterior.verdict.vouched)
    assert int(posterior.verdict.draws) == draws


def test_a_long_drive_is_audited_by_few_draws():
    found = drive("plaza2")
    smoothed = pgm.smooth(found.network(), found.evidence, iterations=10)
    audit = pgm.audit(smoothed, rng=0)
    assert audit.samples == 100
    assert bool(audit.trusted)
    more = pgm.audit(smoothed, samples=300, rng=1)
    spread = np.hypot(audit.standard_error, more.standard_error)
    assert abs(audit.log_evidence - more.log_evidence) <= 5.0 * spread


def test_a_robust_smoother_of_labyrinth_is_near_a_batch_of_gtsam():
    found = drive("labyrinth")
    posterior = methods.methods(found.setting.ways)["robust smoother"](found, pgm.Taylor())
    assert posterior.status.converged.all()
    assert consistency.rmse(posterior[pose], found.truth, PLANE) <= 0.031


def test_sightings_are_labelled_by_their_landmarks():
    found = drive("labyrinth")
    assert set(found.labels[distance]) == {"105", "107", "108", "109"}
    ranked = consistency.ranking(
        pgm.filter(found.network(), found.evidence).innovations,
        by=found.labels,
    )
    assert ranked[0].group == "107"  # whose ranges are the skewed ones
    assert ranked[0].probability < 1e-6


def test_states_at_every_stamp_move_no_reading():
    path = SETTINGS["plaza2"].find()
    if path is None:
        pytest.skip("plaza2 is not here")
    found = drives.load("plaza2", path, every_stamp=True)
    (report,) = found.timeline.readings.values()
    assert np.abs(report.shift[report.kept]).max() < 1e-6


def test_a_wide_start_is_borne_by_sigma_points():
    found = cases.load("plaza2")
    if found is None:
        pytest.skip("plaza2 is not here")
    means = cases.starts(found, 20, np.random.default_rng(0))
    each = judged(found, means, of=("Taylor", "unscented"))
    worst = {label: np.percentile(np.nanmean(n, axis=1), 90) for label, (n, _) in each.items()}
    assert worst["Taylor"] >= 5.0 * worst["unscented"]


def test_refusals(tmp_path):
    with pytest.raises(pgm.EvidenceError, match="is not a recording"):
        recordings.run(data="moon")
    with pytest.raises(pgm.EvidenceError, match="is not a lineariser"):
        recordings.run(data="plaza1", linearisers="Tailor")
    with pytest.raises(pgm.EvidenceError, match="of which kind"):
        recordings.run(path=tmp_path)
    with pytest.raises(pgm.EvidenceError, match="is not a recording"):
        wide_start.run(data="moon")
